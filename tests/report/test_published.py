"""The published figures, and what is made of them beside ours."""

from decimal import Decimal

import pytest

from symo_exp.report import claims, published
from symo_exp.report.cells import beside_published, cells
from symo_exp.report.labels import factor, short
from symo_exp.report.runs import read
from symo_exp.report.style import METHODS
from tests.report.stores import add_published, add_run

# from the text of the thesis: table, method, integrator, train, test, integration, energy, inertia
TEXT = """
pendulum node midpoint 1.38e-4 1.28e-4 2.29e3 7.92 -
pendulum l_node rk4 5.17e-8 3.51e-8 0.498 2.0e-3 6.36e-7
pendulum symo midpoint 1.75e-7 1.75e-7 3.38e-3 0.378 1.03e-5
pendulum e2e_symo midpoint 1.57e-7 1.58e-7 3.9e-3 0.378 9.57e-6
acrobot node rk4 7.14e-10 4.39e-4 1.05e3 1.46e3 -
acrobot l_node midpoint 1.04e-6 8.0e-6 1.53e2 0.11 0.23
acrobot e2e_symo midpoint 3.75e-9 3.03e-8 1.85e2 0.93 0.227
cartpole node midpoint 3.97e-7 2.09e-6 99.5 3.45 -
cartpole l_node rk4 1.79e-6 3.16e-5 0.179 2.1e-6 3.26e-5
cartpole e2e_symo midpoint 3.28e-9 4.64e-8 8.69e-2 6.05e-4 1.94e-5
"""
METRICS = ("train_mse", "test_mse", "integration_mse", "energy_mse", "inertia_mse")


def at_32(table):
    usual = table.time_step == table.system.map(published.TIME_STEPS)
    return table[usual & (table.n_traj == 32) & (table.noise_std == 0)]


@pytest.mark.parametrize("line", TEXT.split("\n")[1:-1])
def test_the_data_are_those_of_the_printed_tables(line):
    system, method, integrator, *numbers = line.split()
    rows = at_32(published.published())
    rows = rows[
        (rows.system == system) & (rows.method == method) & (rows.integrator == integrator)
    ].set_index("metric")
    for metric, number in zip(METRICS, numbers, strict=True):
        if number == "-":
            assert metric not in rows.index
        else:  # to a unit of the last printed digit: the thesis rounds either way
            exponent = Decimal(number).as_tuple().exponent
            unit = 10.0**exponent
            assert rows.value[metric] == pytest.approx(float(number), abs=unit)


def test_every_run_of_the_thesis_is_there_once():
    table = published.published()
    assert len(table.drop_duplicates(published.CELL)) == 198
    assert not table.duplicated([*published.CELL, "metric"]).any()
    assert set(table.method) == set(METHODS)
    assert (table.value > 0).all()
    assert set(table.over) == set(published.NOTES)


def test_all_statements_are_borne_out_by_the_published_numbers():
    """They were made of them: one that is not was put down wrongly."""
    verdicts = claims.judge(at_32(published.published()).assign(seed=0)[:0])
    assert [v.claim.text for v in verdicts if v.published != "holds"] == []
    assert {v.ours for v in verdicts} == {"not run"}


def test_factors_compare_what_averages_over_the_same(store):
    cell = {"system": "cartpole", "method": "symo", "integrator": "midpoint"}
    add_run(store, **cell, metrics={"integration_mse": 0.1, "integration_mse_state": 0.551668})
    compared = beside_published(cells(read(store, ["thesis"]).measures))
    (row,) = compared[(compared.seeds > 0)].to_dict("records")
    assert row["over"] == "state"
    assert row["median"] == 0.1
    assert row["factor"] == pytest.approx(2.0)
    assert len(compared) == len(published.published())


def test_a_repeated_thesis_is_found_to_agree(store):
    rows = at_32(published.published())
    add_published(store, rows, factor=2.0)
    compared = beside_published(cells(read(store, ["thesis"]).measures))
    done = compared[compared.seeds > 0]
    assert len(done) == len(rows)
    assert done.factor.to_numpy() == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("number", "printed"),
    [(1.3849e-4, "1.38e-4"), (0.498, "0.498"), (38.6, "38.6"), (2288.1, "2.29e3"), (0.0, "0"),
     (float("inf"), "diverged"), (float("nan"), "–"), (None, "–")],
)  # fmt: skip
def test_numbers_are_short(number, printed):
    assert short(number) == printed


@pytest.mark.parametrize(
    ("number", "printed"),
    [(1.0, "×1"), (2.13, "×2.1"), (0.5, "÷2"), (654.0, "×650"), (2345.0, "×2.3e3"),
     (1 / 830, "÷830"), (float("inf"), "×∞"), (0.0, "÷∞"), (float("nan"), "–")],
)  # fmt: skip
def test_factors_say_larger_or_smaller(number, printed):
    assert factor(number) == printed
