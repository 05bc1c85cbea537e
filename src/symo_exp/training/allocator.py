"""How the C library hands out memory."""

from __future__ import annotations

import ctypes

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # of mallopt, in malloc.h
_KEPT = 1 << 30


def keep_freed_memory() -> None:
    """Let freed blocks be used again instead of going back to the system.

    A training step takes and frees the same hundreds of blocks every time. glibc returns those of
    a megabyte and more at once, and the system hands out zeroed pages anew: at batch 512 thousands
    of page faults a step. Other C libraries have no such setting and are left alone.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):
        return
    mallopt(_MMAP_THRESHOLD, _KEPT)
    mallopt(_TRIM_THRESHOLD, _KEPT)
