"""Stop requests by Ctrl-C (SIGINT) or SIGTERM: once, after the current epoch; twice, immediately.

A signal reaches one process, or all processes of a terminal at different times. The command that
started the jobs therefore passes it on through a file.

A cluster announces the time limit of a job by SIGUSR2. It is treated like the others; afterwards
the handler of the launcher is called, which queues the job again.
"""

from __future__ import annotations

import multiprocessing
import os
import shutil
import signal
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from multiprocessing import resource_tracker
from pathlib import Path
from typing import Any

SIGNALS = (signal.SIGINT, signal.SIGTERM)
TIME_IS_UP = signal.SIGUSR2
FOLDER = "SYMO_EXP_COMMAND"
"""Environment variable: a folder that the processes of one command share."""

AT_ONCE = b"symo_exp: stopping now; rerun the command to resume from the last checkpoint\n"
AFTER_EPOCH = (
    b"symo_exp: stopping after this epoch; rerun the command to resume (once more stops now)\n"
)

_noted: int | None = None
_folder = ""
"""That of the command for which a signal was noted."""
_urgent = False
_commands = False
_requeue: Callable[[int, Any], Any] | None = None


class Interrupted(BaseException):
    """Raised when a signal ends the run.

    It is no ``Exception``, so that nothing handles it as a failure.
    """

    def __init__(self, signum: int) -> None:
        super().__init__(signum)
        self.signum = signum

    def __str__(self) -> str:
        return f"interrupted by {signal.Signals(self.signum).name}"


def requested() -> int | None:
    """Return the signal that asked this process, or the command that it works for, to stop."""
    return _noted if _noted is not None else _told()


def raise_if_requested() -> None:
    """Raise ``Interrupted`` if a stop was requested."""
    signum = requested()
    if signum is not None:
        raise Interrupted(signum)


@contextmanager
def command() -> Iterator[None]:
    """Handle signals for all jobs of a command.

    The first signal is recorded and passed on to the jobs; code that checks ``requested`` obeys
    it.
    """
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
    """Install the signal handlers: in a worker, or after a library has installed its own.

    They stay installed: between two jobs, a signal must not end a worker while others finish an
    epoch.
    """
    global _noted, _folder, _requeue
    if os.environ.get("SUBMITIT_EXECUTOR") == "slurm":
        os.environ.pop(FOLDER, None)  # who cancels one job of a cluster means that one
    before, _folder = _folder, os.environ.get(FOLDER, "")
    if _folder != before or not os.path.isdir(_folder):
        _noted = None  # what was noted was for a command that has ended
    if _in_main_thread():
        for signum in SIGNALS:
            signal.signal(signum, _handle)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)  # a worker was started deaf to one
        launchers = signal.getsignal(TIME_IS_UP)
        if callable(launchers) and launchers is not _handle:
            _requeue = launchers
            signal.signal(TIME_IS_UP, _handle)


@cache
def end_with_parent() -> None:
    """End this process, if it is a worker, when the one that started it has been killed.

    It would wait forever: nobody reads its result, and the other workers keep the pipe open.
    """
    if multiprocessing.parent_process() is None:
        return
    parent = os.getppid()

    def wait() -> None:
        while os.getppid() == parent:
            time.sleep(1.0)
        signal.raise_signal(signal.SIGKILL)

    threading.Thread(target=wait, daemon=True).start()


def make_way() -> None:
    """Have the launcher queue this job again, which ends the process.

    Raises:
        Exception: Any error of the launcher, for instance if the job was queued too often.
    """
    if _requeue is not None:
        for signum in SIGNALS:  # the cluster sends them to what leaves the node
            signal.signal(signum, signal.SIG_IGN)
        _requeue(TIME_IS_UP, None)


@contextmanager
def urgent(value: bool = True) -> Iterator[None]:
    """Let the first signal raise at once, where nothing checks ``requested``.

    ``urgent(False)`` inside protects an epoch, which is finished first.
    """
    global _urgent
    before, _urgent = _urgent, value
    try:
        yield
    finally:
        _urgent = before


@contextmanager
def deaf_children() -> Iterator[None]:
    """Keep SIGINT from processes started meanwhile until they call ``install``.

    Python and libraries that are being imported would end by it with a traceback. A blocked signal
    stays blocked in a child; this process receives it in another thread.
    """
    resource_tracker.ensure_running()  # in old versions of Python, its start unblocks signals
    over = threading.Event()
    threading.Thread(target=over.wait, daemon=True).start()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        over.set()


def _handle(signum: int, frame: Any) -> None:
    global _noted
    second = _noted is not None
    _noted = signum
    if signum != TIME_IS_UP:
        with suppress(OSError):  # a full disk
            _tell(signum)
        if _commands:
            with suppress(OSError):  # nobody reads
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
