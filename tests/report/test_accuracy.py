"""The tables and figures of how accurate the methods get."""

import pandas as pd
import pytest

from symo_exp.configuration import CONF
from symo_exp.report.accuracy import MEASURES, order_of, over_order, table
from symo_exp.report.runs import CELL


def cells(rows):
    """Cells of one measure from (variant, method, integrator, value)."""
    made = [
        dict.fromkeys(CELL) | {
            "variant": variant, "system": "pendulum", "method": method, "integrator": integrator,
            "n_traj": 32, "noise_std": 0.0, "metric": "test_mse", "seeds": 2,
            "median": value, "low": value / 2, "high": 2 * value,
        }
        for variant, method, integrator, value in rows
    ]  # fmt: skip
    return pd.DataFrame(made)


@pytest.mark.parametrize("name", [path.stem for path in (CONF / "integrator").glob("*.yaml")])
def test_every_integrator_has_an_order(name):
    assert order_of(name) >= 2


def test_unknown_integrators_have_none():
    assert order_of("nothing") is None


def test_errors_are_drawn_over_the_order_beside_their_floors():
    learned = cells(
        [
            ("fast", "symo", "galerkin6", 1e-10),
            ("fast", "symo", "midpoint", 1e-5),
            ("", "symo", "midpoint", 1e-4),  # one integrator only: no line
        ]
    )
    floors = cells([("", "true_variational", "midpoint", 1e-6)])
    (chart,) = over_order(learned, floors)
    test = chart.panels[0]
    assert [(s.x, s.y, s.source) for s in test.series] == [
        ([2.0, 6.0], [1e-5, 1e-10], "ours"),
        ([2.0], [1e-6], "floor"),
    ]
    assert [s.name for s in test.series] == ["SyMo", "true system, variational"]


def test_the_table_has_a_row_for_each_cell_and_none_for_floors():
    made = table(
        cells(
            [
                ("fast", "symo", "galerkin6", 1e-10),
                ("", "node", "rk4", 1e-3),
                ("", "true_ode", "rk4", 1e-8),
            ]
        )
    )
    assert [row[:6] for row in made.rows] == [
        ["pendulum", "32", "defaults", "NODE, RK4", "2", "1.00e-3"],
        ["pendulum", "32", "fast", "SyMo, Galerkin 6", "2", "1.00e-10"],
    ]
    assert all(len(row) == 5 + len(MEASURES) == len(made.header) for row in made.rows)
