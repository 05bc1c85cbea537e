"""The answer of a report on runs whose best method is known, and its intervals."""

import math
import re

import numpy as np
import pandas as pd
import pytest

from symo_exp.report.answer import ROOTS, answers, other_settings
from symo_exp.report.cells import Compared, cells
from symo_exp.report.looks import short
from symo_exp.report.tables import latex, markdown_table

PAIRS = [("node", "rk4"), ("l_node", "rk4"), ("symo", "midpoint"), ("e2e_symo", "midpoint")]
SYMO = PAIRS[2]
METRICS = ("test_mse", "integration_mse", "energy_mse", "training_seconds")


def made(
    value, *, seeds=range(3), pairs=PAIRS, systems=("pendulum",), metrics=METRICS, **cell
) -> pd.DataFrame:
    """``value(pair, seed, system)`` of every measure."""
    known = {"n_traj": 32.0, "noise_std": 0.0, "variant": "", "source": "ours", **cell}
    return pd.DataFrame(
        {"system": system, "seed": seed, "method": pair[0], "integrator": pair[1],
         "metric": metric, "value": value(pair, seed, system), **known}
        for pair in pairs for seed in seeds for system in systems for metric in metrics
    )  # fmt: skip


def said(runs, *rivals):
    return answers(runs, Compared("", rivals))[0]


def test_there_is_a_sentence_for_each_question_that_the_runs_can_answer():
    runs = made(lambda pair, *_: 1.0 if pair == SYMO else 4.0)
    assert [re.match(r"\*\*(.+?)\*\*", line)[1] for line in said(runs)] == [
        "One step ahead", "Over long horizons", "In energy", "In training time",
    ]  # fmt: skip
    small = runs[runs.metric == "test_mse"].assign(n_traj=8.0)
    noisy = runs[runs.metric == "test_mse"].assign(noise_std=0.1)
    asked = said(pd.concat([small, noisy, runs[runs.metric == "test_mse"]]))
    assert asked[0].startswith("**From few data** (8 trajectories)")
    assert asked[1].startswith("**From noisy data** (noise 0.1, 32 trajectories)")


def test_the_best_method_its_margin_and_exceptions_are_stated():
    def value(pair, seed, system):
        return (1.0 if pair == SYMO else 5.0 if pair[0] == "node" else 50.0) * (2 + seed)

    line = said(made(value))[1]
    for fact in ("32 trajectories", "**SyMo**", "5 times", "NODE", "5 to 5", "3 seeds"):
        assert fact in line
    line = said(made(value, seeds=[0]))[1]
    assert "5 times" in line
    assert "no interval" in line
    exceptional = {("node", "arm"): 0.01}
    runs = made(
        lambda pair, _, system: exceptional.get((pair[0], system), 1.0 + (pair != SYMO) * 1e5),
        systems=("pendulum", "arm", "cart"),
    )
    assert said(runs)[0].endswith("on arm it is NODE.")


def test_chance_is_no_winner():
    generator = np.random.default_rng(0)
    line = said(made(lambda *_: 10 ** generator.random(), seeds=range(9)))[0]
    assert "undecided between" in line or "are level" in line


@pytest.mark.parametrize("lost", [math.inf, math.nan])
def test_methods_that_diverge_are_last(lost):
    lines, (table,) = answers(made(lambda pair, *_: lost if pair == SYMO else 1.0), Compared(""))
    assert not any("**SyMo**" in line for line in lines)
    row = table.rows.set_index("").loc["SyMo"]
    assert set(row) == {"diverged"}
    assert "are level" in said(made(lambda *_: lost))[0]


def test_a_stray_size_is_not_what_is_asked_of_few_data():
    runs = made(lambda pair, *_: 1.0 if pair == SYMO else 4.0)
    assert "(32 trajectories)" in said(pd.concat([runs, runs[:1].assign(n_traj=8.0)]))[0]


def test_one_method_is_compared_in_its_settings_and_one_alone_is_told():
    alone = made(lambda *_: 0.5, pairs=[SYMO])
    assert "SyMo 0.5 (pendulum)" in said(alone)[1]
    other = alone.assign(variant="width=64", value=0.1)
    line = said(pd.concat([alone, other]), "", "width=64")[1]
    for fact in ("**width=64**", "5 times", "defaults"):
        assert fact in line
    assert "width" not in said(pd.concat([alone, other]))[1]  # not of the same sweep


def test_methods_that_differ_by_less_than_a_twentieth_are_level():
    runs = made(lambda pair, *_: 1.0 if pair == SYMO else 1.04)
    assert all("**SyMo** and **NODE** are level" in line for line in said(runs))
    assert "×" not in str(answers(runs, Compared(""))[1][0].rows)


def test_the_best_of_other_settings_is_told_with_the_option_that_compares_them():
    found = pd.DataFrame(
        {"source": "ours", "metric": "test_mse", "noise_std": 0.0, "system": "pendulum",
         "method": "symo", "integrator": "midpoint", "n_traj": 32.0, "variant": variant,
         "median": value} for variant, value in (
            ("", 1e-4), ("fast", 1e-6), ("slow", 1.0), ("system.gravity=0", 1e-9),
        )
    )  # fmt: skip
    (line,) = other_settings(found, "")
    for fact in ("SyMo, midpoint", "1.00e-6", "pendulum, 32", "100 times", '--settings "fast"'):
        assert fact in line
    assert other_settings(found, "fast") == []


def test_methods_that_were_not_run_on_all_systems_are_in_the_heat_map_of_theirs():
    runs = made(lambda pair, *_: 1.0 if pair == SYMO else 4.0, systems=("arm", "cart"))
    runs = runs[(runs.system == "arm") | (runs.method != "node")]
    tables = {table.title: list(table.rows[""]) for table in answers(runs, Compared(""))[1]}
    assert tables == {
        "arm": ["NODE", "L-NODE", "SyMo", "E2E-SyMo"], "cart": ["L-NODE", "SyMo", "E2E-SyMo"],
    }  # fmt: skip


def test_methods_that_are_given_velocities_are_named_where_others_are_not():
    runs = made(lambda *_: 1.0)
    assert not any("velocities" in line for line in said(runs))
    finding = [pair for pair in PAIRS if pair[1] == "midpoint"]
    found = pd.concat([runs, made(lambda *_: 0.0, pairs=finding, metrics=(ROOTS,))])
    given, _, alone = said(found)[-1].partition("velocities")
    assert "NODE and L-NODE" in given
    assert "SyMo and E2E-SyMo" in alone
    few = found[found.method.isin(["symo", "e2e_symo"])]
    assert not any("given" in line for line in said(few))


def test_the_heat_map_ranks_and_the_best_are_bold():
    order = {pair: 10.0**i for i, pair in enumerate(PAIRS)}
    (table,) = answers(made(lambda pair, *_: order[pair]), Compared(""))[1]
    assert [cell.text for cell in next(iter(table.lines()))] == ["NODE", *["1"] * 4]
    assert list(table.shades["energy MSE [J²], n=32"]) == pytest.approx([1, 2 / 3, 1 / 3, 0])
    assert "| NODE | **1** | **1** | **1** | **1** |" in markdown_table(table)
    assert r"NODE & \textbf{1} & \textbf{1} & \textbf{1} & \textbf{1} \\" in latex(table)


@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_the_heat_map_has_the_medians_of_the_other_tables(count):
    runs = made(lambda pair, seed, _: 7.0**seed * (1 + PAIRS.index(pair)), seeds=range(count))
    (table,) = answers(runs, Compared(""))[1]
    found = cells(runs.assign(seconds=1.0, time_step=0.1))
    medians = found[found.metric == "energy_mse"].set_index("method")["median"]
    there = table.rows.set_index("")["energy MSE [J²], n=32"].str.split().str[0]
    assert sorted(there) == sorted(map(short, medians))


def test_there_is_no_answer_without_a_run_that_learned():
    assert answers(made(lambda *_: 1.0, source="floor"), Compared("")) == ([], [])
