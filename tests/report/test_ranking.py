"""Ranks of runs whose order is known."""

import math

import numpy as np
import pandas as pd
import pytest

from symo_exp.report.ranking import ranking

PAIRS = [("node", "rk4"), ("l_node", "rk4"), ("symo", "midpoint"), ("e2e_symo", "midpoint")]
BEST = PAIRS[2]


def made(values, *, seeds=range(3), metric="test_mse", pairs=PAIRS):
    """``values(pair, seed)`` for every pair and seed."""
    rows = [
        {"system": "pendulum", "n_traj": 32.0, "noise_std": 0.0, "seed": seed, "source": "ours",
         "method": pair[0], "integrator": pair[1], "metric": metric, "value": values(pair, seed)}
        for pair in pairs for seed in seeds
    ]  # fmt: skip
    return pd.DataFrame(rows)


def test_who_always_wins_has_rank_one_without_doubt():
    found = ranking(made(lambda pair, seed: 1.0 if pair == BEST else 2.0 + seed), "test_mse")
    first, others = found.iloc[0], found.iloc[1:]
    assert (first.method, first.integrator) == BEST
    assert (first["rank"], first.low, first.high, first.best) == (1.0, 1.0, 1.0, 1.0)
    assert set(others["rank"]) == {3.0}  # they tie
    assert set(found.blocks) == {3}


def test_chance_widens_the_interval():
    generator = np.random.default_rng(0)
    found = ranking(made(lambda *_: generator.random(), seeds=range(40)), "test_mse")
    assert (found.low < found["rank"]).all()
    assert (found["rank"] < found.high).all()
    assert found["rank"].mean() == pytest.approx(2.5)


def test_only_blocks_with_all_methods_are_compared():
    runs = made(lambda pair, seed: float(seed))
    lost = (runs.seed == 1) & (runs.method == "node")
    assert set(ranking(runs[~lost], "test_mse").blocks) == {2}
    assert ranking(runs, "energy_mse").empty
    assert len(ranking(runs[runs.method != "node"], "test_mse")) == 3


def test_a_diverged_run_is_last():
    found = ranking(made(lambda pair, _: math.inf if pair == BEST else 1.0), "test_mse")
    assert tuple(found.iloc[-1][["method", "integrator"]]) == BEST
