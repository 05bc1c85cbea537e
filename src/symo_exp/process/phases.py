"""A one-line status on a terminal, which results overwrite."""

from __future__ import annotations

import multiprocessing
import sys

ERASED = "\r\x1b[K"


def visible(*, notebook: bool = False) -> bool:
    """Return whether a person watches: not in a file, a pipe, or a worker of a sweep."""
    alone = multiprocessing.current_process().name == "MainProcess"
    return alone and (sys.stderr.isatty() or (notebook and "ipykernel" in sys.modules))


def say(text: str) -> None:
    """Show what begins now, if it may take a second."""
    if visible():
        sys.stderr.write(f"{ERASED}{text[:78]} …")
        sys.stderr.flush()


def clear() -> None:
    """Erase the status before a line that stays."""
    if visible():
        sys.stderr.write(ERASED)
        sys.stderr.flush()
