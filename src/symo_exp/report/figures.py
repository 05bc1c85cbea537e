"""Figures as data, whatever draws them: ``charts`` for the report, ``paper`` for a run.

A panel is a tidy table. Three of its columns determine the look of a row:

* ``method``, ``integrator``: names of the configuration; they set colour, marker and dash;
* ``source``: ``ours``, ``published``, ``floor`` (a true system in an integrator, or a baseline),
  ``truth`` or ``measured``;
* ``x``, ``y``: the point. Optional: ``low``, ``high``: the band around it; ``text``: a note.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import pandas as pd

from symo_exp.report.looks import MEASURED, TRUTH, Look, Stroke, in_order, look, pair_name, stroke

SMALLEST, LARGEST = 1e-33, 1e12
"""Limits of a logarithmic axis, even if a method has diverged."""
CONSTANT = 1e-6
"""Relative variation below which a truth counts as constant."""
SHOULD = {"truth": TRUTH, "measured": MEASURED}
"""Sources of the motions that models should predict."""
Range = tuple[float, float]


class Trace(NamedTuple):
    """One line or cloud of points."""

    source: str
    method: str
    integrator: str
    rows: pd.DataFrame

    @property
    def look(self) -> Look:
        """The colour and marker."""
        return SHOULD.get(self.source) or look(self.method)

    @property
    def stroke(self) -> Stroke:
        """The dash of the integrator."""
        return stroke(self.integrator)

    @property
    def label(self) -> str:
        """The name of the method."""
        return self.look.label

    @property
    def name(self) -> str:
        """The name with the integrator and the source."""
        if self.source in SHOULD:
            return self.label
        name = pair_name(self.method, self.integrator)
        return f"{name}, published" if self.source == "published" else name

    @property
    def band(self) -> bool:
        """True if there is a band around the line."""
        return "low" in self.rows and bool((self.rows.low < self.rows.high).any())


@dataclass(frozen=True)
class Panel:
    """One pair of axes.

    Args:
        title: The heading.
        x_label: The label of the x axis, with a unit.
        y_label: The label of the y axis, with a unit.
        rows: The data, with the columns that the module lists.
        x_log: Whether the x axis is logarithmic.
        y_log: Whether the y axis is logarithmic.
        mark: ``both`` lines and markers, ``line`` or ``points``.
        ticks: Ticks of the x axis; chosen if empty.
        only: The source that is drawn, all if empty; the others still set the limits.
        system: The system that the panel shows, for a page that selects one.
    """

    title: str
    x_label: str
    y_label: str
    rows: pd.DataFrame
    x_log: bool = False
    y_log: bool = True
    mark: str = "both"
    ticks: tuple[float, ...] = ()
    only: str = ""
    system: str = ""

    def traces(self) -> Iterator[Trace]:
        """Yield the truth, on which predictions lie, then the others in the order of methods."""
        rows = self.rows[self.rows.source == self.only] if self.only else self.rows
        groups = rows.groupby(["source", "method", "integrator"], sort=False)
        found = [Trace(*map(str, key), rows) for key, rows in groups]  # type: ignore
        places = {"truth": 0, "measured": 0, "published": 2}
        yield from sorted(
            found, key=lambda s: (places.get(s.source, 1), in_order((s.method, s.integrator)))
        )

    def limits(self) -> Range | None:
        """Return the limits of the y axis; a diverged method lies outside."""
        columns = [name for name in ("y", "low", "high") if name in self.rows]
        values = self.rows[columns].to_numpy(dtype=float)
        if not self.y_log:
            return _near(self._truth("y"), values)
        values = values[np.isfinite(values) & (values > 0)]
        if not len(values):
            return None
        low, high = max(values.min(), SMALLEST), min(values.max(), LARGEST)
        high = max(high, 10 * low)
        margin = max(2.0, (high / low) ** 0.03)  # room for a marker
        return float(low / margin), float(high * margin)

    def shows(self, trace: Trace) -> bool:
        """Return whether a point of a trace is within the limits of the y axis."""
        limits = self.limits()
        return limits is None or bool(trace.rows.y.astype(float).between(*limits).any())

    def x_limits(self) -> Range | None:
        """Return the limits of a linear x axis; a line over time is shown whole."""
        if self.x_log:
            return None
        x, true = self.rows.x.to_numpy(dtype=float), self._truth("x")
        return _near(true if len(true) or self.mark != "line" else x, x)

    def _truth(self, column: str) -> np.ndarray:
        return self.rows[self.rows.source.isin(SHOULD)][column].to_numpy(dtype=float)


@dataclass(frozen=True)
class Figure:
    """Panels with a title and a caption; panels without a value are left out.

    Args:
        key: The name of its files.
        title: The heading.
        caption: Text below the panels.
        panels: The panels, row by row.
        columns: Largest number of panels in a row; fewer if rows can then be of equal length.
    """

    key: str
    title: str
    caption: str
    panels: list[Panel]
    columns: int = 3

    def __post_init__(self) -> None:
        shown = [panel for panel in self.panels if panel.rows.y.notna().any()]
        object.__setattr__(self, "panels", shown)
        rows = -(-len(shown) // self.columns)
        object.__setattr__(self, "columns", -(-len(shown) // max(rows, 1)) or 1)

    @property
    def systems(self) -> list[str]:
        """The systems of its panels, each once."""
        return list(dict.fromkeys(panel.system for panel in self.panels))

    def of(self, system: str) -> Figure:
        """Return the figure with panels that all show one system."""
        return replace(self, panels=[replace(panel, system=system) for panel in self.panels])


def _near(truth: np.ndarray, values: np.ndarray) -> Range | None:
    """Return limits with all of ``truth``, and with the values that are not far from it."""
    inside, everything = truth[np.isfinite(truth)], values[np.isfinite(values)]
    if not len(inside):
        return None
    low, high = inside.min(), inside.max()
    # A constant truth, such as an energy, varies by rounding errors only.
    size = max(abs(low), abs(high))
    room = max(0.5 * (high - low), size) or 1.0
    bottom, top = max(low - room, everything.min()), min(high + room, everything.max())
    edge = 0.04 * (top - bottom) or 1.0
    if high - low < CONSTANT * size:  # an error that is much smaller would fill the axis
        edge = max(edge, 0.01 * size)
    return float(bottom - edge), float(top + edge)
