"""How much memory there is."""

from __future__ import annotations

import os


def available_bytes() -> int | None:
    """Physical memory that is free now, or that there is at all; ``None`` where unknown."""
    try:
        page = os.sysconf("SC_PAGE_SIZE")
        names = os.sysconf_names
        key = "SC_AVPHYS_PAGES" if "SC_AVPHYS_PAGES" in names else "SC_PHYS_PAGES"
        return page * os.sysconf(key)
    except (AttributeError, ValueError, OSError):
        return None
