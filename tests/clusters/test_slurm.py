"""Sweeps through SLURM, on a real cluster of one node that is started for them."""

import json
import os
import signal

import pytest
import torch

from symo_exp.tracking.store import connect, find
from tests.clusters.slurm import cluster, missing
from tests.faults.commands import Command, go
from tests.tiny import TINY
from tests.training.runs import CLOCKS

pytestmark = pytest.mark.slurm

WORDS = [
    *TINY, "model=node", "trainer.validate_every=1000", "trainer.compile=false", "pictures=false",
    "experiment=sweep",
]  # fmt: skip
SLURM = ["hydra/launcher=submitit_slurm_cpu", "hydra.launcher.mem_gb=1"]


@pytest.fixture(scope="module")
def started(tmp_path_factory):
    reason = missing()
    if reason:
        pytest.skip(reason)
    with cluster(tmp_path_factory.mktemp("slurm")) as there:
        yield there


@pytest.fixture
def slurm(started):
    """The cluster; a test that fails leaves no job to the next one."""
    yield started
    started.clear()


def runs(folder):
    """The folder of each run of the sweep, by its number of epochs and its seed."""
    found = {}
    for path in folder.glob("outputs/sweep/*-*/outcome.json"):
        run = path.parent
        outcome = json.loads((run / "outcome.json").read_text())
        if not (run / "run.json").exists():
            continue
        value = json.loads((run / "run.json").read_text())["parameters"]
        found[value["trainer.max_epochs"], value["seed"]] = run, outcome
    return found


def tracked(folder, run):
    """The store, and the run in it."""
    client = connect(find(None, folder / "mlruns"))
    return client, client.get_run(json.loads((run / "published.json").read_text())["run_id"])


def told(folder, run):
    """Status and series of a run in the store."""
    client, kept = tracked(folder, run)
    series = {
        name: [(row.step, row.value) for row in client.get_metric_history(kept.info.run_id, name)]
        for name in kept.data.metrics
        if name not in CLOCKS
    }
    return kept.info.status, {name: sorted(rows) for name, rows in series.items()}


def weights(run):
    state = torch.load(run / "checkpoints" / "last.ckpt", weights_only=True)["state_dict"]
    return {name: value.tolist() for name, value in state.items()}


def epochs_in(seconds, folder):
    """Return the number of epochs that a run does on this machine in a time [s]."""
    folder.mkdir()
    assert go(folder, *WORDS, "trainer.max_epochs=2000")[0] == 0
    ((run, _),) = runs(folder).values()
    return int(2000 * seconds / tracked(folder, run)[1].data.metrics["training_seconds"])


def test_jobs_at_their_time_limit_are_queued_again_and_end_the_same(slurm, tmp_path):
    """Two of eight jobs need longer than they may. They are told, save, are queued again, and end
    with what they would have had without a limit."""
    long = epochs_in(75.0, tmp_path / "pace")
    epochs = [20, 21, 22, 23, 24, 25, long, long + 1]
    sweep = tmp_path / "sweep"
    sweep.mkdir()
    command = Command(
        sweep, *WORDS, *SLURM, "-m", f"trainer.max_epochs={','.join(map(str, epochs))}",
        "trainer.checkpoint_every=1", "hydra.launcher.signal_delay_s=90", env=slurm.env,
    )  # fmt: skip

    def process(length):
        """Of a job that is training."""
        for run, outcome in runs(sweep).values():
            if (
                json.loads((run / "run.json").read_text())["parameters"]["trainer.max_epochs"]
                == length
            ):
                return (run / "checkpoints" / "last.ckpt").exists() and outcome["process"]
        return None

    limited = []
    for length in (long, long + 1):
        command.wait_for(lambda length=length: process(length), timeout=1500.0)
        limited.append(process(length)["slurm_job"])
        slurm.limit(limited[-1], minutes=slurm.minutes(limited[-1]) + 2)
    for job in limited:
        command.wait_for(lambda job=job: slurm.restarts(job) >= 1, timeout=600.0)
        if job in slurm.queue():  # while the other one was waited for, it may have ended
            slurm.limit(job, minutes=240)
    code = command.wait(timeout=1500.0)
    assert code == 0, command.said
    found = runs(sweep)
    assert sorted(n for n, _ in found) == epochs
    assert {outcome["status"] for _, outcome in found.values()} == {"finished"}
    (array,) = {job.partition("_")[0] for job in limited}
    assert [slurm.restarts(f"{array}_{i}") for i in range(8)] == [0] * 6 + [1] * 2

    whole = tmp_path / "whole"
    whole.mkdir()
    assert go(whole, *WORDS, f"trainer.max_epochs={long}")[0] == 0
    (run, _), (expected, _) = found[long, 0], runs(whole)[long, 0]
    assert weights(run) == weights(expected)
    assert (run / "rollouts.parquet").read_bytes() == (expected / "rollouts.parquet").read_bytes()
    assert told(sweep, run) == told(whole, expected)
    assert told(sweep, run)[0] == "FINISHED"


ENDLESS = [*WORDS, *SLURM, "trainer.max_epochs=1000000", "trainer.checkpoint_every=0"]


def test_a_killed_job_is_sent_again_and_resumes(slurm, tmp_path):
    """The others finish; it is sent again once, and goes on from its checkpoint."""
    words = [*WORDS, *SLURM, "-m", "trainer.max_epochs=30,1000000", "trainer.checkpoint_every=0"]
    command = Command(tmp_path, *words, env=slurm.env)
    command.wait_for(lambda: len([*tmp_path.rglob("last.ckpt")]) == 2)
    run, outcome = runs(tmp_path)[1000000, 0]
    assert outcome["process"]["slurm_job"].endswith("_1")
    os.kill(int(outcome["process"]["pid"]), signal.SIGKILL)
    log = run / "symo_exp.log"
    command.wait_for(lambda: log.exists() and "resuming after epoch" in log.read_text())
    assert "a worker was killed" in command.said
    command.signal(signal.SIGINT)
    assert command.wait() == 130, command.said
    found = runs(tmp_path)
    assert found[30, 0][1]["status"] == "finished"
    assert found[1000000, 0][1]["status"] == "interrupted"
    assert told(tmp_path, run)[0] == "KILLED"


def test_an_interrupted_sweep_finishes_epochs_and_starts_no_job(slurm, tmp_path):
    """Running jobs finish their epoch, waiting jobs do not begin."""
    words = [*ENDLESS, "-m", "seed=0,1,2,3"]
    command = Command(tmp_path, *words, env=slurm.env)
    command.wait_for(lambda: len([*tmp_path.rglob("last.ckpt")]) == 2)
    command.signal(signal.SIGINT)
    assert command.wait() == 130, command.said
    assert [outcome["status"] for _, outcome in runs(tmp_path).values()] == ["interrupted"] * 2
    assert command.said.count("waiting: seed=") == 2
    assert not slurm.queue()


def test_a_graphics_processor_is_asked_for_on_the_node(slurm, tmp_path):
    """The node on which the command is typed needs no GPU."""
    words = [*WORDS, "-m", "seed=0", "hydra/launcher=submitit_slurm_gpu", "hydra.launcher.mem_gb=1"]
    code, said = go(tmp_path, *words, "trainer=cpu", env=slurm.env)
    assert code == 0, said
    (job,) = {path.name for path in tmp_path.glob("outputs/sweep/.submitit/[0-9]*")}
    assert "gpu:1" in slurm.ask("scontrol", "show", "job", job)
    if not torch.cuda.is_available():
        code, said = go(tmp_path, *words, "trainer=gpu", env=slurm.env)
        assert code == 2
        (line,) = [line for line in said.splitlines() if line.startswith("symo_exp: error: ")]
        assert "trainer.accelerator=gpu, but PyTorch finds no GPU here" in line
