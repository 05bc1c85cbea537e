"""Figures of single runs as files, drawn by Matplotlib."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib import figure as mpl
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from symo_exp.report.figures import Figure, Panel, Trace
from symo_exp.report.looks import RC, short

WIDTH, HEIGHT = 3.7, 2.7
"""Size of a panel [inch]."""
MANY_POINTS, LONG_LINE = 200, 5000
"""Numbers of points from which markers are drawn small and lines thin."""
STYLES: dict[str, dict[str, Any]] = {
    "ours": {"lw": 1.5, "ms": 3.5},
    "floor": {"lw": 1.1, "ms": 4, "alpha": 0.7},
    "truth": {"lw": 2.6, "ms": 2.4, "alpha": 0.35},
    "measured": {"lw": 2.6, "ms": 2.4, "alpha": 0.35},
}


def save_figure(figure: Figure, folder: Path) -> Path:
    """Write ``<key>.png`` into an existing folder."""
    path = folder / f"{figure.key}.png"
    with matplotlib.rc_context(RC):  # type: ignore[arg-type]
        draw(figure).savefig(path)
    return path


def draw(figure: Figure) -> mpl.Figure:
    """Return all panels with one legend."""
    columns = figure.columns
    rows = -(-len(figure.panels) // columns)
    legend = _legend(figure.panels)
    across = columns + 1  # entries of the longest names that fit side by side
    height = rows * HEIGHT + 0.45 + 0.19 * -(-len(legend) // across)
    drawn = mpl.Figure(figsize=(max(columns, 2) * WIDTH, height), layout="constrained")
    grid = drawn.subplots(rows, columns, squeeze=False).flatten()
    for axes, panel in zip(grid, figure.panels, strict=False):
        _panel(axes, panel)
    for axes in grid[len(figure.panels) :]:
        axes.remove()
    title = textwrap.fill(figure.title, 36 * max(columns, 2))
    drawn.suptitle(title, x=0.01, ha="left", fontsize=11)
    drawn.legend(
        handles=list(legend.values()), labels=list(legend), loc="outside lower left",
        ncols=across, fontsize=7.5, handlelength=3.2,
    )  # fmt: skip
    return drawn


def _panel(axes: Axes, panel: Panel) -> None:
    limits = panel.limits()
    axes.set(yscale="log" if panel.y_log and limits else "linear")
    axes.set(title=panel.title, xlabel=panel.x_label, ylabel=panel.y_label)
    for trace in panel.traces():
        _draw(axes, panel, trace)
    shown = {"ylim": limits, "xlim": panel.x_limits()}
    axes.set(**{name: bounds for name, bounds in shown.items() if bounds})
    gone = [_off(trace) for trace in panel.traces() if not panel.shows(trace)]
    axes.text(
        0.5, 0.97, "\n".join(gone), transform=axes.transAxes, ha="center", va="top",
        color="#777777", fontsize=7,
    )  # fmt: skip


def _draw(axes: Axes, panel: Panel, trace: Trace) -> None:
    rows = trace.rows
    x = _finite(rows.x)
    axes.plot(x, _finite(rows.y), **_style(panel, trace))
    if trace.band:
        low, high = _finite(rows.low), _finite(rows.high)
        axes.fill_between(x, low, high, color=trace.look.colour, alpha=0.15, lw=0)


def _off(trace: Trace) -> str:
    """Return a note on a trace that is outside the limits."""
    y = _finite(trace.rows.y)
    where = short(float(np.nanmedian(y))) if np.isfinite(y).any() else "diverged"
    return f"{trace.name}: off the scale ({where})"


def _style(panel: Panel, trace: Trace) -> dict[str, Any]:
    look, count = trace.look, len(trace.rows)
    style: dict[str, Any] = {"color": look.colour, **STYLES[trace.source]}
    if panel.mark == "points":
        small = {"ms": 1.2, "marker": "."} if count > MANY_POINTS else {"marker": look.marker}
        return style | {"ls": "", "alpha": 0.8} | small
    dash = (0, trace.stroke.dash) if trace.stroke.dash else "-"
    if count > LONG_LINE:
        style["lw"] = 0.6
    elif panel.only:  # nothing is drawn on it, but the line itself may come close again
        style["lw"] = 0.8
    return style | {"ls": dash}


def _finite(values: Any) -> np.ndarray:
    numbers = np.asarray(values, dtype=float)
    return np.where(np.isfinite(numbers), numbers, np.nan)


def _legend(panels: Iterable[Panel]) -> dict[str, Line2D]:
    """Return a mark for each name."""
    entries: dict[str, Line2D] = {}
    for panel, trace in ((one, trace) for one in panels for trace in one.traces()):
        style = _style(panel, trace)
        seen = {"ms": max(style["ms"], 6.0)} if "ms" in style else {}  # a dot is hardly seen alone
        entries.setdefault(trace.name, Line2D([], [], **style | seen))
    return entries
