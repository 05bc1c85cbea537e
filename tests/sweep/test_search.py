"""Sweepers of other people get a number from each run."""

import json
import math

import pytest

from symo_exp.__main__ import main
from tests.tiny import TINY

pytest.importorskip("hydra_plugins.hydra_optuna_sweeper")

QUIET = [*TINY, "logger=none", "pictures=false", "model=node"]
SEARCH = [*QUIET, "hydra/sweeper=optuna", "hydra.sweeper.n_trials=3", "hydra.sweeper.n_jobs=1"]


def trials(workplace):
    return [json.loads(path.read_text()) for path in workplace.rglob("metrics.json")]


def best(workplace):
    import yaml

    (file,) = workplace.rglob("optimization_results.yaml")
    return yaml.safe_load(file.read_text())


def test_the_least_of_a_measure_is_found(workplace):
    words = ["optimized_metric=test_mse", "learning_rate=interval(1e-4,1e-1)"]
    assert main([*SEARCH, *words]) == 0
    assert best(workplace)["best_value"] == min(one["test_mse"] for one in trials(workplace))
    assert len(trials(workplace)) == 3


def test_a_run_that_diverges_is_the_worst_and_ends_nothing(workplace):
    words = ["learning_rate=choice(1e30,1e-3)", "hydra.sweeper.n_trials=4",
             "+hydra.sweeper.sampler.seed=1"]  # fmt: skip
    assert main([*SEARCH, *words]) == 0
    assert math.isfinite(best(workplace)["best_value"])
    assert best(workplace)["best_params"] == {"learning_rate": 1e-3}


def test_a_number_that_there_is_not_is_named(workplace, capsys):
    assert main([*SEARCH, "optimized_metric=nonsense", "learning_rate=choice(1e-3)"]) == 2
    line = capsys.readouterr().err.strip().splitlines()[-1]  # Hydra has its own before it
    assert line.startswith("symo_exp: error: ")
    assert "optimized_metric=nonsense" in line
    assert "val_loss" in line


def test_the_search_that_ships(workplace):
    small = [word for word in TINY if not word.startswith("model.width")]
    assert main(["-cn", "search", *small, "logger=none", "hydra.sweeper.n_trials=2"]) == 0
    assert set(best(workplace)["best_params"]) == {"model.width", "learning_rate"}
