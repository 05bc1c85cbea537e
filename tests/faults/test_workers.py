"""Parallel jobs of which one is killed, runs out of memory or fails."""

import json
import os
import signal
import threading
import time
from contextlib import suppress
from pathlib import Path

import pytest

from tests.faults.commands import PATIENCE, Command, go, statuses, stored
from tests.tiny import TINY

WORDS = [
    *TINY, "model=node", "trainer.max_epochs=300", "trainer.compile=false",
    "trainer.checkpoint_every=0", "pictures=false",
]  # fmt: skip
SWEEP = ["-m", "seed=0,1,2,3", "hydra/launcher=joblib", "hydra.launcher.n_jobs=2"]

pytestmark = pytest.mark.slow


def outcomes(folder):
    """By seed."""
    found = {}
    for path in folder.rglob("outcome.json"):
        with suppress(OSError, ValueError):  # it is being written
            about = json.loads((path.parent / "run.json").read_text())
            found[int(about["parameters"].get("seed", -1))] = json.loads(path.read_text())
    found.pop(-1, None)  # the sweep itself
    return found


def tracked(folder):
    """Status and reason of each job's run, by seed."""
    _, runs = stored(folder)
    return {
        int(r.data.params["seed"]): (r.info.status, r.data.tags.get("reason"))
        for r in runs
        if "seed" in r.data.params
    }


class Assassin(threading.Thread):
    """Kills the process of one job whenever it has written a new checkpoint, so many times."""

    def __init__(self, folder, seed, times):
        super().__init__(daemon=True)
        self.folder, self.seed, self.times, self.killed = folder, seed, times, []

    def run(self):
        end = time.monotonic() + PATIENCE
        while len(self.killed) < self.times and time.monotonic() < end:
            time.sleep(0.02)
            try:
                outcome = outcomes(self.folder).get(self.seed, {})
            except (OSError, ValueError):
                continue
            pid = int(outcome.get("process", {}).get("pid", 0))
            trains = [*self.folder.rglob("last.ckpt")]
            if outcome.get("status") == "running" and trains and pid not in self.killed:
                os.kill(pid, signal.SIGKILL)
                self.killed.append(pid)


def swept_and_killed(tmp_path, times):
    """The exit code of a sweep and what it said, after a job was killed so many times."""
    assassin = Assassin(tmp_path, seed=1, times=times)
    assassin.start()
    end = go(tmp_path, *WORDS, *SWEEP)
    assert len(assassin.killed) == times
    return end


def test_a_job_whose_worker_is_killed_once_is_started_again(tmp_path):
    code, said = swept_and_killed(tmp_path, times=1)
    assert code == 0, said
    assert "a worker was killed" in said
    assert statuses(tmp_path) == ["finished"] * 4
    assert tracked(tmp_path) == dict.fromkeys(range(4), ("FINISHED", None))


def test_a_job_whose_process_is_killed_each_time_has_failed(tmp_path):
    code, said = swept_and_killed(tmp_path, times=2)
    assert code == 1, said
    reason = "its process was killed, perhaps for want of memory"
    assert f"failed: seed=1: {reason}" in said
    found = {k: o["status"] for k, o in outcomes(tmp_path).items()}
    assert found == {0: "finished", 1: "failed", 2: "finished", 3: "finished"}
    assert tracked(tmp_path)[1] == ("FAILED", reason)
    assert go(tmp_path, *WORDS, *SWEEP)[0] == 0  # rerunning tries it again
    assert tracked(tmp_path)[1] == ("FINISHED", None)


def test_workers_end_with_a_command_that_is_killed(tmp_path):
    command = Command(tmp_path, *WORDS, *SWEEP)
    command.wait_for(lambda: len([*tmp_path.rglob("last.ckpt")]) >= 2)
    workers = {o["process"]["pid"] for o in outcomes(tmp_path).values() if "process" in o}
    assert len(workers) == 2
    os.kill(command.pid, signal.SIGKILL)
    end = time.monotonic() + 60.0
    while any(Path(f"/proc/{pid}").exists() for pid in workers) and time.monotonic() < end:
        time.sleep(0.1)
    left = [pid for pid in workers if Path(f"/proc/{pid}").exists()]
    command.kill()
    assert not left
    assert go(tmp_path, *WORDS, *SWEEP)[0] == 0
    assert statuses(tmp_path) == ["finished"] * 4


@pytest.mark.parametrize("launcher", ["basic", "joblib"])
def test_a_job_that_runs_out_of_memory_does_not_stop_the_others(launcher, tmp_path):
    # 400 million weights in four copies are more than the process may have
    words = [*TINY, "model=node", "pictures=false", "-m", "net.width=8,20000,9"]
    command = Command(tmp_path, *words, f"hydra/launcher={launcher}", memory=5 * 2**30)
    assert command.wait() == 1, command.said
    (line,) = [line for line in command.said.splitlines() if line.startswith("failed: ")]
    assert "net.width=20000" in line
    assert "memory" in line
    log = Path(line.rpartition("(log: ")[2].rstrip(")"))
    assert "Traceback" in log.read_text()
    assert statuses(tmp_path) == ["failed", "finished", "finished"]
