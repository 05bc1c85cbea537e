"""Charts of the report, declared once in Vega-Lite for the page and for files.

Colour and marker show the method, the dash of a line the integrator; in a cloud of points the
integrator is shown by how they are filled. Published values are faint, with hollow markers.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import altair as alt
import matplotlib
import numpy as np
import pandas as pd
import vl_convert

from symo_exp.files import write_bytes
from symo_exp.report.figures import SHOULD, Figure, Panel, Range, Trace

WIDTH, HEIGHT = 300, 220
"""Size of the plot of a panel in a file [px]; the page fits the width to the window."""
SCALE = 1.5
"""Pixels of a PNG for each of these."""
MANY, MARKED = 200, 6
"""Points of a panel from which they are drawn small; markers along a line over time."""
MARKERS = {
    "o": "circle", "s": "square", "^": "triangle-up", "D": "diamond", "v": "triangle-down",
    "P": "cross", "X": "M-.7,-1L0,-.3L.7,-1L1,-.7L.3,0L1,.7L.7,1L0,.3L-.7,1L-1,.7L-.3,0L-1,-.7Z",
    ".": "circle",
}  # fmt: skip
"""Vega's name or path for each marker of Matplotlib."""
FILLS = {0: 1.0, 2: 0.0, 4: 0.4}
"""Filling of points by the number of dashes of their integrator."""
OPACITY = {"ours": 1.0, "published": 0.5, "floor": 0.7, "truth": 0.4, "measured": 0.4}
LINES = {"ours": 1.8, "published": 1.0, "floor": 1.3, "truth": 3.5, "measured": 3.5}
INK = {"light": "#333333", "dark": "#dddddd"}
SOFT = {"light": "#666666", "dark": "#a0a0a0"}
GRID = {"light": "#e6e6e6", "dark": "#33363b"}
OFF = " && ".join(f"indexof(off, datum.{name}) < 0" for name in ("method", "integrator", "kind"))
"""Keeps the rows that have no name in ``off``, the list of what a reader has switched off."""
SHORT = (
    "abs({0}) >= 1e4 || ({0} != 0 && abs({0}) < 1e-3) "
    "? replace(format({0}, '.2~e'), 'e+', 'e') : format({0}, '.4~g')"
)
"""A number as the tables print it: ``1.66e-6`` or ``0.02``."""
LABEL = SHORT.format("datum.value")
DIGIT = "round(datum.value / pow(10, floor(log(datum.value) / LN10 + 1e-6)))"
ROUND = f"indexof([1, 2, 5], {DIGIT}) >= 0"
"""Which ticks of a logarithmic axis have labels."""
FAINT: Any = {"condition": {"test": f"{DIGIT} == 1", "value": 1}, "value": 0.45}
"""Opacity of grid lines, less between the powers of ten."""
TICKED = "(indexof(off, datum.label) < 0 ? '☑ ' : '☐ ') + datum.label"


def declare(figure: Figure, *, interactive: bool) -> dict[str, Any]:
    """Return the Vega-Lite specification of a figure.

    Args:
        figure: The panels and their data.
        interactive: Whether a reader can zoom, point at values and switch series off. The
            specification then has the parameters ``off``, a list of names that are not drawn, and
            ``ink``, the colour of true systems; it leaves the title to the page.
    """
    traces = [trace for panel in figure.panels for trace in panel.traces()]
    channels = _Channels(traces, interactive=interactive)
    charts = [
        _panel(panel, channels, f"zoom_{i}" if interactive else "")
        for i, panel in enumerate(figure.panels)
    ]
    chart = alt.concat(*charts, columns=figure.columns, spacing={"row": 25, "column": 30})
    # points of a cloud are filled by their integrator, others by their source
    chart = chart.resolve_scale(x="independent", y="independent", fillOpacity="independent")
    chart = chart.add_params(
        alt.param(name="off", value=[]), alt.param(name="ink", value=INK["light"])
    )
    if not interactive:
        chart = chart.properties(title=figure.title)
    with alt.data_transformers.disable_max_rows():
        made = chart.to_dict()
    made["config"] = config("light")
    return made


def config(theme: str) -> dict[str, Any]:
    """Return the Vega-Lite configuration of the ``light`` or the ``dark`` theme."""
    ink, soft, grid = INK[theme], SOFT[theme], GRID[theme]
    return {
        "background": "white" if theme == "light" else "transparent",
        "font": "DejaVu Sans, Verdana, sans-serif",
        "view": {"stroke": None},
        "title": {"anchor": "start", "color": ink, "subtitleColor": soft, "fontSize": 12,
                  "fontWeight": "normal", "subtitleFontSize": 10.5},
        "axis": {"labelColor": soft, "titleColor": ink, "gridColor": grid, "domainColor": soft,
                 "tickColor": soft, "titleFontWeight": "normal", "labelFontSize": 10.5,
                 "titleFontSize": 11, "labelOverlap": "greedy", "labelSeparation": 6},
        "axisY": {"minExtent": 44},
        "legend": {"orient": "top", "direction": "horizontal", "title": None, "labelColor": ink,
                   "labelFontSize": 11.5, "labelLimit": 260, "columns": 6, "symbolOpacity": 1,
                   "columnPadding": 14,
                   "layout": {"top": {"direction": "vertical", "anchor": "start", "margin": 4}}},
        "concat": {"spacing": 25},
    }  # fmt: skip


def draw_charts(figure: Figure, folder: Path, formats: Iterable[str]) -> list[Path]:
    """Write ``<key>.<format>`` for each of ``png``, ``pdf`` and ``svg`` asked for."""
    # Matplotlib ships a font that has the symbols of coordinates
    vl_convert.register_font_directory(f"{matplotlib.get_data_path()}/fonts/ttf")
    spec = json.dumps(declare(figure, interactive=False))
    paths = []
    for form in formats:
        path = folder / f"{figure.key}.{form}"
        if form == "png":
            content = vl_convert.vegalite_to_png(spec, scale=SCALE)
        elif form == "pdf":
            content = vl_convert.vegalite_to_pdf(spec)
        else:
            content = vl_convert.vegalite_to_svg(spec).encode()
        write_bytes(path, content)
        paths.append(path)
    return paths


class _Channels:
    """Encodings that the panels of a figure share, and with them its legends."""

    def __init__(self, traces: Sequence[Trace], *, interactive: bool) -> None:
        words: dict[str, Any] = {"labelExpr": TICKED} if interactive else {}
        looks = {trace.label: trace.look for trace in traces}
        legend = alt.Legend(**words)
        colours = _scale({name: _colour(look.colour) for name, look in looks.items()})
        shapes = _scale({name: MARKERS[look.marker] for name, look in looks.items()})
        self.colour = alt.Color("method:N", scale=colours, legend=legend)
        self.fill = alt.Fill("method:N", scale=colours, legend=legend)
        self.shape = alt.Shape("method:N", scale=shapes, legend=legend)

        strokes = {trace.stroke.label: trace.stroke.dash for trace in traces}
        dashes = _scale({name: list(dash or (1, 0)) for name, dash in strokes.items()})
        fills = _scale({name: FILLS[len(dash)] for name, dash in strokes.items()})
        named = _legend([name for name in strokes if name], words)
        self.dash = alt.StrokeDash("integrator:N", scale=dashes, legend=named)
        self.by_integrator = alt.FillOpacity("integrator:O", scale=fills, legend=None)

        sources = {trace.source for trace in traces}
        hollow = _scale({kind: float(kind != "published") for kind in OPACITY})
        both = _legend([name for name in ("ours", "published") if name in sources], words)
        self.opacity = alt.Opacity("kind:O", scale=_scale(OPACITY), legend=both)
        self.width = alt.StrokeWidth("kind:O", scale=_scale(LINES), legend=both)
        self.by_source = alt.FillOpacity("kind:O", scale=hollow, legend=None)


def _scale(values: Mapping[str, Any]) -> alt.Scale:
    return alt.Scale(type="ordinal", domain=list(values), range=list(values.values()))


def _legend(names: Sequence[str], words: dict[str, Any]) -> alt.Legend | None:
    """Return a legend of grey strokes, none of a single name."""
    if len(names) < 2:
        return None
    grey = SOFT["light"]
    return alt.Legend(
        values=list(names), symbolType="stroke", symbolSize=400,
        symbolStrokeColor=grey, symbolFillColor=grey, **words,
    )  # fmt: skip


def _panel(panel: Panel, channels: _Channels, zoom: str) -> alt.LayerChart:
    """Bands, lines and points of a panel; ``zoom`` names the selection of a page's reader."""
    x, up = _axes(panel)
    base = alt.Chart(_rows(panel)).encode(
        x=x, y=alt.Y("y:Q", **up), detail=["integrator:N", "kind:N"]
    )
    base = base.transform_filter(OFF)
    said = base.transform_calculate(value=SHORT.format("datum.y"), at=SHORT.format("datum.x"))
    layers = []
    if any(trace.band for trace in panel.traces()):
        band = base.mark_area(opacity=0.15, clip=True, tooltip=None)
        low = alt.Y("low:Q", **up)
        layers.append(band.encode(y=low, y2="high:Q", fill=channels.fill))
    if panel.mark != "points":
        line = base.mark_line(clip=True, tooltip=None)
        layers.append(
            line.encode(
                color=channels.colour,
                strokeDash=channels.dash,
                strokeWidth=channels.width,
                opacity=channels.opacity,
            )
        )
    layers.append(_points(said, panel, channels))
    if zoom and panel.mark == "line":  # a value to point at where there is no marker
        at = said.mark_point(clip=True, size=50, opacity=0, filled=True)
        layers.append(at.encode(color=channels.colour, tooltip=_tooltip(panel)))
    if zoom:
        layers[-1] = layers[-1].add_params(
            alt.selection_interval(name=zoom, bind="scales", zoom="wheel![event.ctrlKey]")
        )
    notes = _notes(panel)
    title = alt.TitleParams(panel.title, subtitle=notes or alt.Undefined)
    return alt.layer(*layers).properties(title=title, width=WIDTH, height=HEIGHT)


def _points(said: alt.Chart, panel: Panel, channels: _Channels) -> alt.Chart:
    """Return the markers: all of a cloud, some along a line over time."""
    encoded = {"fill": channels.fill, "opacity": channels.opacity, "tooltip": _tooltip(panel)}
    if _is_dense(panel):
        return said.mark_square(clip=True, size=4).encode(**encoded)
    cloud = panel.mark == "points"
    points = said.mark_point(clip=True, size=36, strokeWidth=1.2).encode(
        color=channels.colour,
        shape=channels.shape,
        fillOpacity=channels.by_integrator if cloud else channels.by_source,
        **encoded,
    )
    return points.transform_filter("datum.marked") if panel.mark == "line" else points


def _is_dense(panel: Panel) -> bool:
    """Return whether points are too many for markers of their own and for fillings."""
    return panel.mark == "points" and len(panel.rows) > MANY


def _axes(panel: Panel) -> tuple[alt.X, dict[str, Any]]:
    """Return the x channel, and scale and axis of the y channel."""
    x_limits, zero = panel.x_limits(), 0.0
    there = panel.rows.x[panel.rows.x > 0]
    if x_limits is None and panel.x_log and len(there):
        if (panel.rows.x == 0).any():
            zero = there.min() / 4
        x_limits = (-0.15 * zero or there.min() / 1.15, there.max() * 1.15)
    across = _axis(panel.x_label, panel.x_log, x_limits, panel.ticks, zero)
    return alt.X("x:Q", **across), _axis(panel.y_label, panel.y_log, panel.limits())


def _axis(
    label: str, log: bool, limits: Range | None, ticks: Sequence[float] = (), zero: float = 0.0
) -> dict[str, Any]:
    """Return scale and axis of a channel; ``zero`` is where a logarithmic axis has its zero."""
    given = {"domain": list(limits), "nice": False} if limits else {"padding": 8}
    scale = alt.Scale(type="log", **given) if log else alt.Scale(zero=False, **given)
    if zero:  # linear below it
        scale = alt.Scale(type="symlog", constant=zero, **given)
    words: dict[str, Any] = {"title": label or None, "labelExpr": LABEL}
    if ticks:
        words["values"] = list(ticks)
    elif log:
        words |= _decades(limits)
    else:
        words["tickCount"] = 5
    return {"scale": scale, "axis": alt.Axis(**words)}


def _decades(limits: Range | None) -> dict[str, Any]:
    """Return the ticks and grid lines of a logarithmic axis, and its labels if they are special."""
    decades = math.log10(limits[1] / limits[0]) if limits else 0
    # Vega draws the ticks between powers of ten where there are fewer powers than this; asked for
    # two in almost three powers, it would draw one
    words = {"tickCount": min(int(decades), 6) if decades >= 3 else 10, "gridOpacity": FAINT}
    if decades >= 1:  # within a power of ten Vega spaces the ticks evenly
        words["labelExpr"] = f"{ROUND} ? ({LABEL}) : ''"
    return words


def _rows(panel: Panel) -> pd.DataFrame:
    """Return the data of a panel as they are drawn, five digits of each number."""
    numbers = [name for name in ("x", "y", "low", "high") if name in panel.rows]
    parts = []
    for order, trace in enumerate(panel.traces()):
        rows = trace.rows[numbers].astype(float).replace([np.inf, -np.inf], np.nan)
        if panel.y_log:
            rows = rows.where((rows > 0) | (rows.columns == "x"))
        rows = rows.map(lambda x: float(f"{x:.5g}"))
        if "text" in trace.rows:
            rows["text"] = trace.rows.text.fillna("")
        if panel.mark == "line":
            step = max(1, len(rows) // MARKED)
            first = int(step * (0.3 + 0.17 * order)) % step
            rows["marked"] = (np.arange(len(rows)) % step == first) & (trace.source not in SHOULD)
        parts.append(
            rows.assign(
                name=trace.name,
                method=trace.label,
                kind=trace.source,
                integrator=trace.stroke.label,
            )
        )
    return pd.concat(parts)


def _tooltip(panel: Panel) -> list[alt.Tooltip]:
    label = panel.y_label if panel.y_label[:1] != "[" else f"{panel.title} {panel.y_label}"
    shown = [
        alt.Tooltip("name:N", title="title"),  # set in bold as the heading
        alt.Tooltip("value:N", title=label or panel.title),
        alt.Tooltip("at:N", title=panel.x_label),
    ]
    return [*shown, alt.Tooltip("text:N", title="note")] if "text" in panel.rows else shown


def _notes(panel: Panel) -> list[str]:
    """Return notes on traces beyond the limits and on the meaning of fillings."""
    notes = [f"{t.name}: off the scale" for t in panel.traces() if not panel.shows(t)]
    strokes = {t.stroke.label: t.stroke.dash for t in panel.traces() if t.stroke.label}
    if panel.mark == "points" and any(strokes.values()) and not _is_dense(panel):
        words = {1.0: "filled", 0.0: "hollow", 0.4: "half filled"}
        notes.append(
            ", ".join(f"{words[FILLS[len(dash)]]}: {name}" for name, dash in strokes.items())
        )
    return notes


def _colour(colour: str) -> Any:
    """Dark greys, of true systems, follow the theme."""
    red, green, blue = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return alt.expr("ink") if red == green == blue < 0x60 else colour
