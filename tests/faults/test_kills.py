"""A command that is killed again and again, then given once more, ends as if nothing had been."""

import json
import random
import time

import pytest
import torch

from symo_exp.tracking.store import connect, find
from tests.faults.commands import Command, go
from tests.tiny import TINY

WORDS = [
    *TINY, "trainer.max_epochs=12", "trainer.validate_every=2", "trainer.checkpoint_every=0",
    "pictures=false", "logger.flush_seconds=0.2",
]  # fmt: skip
CLOCKS = {"step_ms", "training_seconds"}
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
    (run,) = (folder / "outputs" / "default").glob("*-pendulum-*")
    checkpoint = torch.load(run / "checkpoints" / "last.ckpt", weights_only=True)
    outcome = json.loads((run / "outcome.json").read_text())
    store = find(None, folder / "mlruns")
    client = connect(store)
    experiment = client.get_experiment_by_name("default")
    runs = client.search_runs([experiment.experiment_id], "attributes.status = 'FINISHED'")
    kept = json.loads((run / "tracking.json").read_text())["run_id"]
    (row,) = [r for r in runs if r.info.run_id == kept]
    series = {
        name: [(m.step, m.value) for m in client.get_metric_history(kept, name)]
        for name in row.data.metrics
        if name not in CLOCKS
    }
    return {
        "status": outcome["status"],
        "measures": {name: str(value) for name, value in outcome["measures"].items()},
        "files": {name: (run / name).read_bytes() for name in ("metrics.json", "rollouts.parquet")},
        "weights": {name: value.tolist() for name, value in checkpoint["state_dict"].items()},
        "series": {name: sorted(rows) for name, rows in series.items()},
        "parameters": {k: v for k, v in row.data.params.items() if k != "resume"},
        "artifacts": sorted(f.path for f in client.list_artifacts(kept)),
        "open": [r.info.run_id for r in client.search_runs([experiment.experiment_id])
                 if r.info.status == "RUNNING"],
    }  # fmt: skip


def compare(tmp_path, words, kills, seed):
    for name in ("whole", "killed"):
        (tmp_path / name).mkdir()
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
    assert len(whole["series"]["train_loss"]) == 12


def test_two_kills(tmp_path):
    compare(tmp_path, [*WORDS, "model=e2e_symo"], kills=2, seed=0)


@pytest.mark.slow
@pytest.mark.parametrize("words", METHODS)
def test_eight_kills(words, tmp_path):
    compare(tmp_path, [*WORDS, *words.split()], kills=8, seed=METHODS.index(words))
