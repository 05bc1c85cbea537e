"""The published values, and their comparison with ours."""

from decimal import Decimal

import pytest

from symo_exp.report.cells import cells
from symo_exp.report.runs import tidy
from symo_exp.thesis import published
from tests.report.stores import repeated, row

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
    assert set(table.method) == {"node", "l_node", "symo", "e2e_symo"}
    assert (table.value > 0).all()
    assert table.like.notna().all()


def test_deviations_over_trajectories_are_possible():
    table = published.published().dropna(subset="std")
    told = table.note.str.contains("± over all nodes")
    ratio = table["std"] / table.value  # of n numbers that are not negative, at most √n
    assert ratio[~told].max() < 16**0.5 < ratio[told].max()


def test_factors_compare_averages_over_the_same_quantities():
    cell = {"system": "cartpole", "method": "symo", "integrator": "midpoint"}
    run = row({"integration_mse": 0.1, "integration_mse_state": 0.551668}, **cell)
    compared = published.with_ours(cells(tidy([run])))
    (found,) = compared[(compared.seeds > 0)].to_dict("records")
    assert found["over"] == "state"
    assert found["median"] == 0.1
    assert found["factor"] == pytest.approx(2.0)
    assert len(compared) == len(published.published())


def test_a_repeated_thesis_is_found_to_agree():
    rows = at_32(published.published())
    compared = published.with_ours(cells(tidy(repeated(rows, factor=2.0))))
    done = compared[compared.seeds > 0]
    assert len(done) == len(rows)
    assert done.factor.to_numpy() == pytest.approx(2.0)
