"""The free memory of the machine."""

from __future__ import annotations

import os
from pathlib import Path

MEMORY = Path("/proc/meminfo")
"""Linux's file about it."""


def available_bytes() -> int | None:
    """Return the memory that processes can still take, in bytes; ``None`` if unknown.

    That includes files that the system keeps in memory, most of it on a machine that has run for
    long. Where the system does not tell, it is all memory.
    """
    try:
        known = dict(line.split(":") for line in MEMORY.read_text(encoding="ascii").splitlines())
        return 1024 * int(known["MemAvailable"].split()[0])
    except (OSError, ValueError, LookupError):
        pass
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return None
