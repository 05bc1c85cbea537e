"""Telling a living process from a dead one, and from its successor with the same id."""

import os
import socket
import subprocess
import sys

import pytest

from symo_exp.tracking.process import HOST, PID, STARTED, identity, is_dead


def test_this_process_lives():
    assert not is_dead(identity())


def test_a_process_that_has_ended_is_dead():
    child = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    tags = identity(child.pid)
    assert not is_dead(tags)
    child.communicate(b"\n")
    assert is_dead(tags)


def test_an_id_that_is_used_again_does_not_revive_the_dead():
    tags = identity()
    boot, namespace, ticks = tags[STARTED].split("/")
    assert is_dead(tags | {STARTED: f"{boot}/{namespace}/{int(ticks) - 1}"})


def test_a_restarted_machine_has_no_survivors():
    _, namespace, ticks = identity()[STARTED].split("/")
    assert is_dead(identity() | {STARTED: f"another-boot/{namespace}/{ticks}"})


def test_what_cannot_be_known_is_not_dead():
    boot, namespace, ticks = identity()[STARTED].split("/")
    gone = identity() | {STARTED: f"{boot}/{namespace}/{int(ticks) - 1}"}
    assert is_dead(gone)
    assert not is_dead(gone | {HOST: "elsewhere"})
    assert not is_dead(gone | {STARTED: f"{boot}/pid:[another container]/{ticks}"})
    assert not is_dead({})


@pytest.mark.parametrize(
    ("pid", "dead"), [(os.getpid(), False), (999999999, True)], ids=["ours", "none"]
)
def test_without_proc_the_id_must_do(pid, dead):
    assert is_dead({HOST: socket.gethostname(), PID: str(pid), STARTED: ""}) is dead
