"""Commands in processes of their own, which start fast since slow imports are done before."""

from __future__ import annotations

import json
import multiprocessing
import os
import resource
import signal
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path

import pytest
from mlflow import MlflowClient
from mlflow.entities import Run

from symo_exp.tracking.store import connect, find

# a server that has imported everything, used nothing of it, and forks
_context = multiprocessing.get_context("forkserver")
_context.set_forkserver_preload(["tests.faults.imports"])

PATIENCE = 600.0
"""Seconds until what does not end is taken to hang. A busy machine needs some for the imports."""

_started: list[Command] = []


@pytest.fixture(autouse=True)
def nothing_goes_on() -> Iterator[None]:
    """Kill commands that a failed test has left running.

    They would take cores from the next test and keep pytest from ending.
    """
    yield
    for command in _started:
        if command.process.is_alive():
            command.kill()
    _started.clear()


class Command:
    """``python -m symo_exp`` with these words in a folder, in a session of its own."""

    def __init__(
        self,
        folder: Path,
        *words: str,
        env: Mapping[str, str] | None = None,
        output: Path | None = None,
        memory: int | None = None,
    ) -> None:
        self.folder = folder
        self.output = output or folder / f"output.{time.monotonic_ns()}"
        arguments = (str(folder), str(self.output), [*words], dict(env or {}), memory)
        self.process = _context.Process(target=_run, args=arguments)
        self.process.start()
        _started.append(self)

    @property
    def pid(self) -> int:
        assert self.process.pid is not None
        return self.process.pid

    def signal(self, signum: int, *, group: bool = False) -> None:
        (os.killpg if group else os.kill)(self.pid, signum)

    def kill(self) -> None:
        """At once, with all that it started."""
        for group in (True, False):
            with suppress(ProcessLookupError):  # not yet a session of its own, or over
                self.signal(signal.SIGKILL, group=group)
        self.process.join()

    def wait(self, timeout: float = PATIENCE) -> int:
        """The exit code; negative for the signal that ended it."""
        self.process.join(timeout)
        if self.process.exitcode is None:
            self.kill()
            raise TimeoutError(self.said)
        return self.process.exitcode

    def wait_for(self, what: Callable[[], object], timeout: float = PATIENCE) -> None:
        """Until something is there, while the command runs."""
        end = time.monotonic() + timeout
        while not what():
            if time.monotonic() > end or not self.process.is_alive():
                raise TimeoutError(self.said)
            time.sleep(0.01)

    @property
    def said(self) -> str:
        return self.output.read_text() if self.output.exists() else ""


def go(folder: Path, *words: str, env: Mapping[str, str] | None = None) -> tuple[int, str]:
    """Return the exit code of a command and its output."""
    command = Command(folder, *words, env=env)
    return command.wait(), command.said


def stored(folder: Path) -> tuple[MlflowClient, list[Run]]:
    """The client of the store of a folder, and the runs that it has of the default experiment."""
    client = connect(find(None, folder / "mlruns"))
    (experiment,) = client.search_experiments(filter_string="name = 'default'")
    return client, list(client.search_runs([experiment.experiment_id]))


def statuses(folder: Path) -> list[str]:
    """How the runs of a folder ended, in alphabetical order."""
    files = folder.glob("outputs/*/*-*/outcome.json")
    return sorted(json.loads(path.read_text())["status"] for path in files)


def _run(
    folder: str, output: str, words: list[str], env: dict[str, str], memory: int | None
) -> None:
    os.setsid()
    if memory is not None:
        resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
    os.chdir(folder)
    os.environ.update(env, HOME=folder)
    handle = os.open(output, os.O_WRONLY | os.O_CREAT)
    os.dup2(handle, 1)
    os.dup2(handle, 2)
    sys.stdout = os.fdopen(1, "w", buffering=1, closefd=False)
    sys.stderr = os.fdopen(2, "w", buffering=1, closefd=False)
    signal.signal(signal.SIGINT, signal.default_int_handler)  # the server ignores it
    from symo_exp.__main__ import main

    code = main(words)
    sys.stdout.flush()
    os._exit(code)
