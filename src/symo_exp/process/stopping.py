"""Being asked to stop, by Ctrl-C (SIGINT) or SIGTERM: once, at the end of the epoch; twice, now.

The command that started the jobs tells them through a file, since a signal reaches one process
only, or all of a terminal's at different moments.

A cluster tells a job by SIGUSR2 that its time is nearly up. This is obeyed like the others, and
then the launcher that listens for it has its turn: it puts the job back into the queue.
"""

from __future__ import annotations

import os
import shutil
import signal
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

SIGNALS = (signal.SIGINT, signal.SIGTERM)
TIME_IS_UP = signal.SIGUSR2
FOLDER = "SYMO_EXP_COMMAND"
"""Environment variable: a folder that the processes of one command share."""

AT_ONCE = b"symo_exp: stopping now; the same command goes on from the last checkpoint\n"
AFTER_EPOCH = (
    b"symo_exp: stopping when this epoch is done; the same command goes on from there "
    b"(once more stops now)\n"
)

_noted: int | None = None
_urgent = False
_commands = False
_requeue: Callable[[int, Any], Any] | None = None


class Interrupted(BaseException):
    """A signal has ended the run. No ``Exception``: nothing may take it for a failure."""

    def __init__(self, signum: int) -> None:
        super().__init__(signum)
        self.signum = signum

    def __str__(self) -> str:
        return f"interrupted by {signal.Signals(self.signum).name}"


def requested() -> int | None:
    """The signal that asked this process, or the command that it works for, to stop."""
    return _noted if _noted is not None else _told()


def raise_if_requested() -> None:
    """End here what need not be finished."""
    signum = requested()
    if signum is not None:
        raise Interrupted(signum)


@contextmanager
def command() -> Iterator[None]:
    """Around all jobs of a command: a first signal is noted, told to the jobs, and obeyed by
    those who look at ``requested``."""
    global _noted, _commands
    folder = tempfile.mkdtemp(prefix="symo_exp-")
    outer, os.environ[FOLDER] = os.environ.get(FOLDER), folder
    _noted, _commands = None, True
    before = {signum: signal.getsignal(signum) for signum in SIGNALS}
    install()
    try:
        yield
    finally:
        _noted, _commands = None, False
        if _in_main_thread():
            for signum, handler in before.items():
                signal.signal(signum, handler)
        os.environ.pop(FOLDER)
        if outer is not None:
            os.environ[FOLDER] = outer
        shutil.rmtree(folder, ignore_errors=True)


def install() -> None:
    """Put our handlers in place: in a worker, or where a library has put its own.

    They stay: between two jobs a signal must not end a worker whose neighbours finish an epoch.
    """
    global _noted, _requeue
    if os.environ.get("SUBMITIT_EXECUTOR") == "slurm":
        os.environ.pop(FOLDER, None)  # who cancels one job of a cluster means that one
    if not os.path.isdir(os.environ.get(FOLDER, "")):
        _noted = None  # what was noted was for a command that has ended
    if _in_main_thread():
        for signum in SIGNALS:
            signal.signal(signum, _handle)
        launchers = signal.getsignal(TIME_IS_UP)
        if callable(launchers) and launchers is not _handle:
            _requeue = launchers
            signal.signal(TIME_IS_UP, _handle)


def make_way() -> None:
    """Have the launcher queue this job again, which ends the process; raises what keeps it from
    that, as when the job was queued too often."""
    if _requeue is not None:
        for signum in SIGNALS:  # the cluster sends them to what leaves the node
            signal.signal(signum, signal.SIG_IGN)
        _requeue(TIME_IS_UP, None)


@contextmanager
def urgent(value: bool = True) -> Iterator[None]:
    """Where nobody looks at ``requested``: the first signal ends the run at once.

    ``urgent(False)`` inside is for an epoch, which is worth finishing.
    """
    global _urgent
    before, _urgent = _urgent, value
    try:
        yield
    finally:
        _urgent = before


@contextmanager
def deaf_children() -> Iterator[None]:
    """Processes that are started meanwhile do not hear Ctrl-C: they are told by the file.

    A blocked signal stays blocked in a child. This process still hears it, by any other thread.
    """
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})


def _handle(signum: int, frame: Any) -> None:
    global _noted
    second = _noted is not None
    _noted = signum
    if signum != TIME_IS_UP:
        _tell(signum)
        if _commands:
            os.write(2, AT_ONCE if second or _urgent else AFTER_EPOCH)
    if second or _urgent:
        raise Interrupted(signum)


def _tell(signum: int) -> None:
    folder = os.environ.get(FOLDER)
    if folder and os.path.isdir(folder):
        Path(folder, f"stop.{int(signum)}").touch()


def _told() -> int | None:
    folder = os.environ.get(FOLDER)
    if not folder:
        return None
    return next((s for s in SIGNALS if os.path.exists(f"{folder}/stop.{int(s)}")), None)


def _in_main_thread() -> bool:
    return threading.current_thread() is threading.main_thread()
