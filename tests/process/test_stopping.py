"""Signals that workers hear."""

import errno
import os
import signal
import subprocess
import sys
import time

import pytest

from symo_exp.process import stopping


@pytest.mark.parametrize("same", [True, False])
def test_a_worker_forgets_the_signal_of_a_command_when_another_one_uses_it(
    same, tmp_path, monkeypatch
):
    with stopping.command(), monkeypatch.context() as patch:
        os.kill(os.getpid(), signal.SIGINT)
        if not same:
            patch.setenv(stopping.FOLDER, str(tmp_path))
        stopping.install()  # as a job does that begins
        assert stopping.requested() == (signal.SIGINT if same else None)


@pytest.mark.parametrize("broken", ["os.write", "pathlib.Path.touch"])
def test_a_signal_that_cannot_be_told_is_obeyed_after_the_epoch(broken, monkeypatch):
    def refuse(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device")

    with stopping.command(), monkeypatch.context() as patch:
        patch.setattr(broken, refuse)
        os.kill(os.getpid(), signal.SIGTERM)
        assert stopping.requested() == signal.SIGTERM


CHILD = """
import os, signal
from symo_exp.process import stopping
os.kill(os.getpid(), signal.SIGINT)
print("goes on")
stopping.install()
print(stopping.requested() == signal.SIGINT)
"""


def test_a_child_is_deaf_until_it_has_its_handlers_and_the_command_is_not():
    with stopping.command(), stopping.deaf_children():
        told = subprocess.run([sys.executable, "-c", CHILD], capture_output=True, text=True)
        assert told.stdout.split("\n")[:2] == ["goes on", "True"], told.stderr
        os.kill(os.getpid(), signal.SIGINT)
        end = time.monotonic() + 10.0
        while stopping.requested() is None and time.monotonic() < end:
            time.sleep(0.01)
        assert stopping.requested() == signal.SIGINT
