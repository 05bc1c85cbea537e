"""A command that is killed repeatedly and rerun ends like one that was not."""

import random
import time

import pytest
import torch

from symo_exp.runs.folder import RunFolder
from symo_exp.runs.series import read
from tests.faults.commands import Command, go, stored
from tests.tiny import TINY, copy_store
from tests.training.runs import CLOCKS

WORDS = [
    *TINY, "trainer.max_epochs=12", "trainer.validate_every=2", "trainer.checkpoint_every=0",
    "pictures=false", "logger.flush_seconds=0.2",
]  # fmt: skip
METHODS = [
    "model=node integrator=rk4",
    "model=l_node",
    "model=symo",
    "model=e2e_symo",
    "model=node optimizer=lbfgs scheduler=none",
    "model=symo dtype=float64 optimizer=levenberg_marquardt scheduler=none",
    "model=symo dtype=float64 optimizer=adam_then_lm optimizer.epochs=6 scheduler=none",
]


def kill_until_it_ends(folder, words, *, kills, span, rng):
    """Kill at random moments; then let it end. Returns how many were killed at work."""
    killed = 0
    while killed < kills:
        command = Command(folder, *words)
        command.process.join(rng.uniform(0.0, span))
        if not command.process.is_alive():
            assert command.wait() == 0, command.said
            words = [*words, "resume=false"]  # it got through: once more from the start
            continue
        command.kill()
        words = [word for word in words if word != "resume=false"]
        killed += 1
    words = [word for word in words if word != "resume=false"]
    code, said = go(folder, *words)
    assert code == 0, said
    return killed


def left(folder):
    """All that a run leaves, but for times and names."""
    (run,) = map(RunFolder, (folder / "outputs" / "default").glob("*-pendulum-*"))
    checkpoint = torch.load(run / "checkpoints" / "last.ckpt", weights_only=True)
    client, runs = stored(folder)
    (row,) = [r for r in runs if r.data.tags.get("symo_exp.run") == run.about().identity]
    assert row.info.status == "FINISHED"
    assert run.published()["run_id"] == row.info.run_id
    told = {
        name: sorted((m.step, m.value) for m in client.get_metric_history(row.info.run_id, name))
        for name in row.data.metrics
        if name not in CLOCKS
    }
    rows = [{k: v for k, v in r.items() if k not in CLOCKS} for r in read(run / "series.csv")]
    return {
        "status": run.outcome().status,
        "files": {name: (run / name).read_bytes() for name in ("metrics.json", "rollouts.parquet")},
        "weights": {name: value.tolist() for name, value in checkpoint["state_dict"].items()},
        "series": rows,
        "told": told,
        "parameters": {k: v for k, v in row.data.params.items() if k != "resume"},
        "artifacts": sorted(f.path for f in client.list_artifacts(row.info.run_id)),
        "open": [r.info.run_id for r in runs if r.info.status in ("RUNNING", "SCHEDULED")],
    }  # fmt: skip


def compare(tmp_path, words, kills, seed, database=None):
    for name in ("whole", "killed"):
        (tmp_path / name).mkdir()
        if database is not None:
            copy_store(database, tmp_path / name)
    go(tmp_path, "--version")  # now all is imported
    start = time.monotonic()
    code, said = go(tmp_path / "whole", *words)
    assert code == 0, said
    span = time.monotonic() - start
    rng = random.Random(seed)
    assert kill_until_it_ends(tmp_path / "killed", words, kills=kills, span=span, rng=rng) == kills
    whole, killed = left(tmp_path / "whole"), left(tmp_path / "killed")
    for name, value in whole.items():
        assert killed[name] == value, (name, seed)
    assert whole["open"] == []
    assert len(whole["series"]) == len(whole["told"]["train_loss"]) == 12


def test_a_killed_run_ends_like_one_that_was_not(tmp_path, database):
    compare(tmp_path, [*WORDS, "model=node"], kills=1, seed=0, database=database)


@pytest.mark.slow
@pytest.mark.parametrize("words", METHODS)
def test_a_run_killed_eight_times_ends_like_one_that_was_not(words, tmp_path):
    compare(tmp_path, [*WORDS, *words.split()], kills=8, seed=METHODS.index(words))
