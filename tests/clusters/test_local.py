"""Sweeps through submitit on this machine: a job that fails does not stop the others."""

import importlib.util
import json
import os
import signal

import pytest

from tests.faults.commands import Command, go, statuses
from tests.faults.test_workers import outcomes, tracked
from tests.tiny import TINY

pytestmark = [
    pytest.mark.slurm,
    pytest.mark.skipif(
        importlib.util.find_spec("submitit") is None,
        reason="submitit is not installed: pip install 'symo_exp[cluster]'",
    ),
]

WORDS = [
    *TINY, "model=node", "trainer.max_epochs=300", "trainer.compile=false",
    "trainer.checkpoint_every=0", "pictures=false", "-m", "hydra/launcher=submitit_local",
]  # fmt: skip


def trains(folder, seed):
    """Return whether the job has opened its run and finished an epoch."""
    running = outcomes(folder).get(seed, {}).get("status") == "running"
    return running and any(
        json.loads((path.parents[1] / "run.json").read_text())["parameters"]["seed"] == seed
        for path in folder.rglob("last.ckpt")
    )


def test_a_killed_job_is_started_again(tmp_path):
    command = Command(tmp_path, *WORDS, "seed=0,1,2")
    command.wait_for(lambda: trains(tmp_path, seed=1))
    os.kill(int(outcomes(tmp_path)[1]["process"]["pid"]), signal.SIGKILL)
    assert command.wait() == 0, command.said  # it is started again, once
    assert "a worker was killed" in command.said
    assert statuses(tmp_path) == ["finished"] * 3
    assert tracked(tmp_path) == dict.fromkeys(range(3), ("FINISHED", None))


def test_a_job_that_diverges_does_not_stop_the_others(tmp_path):
    code, said = go(tmp_path, *WORDS, "optimizer.lr=1e-3,1e30", "learner.gradient_clip=null")
    assert code == 1
    (line,) = [line for line in said.splitlines() if line.startswith("failed: ")]
    assert "optimizer.lr=1e+30" in line or "optimizer.lr=1e30" in line
    assert statuses(tmp_path) == ["failed", "finished"]


def test_jobs_of_an_interrupted_sweep_finish_their_epochs(tmp_path):
    """Ctrl-C reaches all processes of the terminal; every job finishes its epoch."""
    command = Command(tmp_path, *WORDS, "seed=0,1", "trainer.max_epochs=1000000")
    command.wait_for(lambda: len([*tmp_path.rglob("last.ckpt")]) == 2)
    command.signal(signal.SIGINT, group=True)
    assert command.wait() == 130, command.said
    assert {o["status"] for o in outcomes(tmp_path).values()} == {"interrupted"}
    assert {status for status, _ in tracked(tmp_path).values()} == {"KILLED"}
