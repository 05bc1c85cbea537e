"""Settings of the C library's memory allocator."""

from __future__ import annotations

import ctypes

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # of mallopt, in malloc.h
_KEPT = 1 << 30


def keep_freed_memory() -> None:
    """Let freed blocks be reused instead of being returned to the system.

    Every training step allocates and frees the same hundreds of blocks. glibc returns those of a
    megabyte and more at once, and the system provides zeroed pages again: thousands of page faults
    a step at batch 512. Other C libraries have no such setting and are left unchanged.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):
        return
    mallopt(_MMAP_THRESHOLD, _KEPT)
    mallopt(_TRIM_THRESHOLD, _KEPT)
