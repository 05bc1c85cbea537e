"""Figures and tables as one HTML page that needs nothing else: no network, no server."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jinja2
import numpy as np

from symo_exp.report.figures import Figure, Panel, Series
from symo_exp.report.looks import MARKERS, TRUTH, look

if TYPE_CHECKING:
    from symo_exp.report.write import Section

WEB = Path(__file__).parent / "web"
GREY = "#666666"
SOURCES = {
    "ours": ("ours", "●"), "published": ("published", "○"),
    "floor": ("floors (true system)", "•"), "truth": (TRUTH.label, "━"),
}  # fmt: skip
"""What the page says of each source of a series, and with which letter."""
WIDTHS = {"ours": 2.0, "published": 1.0, "floor": 1.5, "truth": 3.0}
MODES = {"both": "lines+markers", "line": "lines", "points": "markers"}


def page(title: str, summary: str, sections: Sequence[Section]) -> str:
    """The HTML text."""
    from plotly.offline import get_plotlyjs

    figures = [figure for section in sections for figure in section.figures]
    panels = {figure.key: [plotly(panel) for panel in figure.panels] for figure in figures}
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(WEB), autoescape=True, undefined=jinja2.StrictUndefined
    )
    return environment.get_template("page.html").render(
        title=title,
        summary=summary,
        sections=sections,
        toggles=toggles(figures),
        panels=json.dumps(panels, separators=(",", ":")).replace("<", "\\u003c"),
        css=(WEB / "page.css").read_text(encoding="utf-8"),
        js=(WEB / "page.js").read_text(encoding="utf-8"),
        plotly=get_plotlyjs(),
    )


def toggles(figures: Iterable[Figure]) -> dict[str, list[dict[str, str]]]:
    """A box for every method, integrator and source that the figures show, which hides its series.

    The boxes are the legend of the page: each has the mark of what it switches.
    """
    seen = [series for figure in figures for panel in figure.panels for series in panel.series()]
    looks = {s.method: look(s.method) for s in seen if s.method}
    strokes = {s.integrator: s.stroke for s in seen if s.integrator}
    marks = {s.source: SOURCES[s.source] for s in seen}
    methods = {m: {"label": x.label, "colour": x.colour, "mark": MARKERS[x.marker][1]}
               for m, x in looks.items()}  # fmt: skip
    integrators = {i: {"label": x.label, "dash": x.web} for i, x in strokes.items()}
    sources = {s: {"label": label, "mark": mark} for s, (label, mark) in marks.items()}
    groups = {"method": methods, "integrator": integrators, "source": sources}
    return {
        by: [{"value": value, "colour": GREY, "dash": "", **box} for value, box in boxes.items()]
        for by, boxes in groups.items() if boxes
    }  # fmt: skip


def plotly(panel: Panel) -> dict[str, Any]:
    """A panel as Plotly's JSON: ``data`` and ``layout``."""
    x_axis = _axis(panel.x_label, panel.x_log, panel.x_limits())
    if panel.ticks:
        x_axis |= {"tickvals": panel.ticks, "ticktext": [f"{x:g}" for x in panel.ticks]}
    layout = {
        "title": {"text": panel.title, "font": {"size": 13}, "x": 0.02, "y": 0.98},
        "xaxis": x_axis, "yaxis": _axis(panel.y_label, panel.y_log, panel.limits()),
        "showlegend": False, "hovermode": "closest",
        "margin": {"l": 62, "r": 10, "t": 28, "b": 42}, "font": {"size": 11, "color": "#333"},
    }  # fmt: skip
    return {"data": [t for s in panel.series() for t in _traces(panel, s)], "layout": layout}


def _axis(label: str, log: bool, limits: Sequence[float] | None) -> dict[str, Any]:
    shown = {} if limits is None else {"range": np.log10(limits).tolist() if log else limits}
    return {
        "title": {"text": label, "font": {"size": 11}}, "type": "log" if log else "linear",
        "gridcolor": "#e6e6e6", "linecolor": "#888", "zeroline": False, "ticks": "outside",
        "ticklen": 3, "exponentformat": "power", **shown,
    }  # fmt: skip


def _traces(panel: Panel, series: Series) -> Iterator[dict[str, Any]]:
    """The band, where there is one, and the line or the points."""
    rows, colour, source = series.rows, series.look.colour, series.source
    meta = {"method": series.method, "integrator": series.integrator, "source": source}
    common = {"type": "scatter", "x": _plain(rows.x), "meta": meta}
    if series.band:
        edge = common | {"mode": "lines", "line": {"width": 0}, "hoverinfo": "skip"}
        yield edge | {"y": _plain(rows.low)}
        yield edge | {"y": _plain(rows.high), "fill": "tonexty", "fillcolor": f"{colour}22"}
    hollow = source == "published" or (panel.mark == "points" and series.stroke.dash != "-")
    symbol = MARKERS[series.look.marker][0] + ("-open" if hollow else "")
    said = "%{y:.3g} at %{x:.3~g}" + ("<br>%{text}" if "text" in rows else "")
    yield common | {
        "y": _plain(rows.y),
        "name": series.name,
        "mode": MODES[panel.mark],
        "line": {"color": colour, "dash": series.stroke.web, "width": WIDTHS[source]},
        "opacity": 0.6 if source in ("floor", "truth") else 1,
        "marker": {"color": colour, "size": 3 if len(rows) > 200 else 7, "symbol": symbol},
        "hovertemplate": f"<b>{series.name}</b><br>{said}<extra></extra>",
        **({"text": rows.text.fillna("").tolist()} if "text" in rows else {}),
    }


def _plain(values: Any) -> list[float | None]:
    """JSON has no infinite numbers; a gap is drawn in their place."""
    numbers = np.asarray(values, dtype=float)
    return [float(f"{x:.7g}") if np.isfinite(x) else None for x in numbers]
