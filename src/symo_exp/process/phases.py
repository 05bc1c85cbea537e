"""What a command is at, on a terminal: one line, redrawn, that results take the place of."""

from __future__ import annotations

import multiprocessing
import sys

ERASED = "\r\x1b[K"


def shown(*, notebook: bool = False) -> bool:
    """Whether somebody watches: not in a file, a pipe, or a process of a sweep among others."""
    alone = multiprocessing.current_process().name == "MainProcess"
    return alone and (sys.stderr.isatty() or (notebook and "ipykernel" in sys.modules))


def say(text: str) -> None:
    """Say what begins now, if it may take a second."""
    if shown():
        sys.stderr.write(f"{ERASED}{text[:78]} …")
        sys.stderr.flush()


def clear() -> None:
    """Make room for a line that stays."""
    if shown():
        sys.stderr.write(ERASED)
        sys.stderr.flush()
