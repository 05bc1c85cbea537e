"""Figures of studies, from the files that runs left in the store."""

import numpy as np
import pandas as pd
import pytest

from symo_exp.report import motions, paper
from symo_exp.report.build import report
from symo_exp.report.charts import Panel, Series
from symo_exp.report.page import figure
from symo_exp.report.runs import read
from symo_exp.report.studied import Studied, studied
from symo_exp.report.style import TRUTH, look
from symo_exp.tracking.store import connect
from tests.report.stores import add_run

PAIRS = [("symo", "midpoint"), ("node", "rk4")]


def motion(wrong=0.0, nodes=2000, lost=False) -> pd.DataFrame:
    """Two circular motions; the second is never drawn."""
    step = np.tile(np.arange(nodes), 2)
    t = 0.1 * step
    table = pd.DataFrame({"trajectory": np.repeat([0, 1], nodes), "step": step, "t": t})
    table["q_theta"], table["v_theta"] = np.sin(t) + wrong, np.cos(t)
    table["q_true_theta"], table["v_true_theta"] = np.sin(t), np.cos(t)
    table["u_0"], table["energy"], table["energy_true"] = 0.0, 1.0 + wrong, 1.0
    table["log_volume"] = -wrong * t
    if lost:
        table.loc[table.step > nodes // 2, ["q_theta", "energy"]] = np.inf
    return table


def add_study(store, folder, name, table, **cell):
    """A run that has done a study; a study without a table is known by its measures alone."""
    run = add_run(store, metrics={"test_mse": 1e-6, f"{name}_pose_mse": 0.1}, **cell)
    if table is not None:
        table.to_parquet(folder / f"{name}.parquet")
        connect(store).log_artifact(run, str(folder / f"{name}.parquet"), "studies")
    return run


def test_each_method_s_run_of_the_lowest_seed_is_read(store, tmp_path):
    for method, integrator in PAIRS:
        for seed in (2, 1):
            add_study(
                store, tmp_path, "long_term", motion(wrong=seed, nodes=5),
                method=method, integrator=integrator, seed=seed,
            )  # fmt: skip
    add_run(store, method="l_node", integrator="rk4")  # it did no study
    add_study(store, tmp_path, "long_term", None, method="e2e_symo", seed=1)  # its file is gone
    (found,) = studied(store, read(store, ["thesis"]).measures, ["long_term", "forced"])
    assert (found.study, found.system, found.seed) == ("long_term", "pendulum", 1)
    assert list(found.tables) == [("node", "rk4"), ("symo", "midpoint")]  # as the thesis orders
    assert found.tables["symo", "midpoint"].energy.iloc[0] == 2.0


def test_a_report_shows_the_studies_of_its_runs(store, tmp_path):
    for method, integrator in PAIRS:
        add_study(store, tmp_path, "long_term", motion(), method=method, integrator=integrator)
    made = report(read(store, ["thesis"]), "it", store)
    keys = {chart.key for section in made.sections for chart in section.charts}
    assert {"long_term_pendulum", "long_term_pendulum_phase_space"} <= keys


def drawn(study, tables, system="pendulum", time_step=0.1):
    return motions.charts([Studied(study, system, time_step, 0, tables)])


def test_a_motion_is_drawn_beside_the_truth_and_thinned(tmp_path):
    tables = {pair: motion(wrong=0.1) for pair in PAIRS}
    chart, portrait = drawn("long_term", tables)
    poses, errors, energies = chart.panels
    assert [s.source for s in poses.series] == ["truth", "ours", "ours"]
    assert max(poses.series[0].x) <= 50.0
    for series in errors.series:
        assert series.y == pytest.approx([0.01] * len(series.y))
    assert errors.y_log
    assert not energies.y_log
    assert len(portrait.panels) == len(PAIRS)
    assert all(len(s.x) <= 2 * 2 * motions.POINTS for p in portrait.panels for s in p.series)
    for made in (chart, portrait):
        (path,) = paper.save(made, tmp_path, ["png"])
        assert path.stat().st_size > 5000


def test_what_diverges_leaves_the_picture_and_not_its_scale():
    tables = {PAIRS[0]: motion(), PAIRS[1]: motion(wrong=1e6)}
    poses, _, _ = drawn("forced", tables)[0].panels
    low, high = poses.limits()
    assert -3 < low < -1
    assert 1 < high < 3
    lost = drawn("forced", {PAIRS[0]: motion(lost=True)})[0].panels[0]
    values = figure(lost)["data"][-1]["y"]
    assert None in values
    assert all(y is None or np.isfinite(y) for y in values)


def test_learned_quantities_have_a_panel_each():
    t = np.linspace(0, 1, 5)
    table = pd.DataFrame({"trajectory": 0, "step": range(5), "t": t})
    for name in ("kinetic", "potential", "total", "inertia_11", "inertia_12", "inertia_22"):
        table[name], table[f"{name}_true"] = t, t
    (chart,) = drawn("learned_quantities", {PAIRS[0]: table}, "cartpole")
    titles = [panel.title for panel in chart.panels]
    assert titles[0] == "kinetic energy [J]"
    assert titles[-3:] == ["inertia H11", "inertia H12", "inertia H22"]
    assert chart.number == "6.17"


def test_drift_is_shown_from_small_steps_to_large():
    tables = {("true_ode", "rk4"): motion(0.1), ("true_variational", "midpoint"): motion()}
    found = [Studied("drift", "acrobot", h, 0, tables) for h in (0.2, 0.05)]
    (chart,) = motions.charts(found)
    steps = [panel.title.rpartition("step ")[2] for panel in chart.panels]
    assert steps == ["0.05 s", "0.2 s", "0.05 s", "0.2 s"]
    explicit, variational = chart.panels[-1].series
    assert explicit.y[-1] < 1e-4
    assert set(variational.y) == {1.0}


def test_a_constant_truth_leaves_room_to_see_the_others():
    """The energy of an unforced motion has a spread of rounding errors only."""
    truth = Series("truth", "", [0.0, 1.0], [0.64, 0.64 + 1e-15], source="truth")
    ours = Series("symo", "midpoint", [0.0, 1.0], [0.63, 0.65])
    low, high = motions._bounded(Panel("energy", "", "", [truth, ours], y_log=False)).y_range
    assert low < 0.63
    assert high > 0.65


@pytest.mark.parametrize("points", [True, False])
def test_the_legend_has_the_colours_of_the_figure(points):
    truth = Series(*motions.TRUTH, [0.0], [0.0], source="truth", points=points, name="truth")
    ours = Series("symo", "midpoint", [0.0], [0.0], points=points)
    legend = paper._legend([Panel("", "", "", [truth, ours])])
    colours = {name: handle.get_color() for name, handle in legend.items()}
    assert colours == {"truth": TRUTH.colour, "SyMo, midpoint": look("symo").colour}
