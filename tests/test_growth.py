"""Every method over the number of coordinates: it trains, is measured, and the report shows it."""

import pandas as pd
import pytest

from symo_exp.__main__ import main
from symo_exp.report.cells import Compared
from symo_exp.report.growth import growth
from symo_exp.report.overview import sections
from symo_exp.report.runs import load_runs, tidy
from symo_exp.report.tables import markdown_table
from tests.models.methods import one_each
from tests.report.stores import MEASURES, row
from tests.tiny import TINY

METHODS = {
    method: [f"model={method}", f"integrator={integrator}"] for method, integrator in one_each()
} | {"fast": ["preset=fast", "data.monitor_trajectories=1"]}


def trained(name, n, folder):
    words = [*TINY, *METHODS[name], "system=chain", f"system.links={n}", "logger=none"]
    words += ["pictures=false", "net.width=4", f"experiment={name}_{n}"]
    assert main(words) == 0
    runs = load_runs([folder / "outputs" / f"{name}_{n}"])
    return runs.set_index("metric").value


def test_seven_coordinates_are_learned(workplace):
    found = trained("fast", 7, workplace)
    assert found["coordinates"] == 7
    assert 0 < found["test_relative"] < 10
    assert found["peak_memory"] > 50


@pytest.mark.slow
@pytest.mark.parametrize("n", range(1, 8))
@pytest.mark.parametrize("name", METHODS)
def test_every_method_runs_at_every_number_of_coordinates(name, n, workplace):
    found = trained(name, n, workplace)
    assert found["coordinates"] == n
    assert 0 < found["test_relative"] < 10


def made(n, seed=0, **more):
    """A run whose step costs n squared."""
    measures = MEASURES | {
        "coordinates": n, "test_relative": 1e-6 * 10**n, "step_ms": 2.0 * n**2,
        "peak_memory": 300.0 + n,
    }  # fmt: skip
    links = "" if n == 3 else f", system.links={n}"
    return row(
        measures, system="chain", variant=f"fast, data.n_val=[1, 2]{links}", seed=seed, **more
    )


def test_the_report_shows_growth():
    runs = tidy([made(n, seed) for n in range(1, 8) for seed in (0, 1)])
    (table,), (figure,) = growth(runs)
    assert list(table.rows.coordinates) == [str(n) for n in range(1, 8)]
    assert set(table.rows.seeds) == {"2"}
    assert "n to the power 2.00" in markdown_table(table)
    panel = figure.panels[0]
    assert panel.ticks == tuple(range(1, 8))
    assert panel.rows.y.tolist() == pytest.approx([1e-6 * 10**n for n in range(1, 8)])
    assert "growth" in [section.key for section in sections(runs, Compared(""))]


def test_systems_of_one_size_do_not_grow():
    assert growth(tidy([row(), made(3)])) == ([], [])
    assert growth(pd.DataFrame(columns=tidy([row()]).columns)) == ([], [])
