"""Charts on paper: PNG and PDF by Matplotlib."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from symo_exp.report.charts import Chart, Panel, Series
from symo_exp.report.labels import pair_name
from symo_exp.report.style import RC, TRUTH, look, stroke

WIDTH, HEIGHT, COLUMNS = 3.7, 2.7, 3
"""Size of a panel [inch], and how many stand in a row at most."""


def save(chart: Chart, folder: Path, formats: Iterable[str] = ("png", "pdf")) -> list[Path]:
    """Write ``<key>.<format>`` for each format."""
    folder.mkdir(parents=True, exist_ok=True)
    with matplotlib.rc_context(RC):  # type: ignore[arg-type]
        figure = draw(chart)
        paths = [folder / f"{chart.key}.{form}" for form in formats]
        for path in paths:
            # no date: the same store gives the same bytes
            figure.savefig(path, metadata={"CreationDate": None} if path.suffix == ".pdf" else None)
            figure.set_layout_engine("none")  # it is laid out now, which takes the longest
    return paths


def draw(chart: Chart) -> Figure:
    """All panels, then one legend for them."""
    columns = min(COLUMNS, len(chart.panels))
    rows = -(-len(chart.panels) // columns)
    legend = _legend(chart.panels)
    beside = columns + 1  # entries of the longest names that fit side by side
    lines = -(-len(legend) // beside)
    height = rows * HEIGHT + 0.45 + 0.19 * lines
    figure = Figure(figsize=(max(columns, 2) * WIDTH, height), layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False).flatten()
    for axes, panel in zip(grid, chart.panels, strict=False):
        _panel(axes, panel)
    for axes in grid[len(chart.panels) :]:
        axes.remove()
    figure.suptitle(_title(chart), x=0.01, ha="left", fontsize=11)
    figure.legend(
        handles=list(legend.values()), labels=list(legend), loc="outside lower left",
        ncols=beside, fontsize=7.5, handlelength=2.6,
    )  # fmt: skip
    return figure


def _title(chart: Chart) -> str:
    return f"{chart.title} (thesis, figure {chart.number})" if chart.number else chart.title


def _panel(axes: Axes, panel: Panel) -> None:
    if panel.x_log:
        axes.set_xscale("log")
    if panel.y_log:
        axes.set_yscale("log")
    for series in panel.series:
        _draw(axes, series)
    axes.set_title(panel.title)
    axes.set_xlabel(panel.x_label)
    axes.set_ylabel(panel.y_label)
    limits = panel.limits()
    if limits:
        axes.set_ylim(*limits)
    if panel.ticks:
        axes.set_xticks(panel.ticks, [f"{x:g}" for x in panel.ticks])
    if panel.x_log:
        axes.xaxis.set_minor_formatter(NullFormatter())


def _draw(axes: Axes, series: Series) -> None:
    style = _style(series)
    x, y = np.array(series.x, dtype=float), _finite(series.y)
    if series.points:
        size = 4 if len(x) < 200 else 1
        axes.plot(x, y, "o", color=style["color"], ms=size, mfc=_filling(series), alpha=0.8)
        return
    axes.plot(x, y, **style)
    if series.low and series.low != series.high:
        axes.fill_between(
            x, _finite(series.low), _finite(series.high), color=style["color"], alpha=0.15, lw=0
        )


def _style(series: Series) -> dict[str, Any]:
    colour, dash = look(series.method).colour, stroke(series.integrator).dash
    common = {"color": colour, "ls": dash}
    if series.source == "published":
        return common | {"lw": 0.7, "alpha": 0.8, "marker": "o", "mfc": "none", "ms": 4.5}
    if series.source == "floor":
        return common | {"lw": 1.1, "alpha": 0.7, "marker": "" if series.level else "."}
    if series.source == "truth":
        return {"color": TRUTH.colour, "ls": "-", "lw": 2.4, "alpha": 0.35}
    marker = "" if series.lined else "."
    return common | {"lw": 1.5, "marker": marker, "ms": 6}


def _filling(series: Series) -> str:
    """Points have no stroke: those of midpoint are full, others rings."""
    return look(series.method).colour if series.integrator == "midpoint" else "none"


def _finite(values: Sequence[float]) -> np.ndarray:
    numbers = np.array(values, dtype=float)
    return np.where(np.isfinite(numbers), numbers, np.nan)


def _legend(panels: Sequence[Panel]) -> dict[str, object]:
    from matplotlib.lines import Line2D

    entries: dict[str, object] = {}
    for panel in panels:
        for series in panel.series:
            if series.source == "published":
                ring: dict[str, Any] = {"marker": "o", "mfc": "none", "lw": 0.7, "color": "#777777"}
                entries.setdefault("published", Line2D([], [], **ring))
            elif series.points:
                colour = _style(series)["color"]
                entries.setdefault(
                    _name(series),
                    Line2D([], [], marker="o", ls="", color=colour, mfc=_filling(series)),
                )
            else:
                entries.setdefault(_name(series), Line2D([], [], **_style(series)))
    last = entries.pop("published", None)
    return entries | ({"published": last} if last else {})


def _name(series: Series) -> str:
    return series.name or pair_name(series.method, series.integrator)
