"""Ranks and statements on runs whose order is known."""

import math

import numpy as np
import pandas as pd
import pytest

from symo_exp.report import claims
from symo_exp.report.claims import CLAIMS, judge
from symo_exp.report.labels import PAIRS
from symo_exp.report.ranking import ranking

BEST = ("symo", "midpoint")


def made(values, *, seeds=range(3), systems=("pendulum",), metric="test_mse", **cell):
    """``values(pair, seed)`` for every pair, system and seed."""
    rows = [
        {"system": system, "n_traj": 32, "noise_std": 0.0, **cell, "seed": seed,
         "method": pair[0], "integrator": pair[1], "metric": metric, "value": values(pair, seed)}
        for pair in PAIRS for system in systems for seed in seeds
    ]  # fmt: skip
    return pd.DataFrame(rows)


def test_who_always_wins_has_rank_one_without_doubt():
    found = ranking(made(lambda pair, seed: 1.0 if pair == BEST else 2.0 + seed), "test_mse")
    first, others = found.iloc[0], found.iloc[1:]
    assert (first.method, first.integrator) == BEST
    assert (first["rank"], first.low, first.high, first.best) == (1.0, 1.0, 1.0, 1.0)
    assert set(others["rank"]) == {4.0}  # they tie
    assert set(found.blocks) == {3}


def test_chance_widens_the_interval():
    generator = np.random.default_rng(0)
    found = ranking(made(lambda *_: generator.random(), seeds=range(40)), "test_mse")
    assert (found.low < found["rank"]).all()
    assert (found["rank"] < found.high).all()
    assert found.low.min() < 3.5 < found.high.max()
    assert found["rank"].mean() == pytest.approx(3.5)


def test_only_blocks_with_all_methods_are_compared():
    runs = made(lambda pair, seed: float(seed), seeds=range(3))
    lost = (runs.seed == 1) & (runs.method == "node")
    assert set(ranking(runs[~lost], "test_mse").blocks) == {2}
    assert ranking(runs[lost | (runs.seed == 9)], "energy_mse").empty


def test_a_diverged_run_is_last():
    found = ranking(made(lambda pair, _: math.inf if pair == BEST else 1.0), "test_mse")
    assert tuple(found.iloc[-1][["method", "integrator"]]) == BEST


def test_a_method_without_the_measure_does_not_hinder_the_others():
    runs = made(lambda pair, seed: 1.0, metric="inertia_mse")
    assert len(ranking(runs[runs.method != "node"], "inertia_mse")) == 4


def verdict(text, measures):
    (found,) = [v for v in judge(measures) if v.claim.text == text and v.claim.system == "pendulum"]
    return found


SYMOS = "The SyMos integrate better than L-NODE-RK4"


def test_a_statement_holds_by_its_margin():
    def values(pair, seed):
        return {"symo": 1.0, "e2e_symo": 2.0}.get(pair[0], 20.0)

    runs = made(values, metric="integration_mse")
    found = verdict(SYMOS, runs)
    assert (found.ours, found.seeds) == ("holds", 3)
    assert found.margin == pytest.approx(10.0)  # of the worse of the two
    more = verdict("and by two orders of magnitude", runs)
    assert (more.ours, more.margin) == ("does not hold", pytest.approx(0.1))


def test_a_statement_is_undecided_where_seeds_disagree():
    runs = made(
        lambda pair, seed: (1.0 if seed else 100.0) if "symo" in pair[0] else 10.0,
        metric="integration_mse",
    )
    assert verdict(SYMOS, runs).ours == "undecided"


def test_a_statement_needs_all_its_methods():
    runs = made(lambda *_: 1.0, metric="integration_mse")
    found = verdict(SYMOS, runs[runs.method != "e2e_symo"])
    assert (found.ours, found.seeds) == ("not run", 0)
    assert math.isnan(found.margin)


def test_two_that_diverge_do_not_differ():
    found = verdict(SYMOS, made(lambda *_: math.inf, metric="integration_mse"))
    assert found.ours == "does not hold"
    assert found.margin == pytest.approx(1.0)


def test_statements_name_methods_that_are():
    assert all(set(c.lower) | set(c.higher) <= set(PAIRS) for c in CLAIMS)
    assert len({(c.system, c.text) for c in CLAIMS}) == len(CLAIMS)
    assert claims.CLAIMS
