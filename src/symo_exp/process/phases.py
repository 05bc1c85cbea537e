"""A one-line status on a terminal, which results overwrite."""

from __future__ import annotations

import fcntl
import multiprocessing
import os
import sys

ERASED = "\r\x1b[K"
WIDEST = 80
"""Columns of a long status on a wide terminal."""

_terminals: dict[str, int] = {}
"""File descriptors of the terminals that this process has locked, by name."""


def visible(*, notebook: bool = False) -> bool:
    """Return whether to show a status: not in a file, a pipe, or a worker of a sweep.

    Of several commands on one terminal, one shows its status, and none in the background.
    """
    if multiprocessing.current_process().name != "MainProcess":
        return False
    if sys.stderr.isatty():
        return os.environ.get("TERM") != "dumb" and _owns_terminal()  # a dumb one erases nothing
    return notebook and "ipykernel" in sys.modules


def say(text: str) -> None:
    """Show what begins now, if it may take a second."""
    if visible():
        sys.stderr.write(f"{ERASED}{text[: _width() - 2]} …")
        sys.stderr.flush()


def clear() -> None:
    """Erase the status before a line that stays."""
    if visible():
        sys.stderr.write(ERASED)
        sys.stderr.flush()


def _width() -> int:
    """Return the columns of a status: one that is continued on a second line is not erased."""
    try:
        columns = os.get_terminal_size(sys.stderr.fileno()).columns
    except OSError:  # not a terminal
        columns = 0
    return min(columns or WIDEST, WIDEST)


def _owns_terminal() -> bool:
    """Lock the terminal for the status of this process, until the process ends."""
    try:
        stream = sys.stderr.fileno()
        name = os.ttyname(stream)
        if os.tcgetpgrp(stream) != os.getpgrp():
            return False
        if name in _terminals:
            return True
        terminal = os.open(name, os.O_RDONLY | os.O_NOCTTY)
    except OSError:  # not a terminal of a shell, or one of another user
        return True
    try:
        fcntl.flock(terminal, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(terminal)
        return False
    _terminals[name] = terminal
    return True
