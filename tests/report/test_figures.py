"""Figures are drawn as they are specified, in files and on the page."""

import base64
import gzip
import itertools
import json
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import vl_convert

from symo_exp.report import curves
from symo_exp.report.cells import Compared, cells
from symo_exp.report.charts import MARKERS, declare, draw_charts
from symo_exp.report.document import Report, Section
from symo_exp.report.figures import Figure, Panel
from symo_exp.report.looks import (
    MEASURES,
    METHODS,
    TRUE,
    axis_label,
    in_order,
    look,
    measure_name,
    short,
    written,
)
from symo_exp.report.motions import (
    LONG,
    Studied,
    drift_figures,
    first,
    learned_figure,
    motion_figure,
    phase_space_figure,
    points,
)  # fmt: skip
from symo_exp.report.overview import sections
from symo_exp.report.page import html, toggles
from symo_exp.report.paper import save_figure
from symo_exp.report.runs import COLUMNS
from symo_exp.report.tables import ResultTable, latex
from tests.models.methods import learned as methods
from tests.tables import choices, explicit_integrators, variational_integrators

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
    *(figure for section in sections(runs(), Compared("")) for figure in section.figures),
    *(draw(draw.__name__, "chain", TABLES)
      for draw in (motion_figure, phase_space_figure, learned_figure)),
    *drift_figures([Studied("drift", "chain", 0.1, TABLES)]),
]  # fmt: skip


@pytest.mark.parametrize(("count", "most", "columns"), [(4, 3, 2), (5, 3, 3), (6, 4, 3), (2, 3, 2)])
def test_rows_of_panels_are_of_equal_length_if_they_can_be(count, most, columns):
    rows = pd.DataFrame({"source": ["truth"], "method": "", "integrator": "", "x": 0.0, "y": 1.0})
    assert Figure("k", "", "", [Panel("", "", "", rows)] * count, columns=most).columns == columns


@pytest.mark.parametrize("figure", FIGURES, ids=lambda figure: figure.key)
def test_a_chart_has_every_trace_with_its_look_and_a_legend(figure):
    spec = declare(figure, interactive=True)
    assert len(spec["concat"]) == len(figure.panels)
    for panel, drawn in zip(figure.panels, spec["concat"], strict=True):
        data = pd.DataFrame(spec["datasets"][drawn["data"]["name"]])
        encoding = {name: x for layer in drawn["layer"] for name, x in layer["encoding"].items()}
        assert [encoding[axis]["axis"].get("title") or "" for axis in "xy"] == [
            panel.x_label, panel.y_label,
        ]  # fmt: skip
        colours = encoding["fill"]["scale"]
        for trace in panel.traces():
            rows = data[data.name == trace.name]
            y = trace.rows.y.where(np.isfinite(trace.rows.y) & (~panel.y_log | (trace.rows.y > 0)))
            np.testing.assert_allclose(rows.y.astype(float), y, rtol=1e-4)
            assert set(rows.method) == {trace.label}
            colour = colours["range"][colours["domain"].index(trace.label)]
            assert colour in (trace.look.colour, {"expr": "ink"})
        if not panel.title:
            assert panel.y_label


def test_a_caption_names_the_lines_of_true_systems_where_there_are_any():
    learned = runs()[lambda table: table.source == "ours"]
    without = [f for one in sections(learned, Compared("")) for f in one.figures]
    for figure in (*FIGURES, *without):
        if figure.key.startswith("data_size"):
            floors = any((panel.rows.source == "floor").any() for panel in figure.panels)
            assert ("Lines across" in figure.caption) == floors
    assert any(figure.key.startswith("data_size") for figure in without)


@pytest.mark.parametrize("form", ["png", "svg", "pdf"])
def test_a_chart_becomes_a_file_that_is_the_same_again(form, tmp_path):
    begins = {"png": b"\x89PNG", "svg": b"<svg", "pdf": b"%PDF"}
    figure = min(FIGURES, key=lambda figure: sum(len(panel.rows) for panel in figure.panels))
    (first,) = draw_charts(figure, tmp_path / "a", [form])
    assert first.name == f"{figure.key}.{form}"
    assert first.read_bytes().startswith(begins[form])
    if form == "png":  # the others number their elements throughout a process
        (again,) = draw_charts(figure, tmp_path / "b", [form])
        assert first.read_bytes() == again.read_bytes()


@pytest.mark.parametrize(
    "form", ["svg", *(pytest.param(x, marks=pytest.mark.slow) for x in ("png", "pdf"))]
)
def test_a_chart_that_cannot_be_written_leaves_the_one_before(form, tmp_path, monkeypatch):
    def tear(path, *_, **__):
        path.open("w").close()
        raise OSError("no space")

    rows = pd.DataFrame(
        {"x": 1.0, "y": [1.0], "method": "symo", "integrator": "", "source": "ours"}
    )
    figure = Figure("k", "", "", [Panel("", "there", "", rows)])
    (file,) = draw_charts(figure, tmp_path, [form])
    before = file.read_bytes()
    for name in ("write_text", "write_bytes"):
        monkeypatch.setattr(Path, name, tear)
    with pytest.raises(OSError, match="no space"):
        draw_charts(figure, tmp_path, [form])
    assert file.read_bytes() == before


def drawn_axis(low, high, folder):
    """The logarithmic axis of a chart as text of a file."""
    x = np.geomspace(low, high, 5)
    rows = pd.DataFrame({"x": x, "y": x, "method": "symo", "integrator": "", "source": "ours"})
    panel = Panel("", "there", "", rows, x_log=True, mark="points")
    (file,) = draw_charts(Figure("k", "", "", [panel]), folder, ["svg"])
    return file.read_text().partition(">there<")[0]


@pytest.mark.parametrize(
    ("low", "high"), [(21.0, 29.0), (2.0, 9.0), (1.0, 1e3), (1.3, 130.0), (7.0, 4e3)]
)
def test_a_logarithmic_axis_has_labels_all_along(low, high, tmp_path):
    shown = re.findall(r">([-.\de]+)</text>", drawn_axis(low, high, tmp_path))
    labels = np.array([float(text) for text in shown])
    third = (high / low) ** (1 / 3)
    for k in range(3):
        assert ((labels >= low * third**k * 0.99) & (labels <= low * third ** (k + 1))).any(), k


@pytest.mark.parametrize(("low", "high"), [(0.048, 0.0632), (0.0101, 0.0142), (21.0, 29.0)])
def test_labels_of_an_axis_are_apart(low, high, tmp_path):
    """Times of training within a power of ten have long labels."""
    axis = drawn_axis(low, high, tmp_path)
    place = r'translate\(([-.\d]+),[-.\d]+\)"[^>]*font-size="10.5px"[^>]*opacity="1">([.\d]+)<'
    shown = [(float(at), 3.3 * text.count(".") + 6.7 * len(text.replace(".", "")))
             for at, text in re.findall(place, axis)]  # fmt: skip
    assert len(shown) > 3
    for (at, width), (after, other) in itertools.pairwise(shown):
        assert after - at - (width + other) / 2 > 5.5  # px


@pytest.mark.filterwarnings("error")
def test_a_logarithmic_panel_without_a_positive_value_is_drawn_in_silence(tmp_path):
    rows = points([0.0, 0.1], [0.0, np.nan], ("symo", "midpoint"))
    figure = Figure("k", "", "", [Panel("", "time [s]", "error", rows, mark="line")])
    assert save_figure(figure, tmp_path).is_file()


def test_data_without_noise_stand_at_zero(tmp_path):
    (figure,) = [one for one in FIGURES if one.key == "noise_chain"]
    (data, *_) = declare(figure, interactive=True)["datasets"].values()
    assert {row["x"] for row in data} == {0.0, 0.01}
    (file,) = draw_charts(figure, tmp_path, ["svg"])
    across = re.split(r">noise σ[^<]*</text>", file.read_text())[0].rpartition("axis-grid")[2]
    assert re.findall(r">([\d.]+)</text>", across) == ["0", "0.01"]


@pytest.mark.parametrize("size", [8, 32, 100])
def test_noises_and_orders_are_compared_at_the_size_that_there_is(size):
    table = runs()
    of_size = table[(table.n_traj == 32)].assign(n_traj=float(size))
    figures = {f.key: f for one in sections(of_size, Compared("")) for f in one.figures}
    assert figures["noise_chain"].title.endswith(f"{size} trajectories")
    assert "order_defaults" in figures


def test_integrators_of_one_order_are_not_compared_over_the_order():
    table = runs()
    level = table.assign(integrator=table.integrator.replace("galerkin4", "refined_midpoint"))
    assert "refined_midpoint" in set(level.integrator)
    level = level[level.integrator.isin(["midpoint", "refined_midpoint"])]
    keys = {f.key for one in sections(level, Compared("")) for f in one.figures}
    assert "data_size_chain_errors" in keys
    assert "order_defaults" not in keys


@pytest.mark.parametrize("integrator", ["midpoint", "rk4", "dopri5", "mine"])
def test_every_point_of_a_dense_cloud_is_seen(integrator, tmp_path):
    figure = phase_space_figure("k", "", {("symo", integrator): swing(0.1)})
    (file,) = draw_charts(figure, tmp_path, ["svg"])
    marks = [m for m in re.findall(r"<path [^>]*>", file.read_text()) if "#0072B2" in m]
    assert len(marks) > 200
    assert not any('fill-opacity="0"' in mark for mark in marks)
    assert "hollow" not in file.read_text()


@pytest.mark.parametrize(
    ("name", "angular", "wraps"),
    [("x", None, False), ("slide", False, False), ("theta", None, True), ("arm", None, True)],
)
def test_a_phase_portrait_wraps_what_may_be_an_angle_and_no_length(name, angular, wraps):
    table = swing(nodes=50).rename(columns=lambda column: column.replace("theta", name))
    table[[f"q_{name}", f"q_true_{name}"]] *= 8.0
    (panel,) = phase_space_figure("k", "", {PAIRS[0]: table}, angular).panels
    assert (panel.rows.x.abs().max() < np.pi) == wraps


def test_published_values_are_hollow_beside_a_cloud(tmp_path):
    at = pd.DataFrame({"x": [1.0, 2.0], "y": [1.0, 2.0], "method": "symo", "integrator": ""})
    sources = {"points": "ours", "both": "published"}
    panels = [Panel("", "x", "y", at.assign(source=s), mark=m) for m, s in sources.items()]
    (file,) = draw_charts(Figure("k", "", "", panels), tmp_path, ["svg"])
    marks = re.findall(r"<path [^>]*fill-opacity=.0. [^>]*>", file.read_text())
    assert len([one for one in marks if "#0072B2" in one]) == 2


def test_a_single_run_has_no_chart_of_one_point():
    table = runs()
    assert curves.speed(table)
    one = table[table.run_id == table.run_id.iloc[0]]
    assert not curves.speed(one)
    assert not curves.speed(pd.concat([one, one.assign(system="arm", run_id="another")]))


def test_published_values_and_several_integrators_have_legends():
    spec = vl_convert.vegalite_to_vega(declare(FIGURES[0], interactive=False))
    shown = {key for legend in spec["legends"] for key in legend if key in ("fill", "strokeDash")}
    assert shown == {"fill", "strokeDash"}
    panel = FIGURES[0].panels[0]
    both = panel.rows.assign(source="published")
    figure = Figure("k", "", "", [replace(panel, rows=pd.concat([panel.rows, both]))])
    legends = vl_convert.vegalite_to_vega(declare(figure, interactive=False))["legends"]
    assert ["ours", "published"] in [legend.get("values") for legend in legends]


def test_only_series_with_alternatives_can_be_switched_off():
    boxes = toggles(FIGURES)
    assert set(boxes["method"]) >= {look(name).label for name in (*METHODS, *TRUE, "mine")}
    assert set(boxes["source"]) == {"ours", "floor", "truth"}
    few = [figure for figure in FIGURES if figure.key == "motion_figure"]
    assert set(toggles(few)["method"]) == {look(method).label for method, _ in PAIRS}


@pytest.fixture(scope="module")
def report() -> Report:
    return Report("a <title> & more", "it", sections(runs(), Compared("")), runs())


@pytest.fixture(scope="module")
def page(report) -> str:
    return html(report)


def test_the_page_holds_the_figures_and_needs_nothing_else(report, page):
    assert "a &lt;title&gt; &amp; more" in page
    tags = re.sub(r"(<script[^>]*>).*?</script>", r"\1", page, flags=re.S)
    assert re.findall(r"<(?:script|link|img|iframe)\b[^>]*(?:src|href)\s*=", tags) == []
    assert len(page) < 2_000_000
    held = json.loads(re.search(r'id="held">(.*?)</script>', page, re.S).group(1))
    specs = json.loads(gzip.decompress(base64.b64decode(held["specs"])))
    there = {f.key: len(f.panels) for section in report.sections for f in section.figures}
    assert {key: len(spec["concat"]) for key, spec in specs.items()} == there


def test_a_page_without_figures_has_what_its_buttons_need_and_says_nothing_of_charts(report, page):
    bare = html(replace(report, sections=[replace(one, figures=()) for one in report.sections]))
    assert 'id="theme"' in bare
    assert 'getElementById("theme").addEventListener' in bare
    assert len(bare) < 50_000 < len(page)  # without the libraries that draw
    assert ["Charts: point" in text for text in (bare, page)] == [False, True]


def test_the_page_shows_bold_words_and_commands(report):
    said = Section("answer", "Answer", ['**Other <settings>**: `--settings "a"` compares them'])
    told = html(replace(report, sections=[said]))
    assert "<b>Other &lt;settings&gt;</b>: <code>--settings &#34;a&#34;</code> compares" in told


def test_the_page_begins_with_the_answer_and_ends_with_the_tables(page):
    order = [page.index(f'id="{key}"') for key in ("answer", "table_best_chain", "sizes", "tables")]
    assert order == sorted(order)
    assert '<details class="folded" id="state">' in page
    assert page.index("<b>From few data</b>") < order[2]


def test_the_figures_numbers_are_those_of_the_cells():
    found = cells(runs())
    (figure,) = [f for f in FIGURES if f.key == "data_size_chain_errors"]
    for panel, metric in zip(figure.panels, curves.ERRORS, strict=True):
        for one in panel.traces():
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


@pytest.mark.parametrize("table", [explicit_integrators, variational_integrators])
def test_the_order_in_the_file_of_an_integrator_is_that_of_its_class(table):
    """The report reads the files: importing the classes takes seconds."""
    assert {name: curves.order_of(name) for name in table()} == {
        name: made.order for name, made in table().items()
    }


def rows(source, y, method=""):
    x = np.arange(len(y), dtype=float)
    return pd.DataFrame({"x": x, "y": y, "source": source, "method": method, "integrator": ""})


def test_divergent_series_leave_the_picture_without_changing_its_scale():
    truth, lost = rows("truth", np.sin(np.arange(50.0))), rows("ours", [1e6] * 50, "symo")
    panel = Panel("", "t", "q", pd.concat([truth, lost]), y_log=False)
    low, high = panel.limits()
    assert -3 < low < -1 < 1 < high < 3
    lost = motion_figure("forced", "", {PAIRS[0]: swing(lost=True)})
    (data, *_) = declare(lost, interactive=True)["datasets"].values()
    assert all(row["y"] is None or np.isfinite(row["y"]) for row in data)
    assert motion_figure("forced", "", TABLES).panels[0].rows.x.max() <= LONG
    table = swing(lost=True).assign(squared_error=1e-3)
    table.v_theta = table.v_theta.where(np.isfinite(table.q_theta), np.inf)
    errors = motion_figure("forced", "", {PAIRS[0]: table}).panels[-2].rows
    assert errors.y.max() == 1e-3
    assert errors.y.isna().any()


def test_a_constant_truth_leaves_room_to_see_the_others():
    """The energy of an unforced motion has a spread of rounding errors only."""
    truth, ours = rows("truth", [0.64, 0.64 + 1e-15]), rows("ours", [0.63, 0.65], "symo")
    low, high = Panel("", "", "", pd.concat([truth, ours]), y_log=False).limits()
    assert low < 0.63 < 0.65 < high
    ours = rows("ours", [0.64, 0.64 + 1e-8], "symo")  # such an error would fill the axis
    low, high = Panel("", "", "", pd.concat([truth, ours]), y_log=False).limits()
    assert low < 0.635 < 0.645 < high


def test_a_symplectic_integrator_keeps_the_volume_small_steps_first():
    tables = {("true_ode", "rk4"): swing(0.1), ("true_variational", "midpoint"): swing()}
    (figure,) = drift_figures([Studied("drift", "chain", h, tables) for h in (0.2, 0.05)])
    assert [panel.title for panel in figure.panels] == ["step 0.05 s", "step 0.2 s"] * 2
    explicit, variational = figure.panels[-1].traces()
    assert explicit.rows.y.iloc[-1] < 1e-4
    assert set(variational.rows.y) == {1.0}
    assert figure.systems == ["chain"]


def test_names_become_symbols():
    assert axis_label("theta") == "θ [rad]"
    assert (
        axis_label("theta_12", angular=True) == axis_label("theta12", angular=True) == "θ₁₂ [rad]"
    )
    assert axis_label("x", velocity=True, angular=False) == "dx/dt [m/s]"
    assert axis_label("tilt", angular=True) == "tilt [rad]"


@pytest.mark.parametrize("angular", [True, False])
def test_latex_of_every_measure_with_its_unit_needs_no_other_letters(angular):
    names = [measure_name(metric, angular) for metric in MEASURES]
    text = latex(ResultTable("mine", "mine", pd.DataFrame([["1"] * len(names)], columns=names)))
    assert text.isascii()


def test_latex_escapes_what_it_must():
    text = latex(
        ResultTable("k", "50 % of a_b & c", pd.DataFrame({"x²": ["{1}"], "σ": ["÷2 ± 3"]}), ["#1"])
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


def test_numbers_that_are_not_finite_are_named_in_a_terminal():
    assert (written(math.inf), written(math.nan)) == ("inf", "nan")


@pytest.mark.parametrize(
    ("angular", "units"),
    [
        ((True, True), ["kg m²"] * 3),
        ((False, True), ["kg", "kg m", "kg m²"]),
        ((), ["kg, kg m, kg m²"] * 3),
    ],
)
def test_entries_of_the_inertia_have_the_units_of_their_coordinates(angular, units):
    """Names such as ``shoulder`` do not tell whether a coordinate is an angle."""
    entries = [f"inertia_{at}" for at in ("11", "12", "22")]
    table = pd.DataFrame({"t": [0.0, 1.0]}).assign(q_carriage=0.0, q_shoulder=0.0)
    table = table.assign(**dict.fromkeys(entries, 1.0))
    table = table.assign(**{f"{entry}_true": 1.0 for entry in entries})
    figure = learned_figure("k", "", {PAIRS[0]: table}, angular)
    assert [panel.y_label.split(" ", 1)[1] for panel in figure.panels] == [
        f"[{unit}]" for unit in units
    ]
