"""The status line: on a terminal only, and of one process."""

import fcntl
import io
import os
import subprocess
import sys
import termios

import pytest

from symo_exp.process import phases

SAY = "import time; from symo_exp.process import phases; phases.say('busy'); time.sleep(1)"


@pytest.fixture(autouse=True)
def xterm(monkeypatch):
    monkeypatch.setenv("TERM", "xterm")


@pytest.mark.parametrize(("terminal", "kind"), [(True, "xterm"), (False, "xterm"), (True, "dumb")])
def test_a_status_is_shown_on_a_terminal_that_erases_and_erased(terminal, kind, monkeypatch):
    monkeypatch.setenv("TERM", kind)
    said = io.StringIO()
    said.isatty = lambda: terminal
    monkeypatch.setattr(sys, "stderr", said)
    phases.say("measuring " + 100 * "x")
    phases.clear()
    *_, last = said.getvalue().split(phases.ERASED)
    assert last == ""
    assert ("measuring" in said.getvalue()) == (terminal and kind != "dumb")
    assert kind != "dumb" or not said.getvalue()
    assert all(len(part) <= 80 for part in said.getvalue().split(phases.ERASED))


@pytest.mark.parametrize(("columns", "longest"), [(50, 50), (80, 80), (200, 80), (0, 80)])
def test_a_status_fits_in_a_line_of_the_terminal(columns, longest, monkeypatch):
    said = io.StringIO()
    said.isatty, said.fileno = lambda: True, lambda: 2
    monkeypatch.setattr(sys, "stderr", said)
    monkeypatch.setattr(os, "get_terminal_size", lambda _: os.terminal_size((columns, 24)))
    phases.say("measuring " + 100 * "x")
    assert len(said.getvalue().removeprefix(phases.ERASED)) == longest


@pytest.mark.parametrize(
    ("script", "shown"),
    [
        ('"$0" -c "$1"', 1),
        ('"$0" -c "$1" & "$0" -c "$1" & wait', 1),  # in one process group
        ('set -m; "$0" -c "$1" & wait', 0),  # in the background
    ],
)
def test_one_process_has_the_status_of_a_terminal(script, shown):
    ours, theirs = os.openpty()
    subprocess.run(
        ["sh", "-c", script, sys.executable, SAY],
        stdin=theirs, stderr=theirs, start_new_session=True, check=True,
        preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),
    )  # fmt: skip
    os.close(theirs)
    os.set_blocking(ours, False)
    try:
        said = os.read(ours, 4096)
    except OSError:  # nothing was written
        said = b""
    os.close(ours)
    assert said.count(b"busy") == shown
