"""Figures: what a specification says is drawn, the same on paper and on the page."""

import json
import re

import numpy as np
import pandas as pd
import pytest
from hydra.utils import instantiate
from omegaconf import OmegaConf

from symo_exp.report import curves, paper
from symo_exp.report.cells import cells
from symo_exp.report.figures import Panel
from symo_exp.report.looks import MARKERS, METHODS, TRUE, axis_label, in_order, look, short
from symo_exp.report.motions import Studied, drift, first, learned, motion, phase_space
from symo_exp.report.overview import sections
from symo_exp.report.page import drawn, page, toggles
from symo_exp.report.runs import COLUMNS
from symo_exp.report.tables import Table, latex
from symo_exp.report.write import Report
from symo_exp.shipped import CONF
from tests.models.methods import learned as methods
from tests.tables import choices

METRICS = ("train_mse", "test_mse", "integration_mse", "energy_mse", "inertia_mse", "valid_steps")


def runs() -> pd.DataFrame:
    """Every pair of some methods and integrators, sizes, noises and seeds, and the floors."""
    generator = np.random.default_rng(0)
    pairs = [(m, i) for m in (*METHODS, "mine") for i in ("midpoint", "galerkin4")]
    cells_ = [(8, 0.0), (32, 0.0), (32, 0.01)]
    rows = [(m, i, n, noise, seed, 0.1) for m, i in pairs for n, noise in cells_ for seed in (0, 1)]
    rows += [(m, "midpoint", 32, 0.0, 0, h) for m in TRUE for h in (0.05, 0.1)]
    table = pd.DataFrame(
        [(*row, metric, generator.random()) for row in rows for metric in METRICS],
        columns=["method", "integrator", "n_traj", "noise_std", "seed", "time_step", "metric",
                 "value"],
    )  # fmt: skip
    ids = table.groupby(["method", "integrator", "n_traj", "noise_std", "seed", "time_step"])
    table = table.assign(
        system="chain", variant="", status="FINISHED", seconds=3.0, run_id=ids.ngroup().astype(str),
        source=table.method.isin(TRUE).map({True: "floor", False: "ours"}),
    )  # fmt: skip
    words = dict.fromkeys(set(COLUMNS) - set(table), "")
    return table.assign(**words)


def swing(wrong=0.0, nodes=2000, lost=False) -> pd.DataFrame:
    """Two circular motions; the second is never drawn."""
    step = np.tile(np.arange(nodes), 2)
    t = 0.1 * step
    table = pd.DataFrame({"trajectory": np.repeat([0, 1], nodes), "step": step, "t": t})
    table["q_theta"], table["v_theta"] = np.sin(t) + wrong, np.cos(t)
    table["q_true_theta"], table["v_true_theta"] = np.sin(t), np.cos(t)
    table["energy"], table["energy_true"] = 1.0 + wrong, 1.0
    table["log_volume"] = -wrong * t
    table["inertia_11"] = table["inertia_11_true"] = t
    if lost:
        table.loc[table.step > nodes // 2, ["q_theta", "energy"]] = np.inf
    return table


PAIRS = [("symo", "midpoint"), ("node", "rk4")]
TABLES = first({pair: swing(0.1) for pair in PAIRS})
FIGURES = [
    *(figure for section in sections(runs()) for figure in section.figures),
    *(draw(draw.__name__, "chain", TABLES) for draw in (motion, phase_space, learned)),
    *drift([Studied("drift", "chain", 0.1, TABLES)]),
]  # fmt: skip


@pytest.mark.parametrize("figure", FIGURES, ids=lambda figure: figure.key)
def test_every_series_is_drawn_by_both_and_has_a_legend(figure):
    on_paper = paper.draw(figure)
    legend = {text.get_text() for text in on_paper.legends[0].get_texts()}
    for axes, panel in zip(on_paper.axes, figure.panels, strict=True):
        series, on_page = list(panel.series()), drawn(panel)
        assert len(axes.get_lines()) == len(on_page["series"]) == len(series) > 0
        assert axes.get_xlabel()
        assert axes.get_ylabel() or axes.get_title()
        assert [axis["label"] for axis in on_page["axes"]] == [panel.x_label, panel.y_label]
        for one, line, held in zip(series, axes.get_lines(), on_page["series"], strict=True):
            kept = [np.nan if y is None else y for y in held["y"]]
            np.testing.assert_allclose(line.get_ydata(), kept, rtol=1e-4)
            assert line.get_color() == one.look.colour
            assert one.look.colour in held["colour"]
            assert (held["name"], held["dash"]) == (one.name, one.stroke.web)
            assert one.name in legend


def test_what_can_be_switched_off_is_what_there_are_several_of():
    boxes = toggles(FIGURES)
    assert set(boxes["method"]) == {*METHODS, *TRUE, "mine"}
    assert set(boxes["source"]) == {"ours", "floor", "truth"}
    few = [figure for figure in FIGURES if figure.key == "motion"]
    assert set(toggles(few)["method"]) == {method for method, _ in PAIRS}


def report() -> Report:
    return Report("a <title> & more", "it", sections(runs()), runs())


def test_the_page_holds_the_figures_and_needs_nothing_else():
    text = page(report())
    assert "a &lt;title&gt; &amp; more" in text
    assert re.findall(r"<(?:script|link|img|iframe)\b[^>]*(?:src|href)\s*=", text) == []
    found = re.search(r'<script type="application/json" id="panels">(.*?)</script>', text, re.S)
    held = json.loads(found.group(1))
    there = {f.key: len(f.panels) for section in report().sections for f in section.figures}
    assert {key: len(panels) for key, panels in held.items()} == there


def test_the_page_begins_with_the_answer_and_ends_with_what_it_rests_on():
    text = page(report())
    order = [text.index(f'id="{key}"') for key in ("answer", "best_chain", "sizes", "tables")]
    assert order == sorted(order)
    assert '<details class="folded" id="state">' in text
    assert text.index("<b>From few data</b>") < order[2]


def test_the_figures_numbers_are_those_of_the_cells():
    found = cells(runs())
    (figure,) = [f for f in FIGURES if f.key == "data_size_chain_errors"]
    for panel, metric in zip(figure.panels, curves.ERRORS, strict=True):
        for one in panel.series():
            cell = found[
                (found.metric == metric) & (found.method == one.method)
                & (found.integrator == one.integrator) & (found.noise_std == 0)
                & (found.time_step == 0.1)
            ].sort_values("n_traj")  # fmt: skip
            if one.source == "ours":
                assert list(one.rows.x) == [8, 32]
                for name, column in (("y", "median"), ("low", "low"), ("high", "high")):
                    np.testing.assert_array_equal(one.rows[name], cell[column])
            else:  # a level from end to end
                assert set(one.rows.y) == set(cell["median"])


def test_methods_are_told_apart_with_and_without_colour():
    assert set(METHODS) == set(methods())
    assert set(METHODS) | set(TRUE) == set(choices("model"))
    assert len({one.colour for one in METHODS.values()}) == len(METHODS)
    assert len({one.marker for one in METHODS.values()}) == len(METHODS)
    assert {look(name).marker for name in (*METHODS, *TRUE, "new", "newer")} <= set(MARKERS)
    assert look("a_new_method").label == "a_new_method"
    assert sorted([("z", "rk4"), ("symo", "midpoint"), ("node", "rk4"), ("node", "midpoint")],
                  key=in_order)[:2] == [("node", "midpoint"), ("node", "rk4")]  # fmt: skip


@pytest.mark.parametrize("name", [path.stem for path in (CONF / "integrator").glob("*.yaml")])
def test_every_integrator_has_an_order(name):
    """As its comment says: the classes, which take seconds to import, agree."""
    choices = OmegaConf.load(CONF / "integrator" / f"{name}.yaml")
    for kind in ("explicit", "variational"):
        if choices[kind] is not None:
            made = instantiate(choices[kind])
            assert curves.order_of(name) == made.order


def rows(source, y, method=""):
    x = np.arange(len(y), dtype=float)
    return pd.DataFrame({"x": x, "y": y, "source": source, "method": method, "integrator": ""})


def test_what_diverges_leaves_the_picture_and_not_its_scale():
    truth, lost = rows("truth", np.sin(np.arange(50.0))), rows("ours", [1e6] * 50, "symo")
    panel = Panel("", "t", "q", pd.concat([truth, lost]), y_log=False)
    low, high = panel.limits()
    assert -3 < low < -1 < 1 < high < 3
    lost = drawn(motion("forced", "", {PAIRS[0]: swing(lost=True)}).panels[0])
    values = lost["series"][-1]["y"]
    assert all(y is None or np.isfinite(y) for y in values)
    assert motion("forced", "", TABLES).panels[0].rows.x.max() <= 50


def test_a_constant_truth_leaves_room_to_see_the_others():
    """The energy of an unforced motion has a spread of rounding errors only."""
    truth, ours = rows("truth", [0.64, 0.64 + 1e-15]), rows("ours", [0.63, 0.65], "symo")
    low, high = Panel("", "", "", pd.concat([truth, ours]), y_log=False).limits()
    assert low < 0.63 < 0.65 < high


def test_a_symplectic_integrator_keeps_the_volume_small_steps_first():
    tables = {("true_ode", "rk4"): swing(0.1), ("true_variational", "midpoint"): swing()}
    (figure,) = drift([Studied("drift", "chain", h, tables) for h in (0.2, 0.05)])
    assert [panel.title for panel in figure.panels] == ["step 0.05 s", "step 0.2 s"] * 2
    explicit, variational = figure.panels[-1].series()
    assert explicit.rows.y.iloc[-1] < 1e-4
    assert set(variational.rows.y) == {1.0}


def test_names_become_symbols():
    assert axis_label("theta") == "θ [rad, m]"
    assert (
        axis_label("theta_12", angular=True) == axis_label("theta12", angular=True) == "θ₁₂ [rad]"
    )
    assert axis_label("x", velocity=True, angular=False) == "dx/dt [m/s]"
    assert axis_label("tilt", angular=True) == "tilt [rad]"


def test_latex_escapes_what_it_must():
    text = latex(
        Table("k", "50 % of a_b & c", pd.DataFrame({"x²": ["{1}"], "σ": ["÷2 ± 3"]}), ["#1"])
    )
    assert r"50 \% of a\_b \& c" in text
    assert r"x$^2$ & $\sigma$ \\" in text
    assert r"\{1\} & $\div$2 $\pm$ 3 \\" in text
    assert text.isascii()


@pytest.mark.parametrize(
    ("number", "printed"),
    [(1.3849e-4, "1.38e-4"), (0.498, "0.498"), (38.6, "38.6"), (2288.1, "2.29e3"), (0.0, "0"),
     (float("inf"), "diverged"), (float("nan"), "–"), (None, "–")],
)  # fmt: skip
def test_numbers_are_short(number, printed):
    assert short(number) == printed
