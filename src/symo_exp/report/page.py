"""Charts and tables as one HTML page that needs nothing else: no network, no server."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import jinja2

from symo_exp.report.charts import Chart, Panel, Series
from symo_exp.report.labels import pair_name
from symo_exp.report.style import TRUTH, look, stroke
from symo_exp.report.tables import Table

WEB = Path(__file__).parent / "web"
SOURCES = {
    "ours": "ours", "published": "published", "floor": "floors (true system)", "truth": "truth",
}  # fmt: skip


@dataclass(frozen=True)
class Section:
    """One heading of the page, and what stands under it."""

    key: str
    title: str
    text: Sequence[str] = ()
    tables: Sequence[Table] = ()
    charts: Sequence[Chart] = ()


@dataclass(frozen=True)
class Toggle:
    """A box that shows or hides all series of one ``value`` ``by`` method, integrator or source."""

    by: str
    value: str
    label: str
    colour: str = "#666"
    stroke: str = "solid"


@dataclass
class _Seen:
    methods: dict[str, None] = field(default_factory=dict)
    integrators: dict[str, None] = field(default_factory=dict)
    sources: dict[str, None] = field(default_factory=dict)


def page(title: str, summary: str, sections: Sequence[Section]) -> str:
    """The HTML text."""
    from plotly.offline import get_plotlyjs

    charts = [chart for section in sections for chart in section.charts]
    panels = {chart.key: [figure(panel) for panel in chart.panels] for chart in charts}
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(WEB), autoescape=True, undefined=jinja2.StrictUndefined
    )
    return environment.get_template("page.html").render(
        title=title,
        summary=summary,
        sections=sections,
        toggles=toggles(charts),
        panels=json.dumps(panels, separators=(",", ":")).replace("<", "\\u003c"),
        css=(WEB / "page.css").read_text(encoding="utf-8"),
        js=(WEB / "page.js").read_text(encoding="utf-8"),
        plotly=get_plotlyjs(),
    )


def toggles(charts: Iterable[Chart]) -> list[tuple[str, list[Toggle]]]:
    """A box for every method, integrator and source that the charts show."""
    seen = _Seen()
    for series in (s for chart in charts for panel in chart.panels for s in panel.series):
        if series.source in ("ours", "published"):
            seen.methods.setdefault(series.method)
        seen.integrators.setdefault(series.integrator)
        seen.sources.setdefault(series.source)
    methods = [Toggle("method", m, look(m).label, look(m).colour) for m in seen.methods]
    integrators = [
        Toggle("integrator", i, stroke(i).label, stroke=stroke(i).web)
        for i in seen.integrators if i
    ]  # fmt: skip
    sources = [Toggle("source", s, SOURCES[s], stroke="none") for s in SOURCES if s in seen.sources]
    groups = [("methods", methods), ("integrators", integrators), ("shown", sources)]
    return [(name, boxes) for name, boxes in groups if len(boxes) > 1]


def figure(panel: Panel) -> dict[str, Any]:
    """A panel as Plotly's JSON: ``data`` and ``layout``."""
    x_axis = _axis(panel.x_label, panel.x_log)
    if panel.ticks:
        x_axis |= {"tickvals": panel.ticks, "ticktext": [f"{x:g}" for x in panel.ticks]}
    y_axis = _axis(panel.y_label, panel.y_log) | {"exponentformat": "power"}
    limits = panel.limits()
    if limits:
        y_axis |= {"range": [math.log10(x) for x in limits] if panel.y_log else list(limits)}
    data = [trace for series in panel.series for trace in _traces(series)]
    layout = {
        "title": {"text": panel.title, "font": {"size": 13}, "x": 0.02, "y": 0.98},
        "xaxis": x_axis,
        "yaxis": y_axis,
        "showlegend": False,
        "hovermode": "closest",
        "margin": {"l": 62, "r": 10, "t": 28, "b": 42},
        "font": {"size": 11, "color": "#333"},
        "plot_bgcolor": "#fff",
        "paper_bgcolor": "#fff",
    }
    return {"data": data, "layout": layout}


def _axis(label: str, log: bool) -> dict[str, Any]:
    return {
        "title": {"text": label, "font": {"size": 11}},
        "type": "log" if log else "linear",
        "gridcolor": "#e6e6e6",
        "linecolor": "#888",
        "zeroline": False,
        "ticks": "outside",
        "ticklen": 3,
    }


def _traces(series: Series) -> Iterable[dict[str, Any]]:
    colour = TRUTH.colour if series.source == "truth" else look(series.method).colour
    meta = {"method": series.method, "integrator": series.integrator, "source": series.source}
    common = {"type": "scatter", "x": _plain(series.x), "meta": meta}
    if series.low and series.low != series.high:
        edge = common | {"mode": "lines", "line": {"width": 0}, "hoverinfo": "skip"}
        yield edge | {"y": _plain(series.low)}
        band = {"fill": "tonexty", "fillcolor": _faint(colour)}
        yield edge | {"y": _plain(series.high), **band}
    name = series.name or pair_name(series.method, series.integrator)
    said = "%{y:.3g} at %{x:g}" + ("<br>%{text}" if series.hover else "")
    line = {
        "color": colour,
        "dash": stroke(series.integrator).web,
        "width": {"ours": 2, "floor": 1.5, "published": 1, "truth": 2.5}[series.source],
    }
    marked = series.points or not (series.lined or series.level)
    yield common | {
        "y": _plain(series.y),
        "name": name,
        "mode": "markers" if series.points else "lines+markers" if marked else "lines",
        "line": line,
        "opacity": 0.75 if series.source in ("floor", "truth") else 1,
        "marker": {
            "color": colour,
            "size": _size(series),
            "symbol": "circle-open" if _open(series) else "circle",
        },
        "hovertemplate": f"<b>{name}</b><br>{said}<extra></extra>",
        **({"text": list(series.hover)} if series.hover else {}),
    }


def _size(series: Series) -> int:
    if len(series.x) > 200:
        return 2
    return 8 if series.points or series.source == "published" else 5


def _open(series: Series) -> bool:
    return series.source == "published" or (series.points and series.integrator != "midpoint")


def _plain(values: Sequence[float]) -> list[float | None]:
    """JSON has no infinite numbers; a gap is drawn in their place."""
    return [float(x) if math.isfinite(x) else None for x in values]


def _faint(colour: str) -> str:
    red, green, blue = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return f"rgba({red},{green},{blue},0.13)"
