"""SIGINT and SIGTERM: the first ends a run after its epoch, the second at once."""

import signal
import subprocess
import time

import pytest

from symo_exp.runs.folder import RunFolder
from tests.faults.commands import Command, go, statuses, stored
from tests.faults.test_kills import WORDS, left
from tests.tiny import copy_store

ENDLESS = [*WORDS, "model=node", "trainer.max_epochs=100000", "trainer.compile=false"]


def started(folder, *words):
    """A command that is training."""
    command = Command(folder, *ENDLESS, *words)
    command.wait_for(lambda: [*folder.rglob("last.ckpt")])
    return command


@pytest.mark.parametrize(
    "signum", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)]
)
def test_one_signal_ends_a_run_after_its_epoch(signum, tmp_path, database):
    copy_store(database, tmp_path)
    command = started(tmp_path)
    command.signal(signum)
    assert command.wait() == 128 + signum
    assert f"interrupted by {signum.name}" in command.said
    assert command.said.count("stopping after this epoch; rerun the command") == 1
    assert "Traceback" not in command.said
    _, (run,) = stored(tmp_path)
    told = run.info.status, run.data.tags["reason"]
    assert told == ("KILLED", f"interrupted by {signum.name}")
    assert statuses(tmp_path) == ["interrupted"]

    again = Command(tmp_path, *ENDLESS)  # it goes on from there
    again.wait_for(lambda: "resuming after epoch" in again.said)
    again.signal(signum)
    assert again.wait() == 128 + signum


@pytest.mark.slow
def test_a_stopped_run_ends_like_one_that_was_not(tmp_path):
    words = [*WORDS, "model=symo", "trainer.max_epochs=40", "trainer.compile=false"]
    (tmp_path / "whole").mkdir()
    (tmp_path / "cut").mkdir()
    assert go(tmp_path / "whole", *words)[0] == 0
    command = Command(tmp_path / "cut", *words)
    command.wait_for(lambda: [*tmp_path.glob("cut/**/last.ckpt")])
    command.signal(signal.SIGINT)
    assert command.wait() == 130
    assert go(tmp_path / "cut", *words)[0] == 0
    assert left(tmp_path / "cut") == left(tmp_path / "whole")


@pytest.mark.slow
def test_two_signals_end_a_run_at_once(tmp_path):
    # an epoch of 8192 steps
    words = ["model=e2e_symo", "data.n_traj=512", "data.n_train_max=512", "data.n_steps=16",
             "data.batch_size=1"]  # fmt: skip
    command = Command(tmp_path, *ENDLESS, *words)
    command.wait_for(lambda: [*tmp_path.rglob("*.npz")])
    time.sleep(3.0)
    command.signal(signal.SIGINT)
    time.sleep(0.5)
    assert command.process.is_alive(), command.said
    before = time.monotonic()
    command.signal(signal.SIGINT)
    assert command.wait() == 130, command.said
    assert time.monotonic() - before < 10.0
    assert not [*tmp_path.rglob("last.ckpt")]


@pytest.mark.slow
@pytest.mark.parametrize(("signum", "group"), [(signal.SIGINT, True), (signal.SIGTERM, False)])
def test_a_signal_ends_parallel_jobs_after_their_epochs(signum, group, tmp_path):
    """Ctrl-C reaches all processes, SIGTERM the first one only: all of them finish their epoch."""
    command = Command(tmp_path, *ENDLESS, "-m", "seed=0,1,2,3", "hydra/launcher=joblib",
                      "hydra.launcher.n_jobs=2")  # fmt: skip
    command.wait_for(lambda: len([*tmp_path.rglob("last.ckpt")]) == 2)
    command.signal(signum, group=group)
    assert command.wait() == 128 + signum
    assert statuses(tmp_path) == ["interrupted", "interrupted"]
    assert command.said.count("waiting: seed=") == 2


def workers(command):
    """The processes of joblib that a command has started."""
    ps = ["ps", "-ww", "-o", "args=", "-g", str(command.pid)]
    told = subprocess.run(ps, capture_output=True, text=True).stdout
    return [line for line in told.splitlines() if "LokyProcess" in line]


@pytest.mark.slow
@pytest.mark.parametrize("signals", [1, 2])
def test_ctrl_c_while_workers_start_prints_no_traceback(signals, tmp_path):
    command = Command(tmp_path, *ENDLESS, "-m", "seed=0,1,2,3", "hydra/launcher=joblib",
                      "hydra.launcher.n_jobs=2")  # fmt: skip
    command.wait_for(lambda: len(workers(command)) == 2)
    for _ in range(signals):
        time.sleep(0.3)  # they import libraries
        command.signal(signal.SIGINT, group=True)
    assert command.wait() == 130
    assert "Traceback" not in command.said
    end = time.monotonic() + 60.0
    while workers(command) and time.monotonic() < end:
        time.sleep(0.1)
    assert not workers(command)
    assert set(statuses(tmp_path)) <= {"waiting", "interrupted"}


@pytest.mark.slow
def test_a_signal_ends_the_second_sweep_of_a_command_too(tmp_path):
    """Its jobs are done by the workers of the first one."""
    (tmp_path / "mine").mkdir()
    for name, epochs in (("a", 1), ("b", 100000)):
        (tmp_path / "mine" / f"{name}.yaml").write_text(
            "defaults: [config, {override hydra/launcher: joblib}, _self_]\n"
            f"trainer: {{max_epochs: {epochs}}}\n"
            "hydra: {launcher: {n_jobs: 2}, sweeper: {params: {seed: '0,1,2,3'}}}\n"
        )
    (tmp_path / "mine" / "both.yaml").write_text("sweeps: [a, b]\n")
    words = [word for word in ENDLESS if not word.startswith("trainer.max_epochs")]
    command = Command(tmp_path, "--config-dir", "mine", "-cn", "both", *words)
    command.wait_for(lambda: len([*tmp_path.glob("outputs/*/*/*/last.ckpt")]) == 6)
    command.signal(signal.SIGINT, group=True)
    assert command.wait() == 130
    assert sorted(statuses(tmp_path)) == ["finished"] * 4 + ["interrupted"] * 2
    runs = [RunFolder(path.parent).about() for path in tmp_path.rglob("run.json")]
    assert len({run.sweep for run in runs if run.sweep}) == 2
