"""What a figure shows, apart from who draws it: on paper (``paper``) or in a browser (``page``).

A panel is a tidy table; what a row is drawn as follows from three of its columns:

* ``method``, ``integrator``: names of the configuration; they set colour, marker and dash;
* ``source``: ``ours``, ``published``, ``floor`` (a true system in an integrator) or ``truth``;
* ``x``, ``y``: the point; ``low``, ``high``: the band around it; ``text``: said of it in a browser.
  The last three may be left out.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pandas as pd

from symo_exp.report.looks import TRUTH, Look, Stroke, in_order, look, pair_name, stroke

SMALLEST, LARGEST = 1e-33, 1e12
"""What a logarithmic axis shows at most, whatever has diverged."""
Range = tuple[float, float]


class Trace(NamedTuple):
    """One line or cloud of points."""

    source: str
    method: str
    integrator: str
    rows: pd.DataFrame

    @property
    def look(self) -> Look:
        return TRUTH if self.source == "truth" else look(self.method)

    @property
    def stroke(self) -> Stroke:
        return stroke(self.integrator)

    @property
    def label(self) -> str:
        """The name of the method."""
        return self.look.label

    @property
    def name(self) -> str:
        """The name with the integrator and the source."""
        if self.source == "truth":
            return self.label
        name = pair_name(self.method, self.integrator)
        return f"{name}, published" if self.source == "published" else name

    @property
    def band(self) -> bool:
        return "low" in self.rows and bool((self.rows.low < self.rows.high).any())


@dataclass(frozen=True)
class Panel:
    """One pair of axes. ``mark`` is ``both``, ``line`` (no marks at points) or ``points``."""

    title: str
    x_label: str
    y_label: str
    rows: pd.DataFrame
    x_log: bool = False
    y_log: bool = True
    mark: str = "both"
    ticks: tuple[float, ...] = ()
    """Where the x axis has its ticks; empty: anywhere."""
    only: str = ""
    """The source that is drawn; the others count for what the axes show."""
    system: str = ""
    """For the page, which shows one system or all."""

    def traces(self) -> Iterator[Trace]:
        """The truth first, so that a prediction lies on it; then in the order of methods."""
        rows = self.rows[self.rows.source == self.only] if self.only else self.rows
        groups = rows.groupby(["source", "method", "integrator"], sort=False)
        found = [Trace(*map(str, key), rows) for key, rows in groups]  # type: ignore
        places = {"truth": 0, "published": 2}
        yield from sorted(
            found, key=lambda s: (places.get(s.source, 1), in_order((s.method, s.integrator)))
        )

    def limits(self) -> Range | None:
        """What the y axis shows: one diverged method must not squeeze the others."""
        columns = [name for name in ("y", "low", "high") if name in self.rows]
        values = self.rows[columns].to_numpy(dtype=float)
        if not self.y_log:
            return _near(self._truth("y"), values)
        values = values[np.isfinite(values) & (values > 0)]
        if not len(values):
            return None
        low, high = max(values.min(), SMALLEST), min(values.max(), LARGEST)
        high = max(high, 10 * low)
        margin = max(2.0, (high / low) ** 0.03)  # a marker at the end is whole
        return float(low / margin), float(high * margin)

    def x_limits(self) -> Range | None:
        """The same of a linear x axis: of a line over time all of it, however early one is lost."""
        if self.x_log:
            return None
        x, true = self.rows.x.to_numpy(dtype=float), self._truth("x")
        return _near(true if len(true) or self.mark != "line" else x, x)

    def _truth(self, column: str) -> np.ndarray:
        return self.rows[self.rows.source == "truth"][column].to_numpy(dtype=float)


@dataclass(frozen=True)
class Figure:
    """``key`` names its files. Of panels that show nothing, none is kept."""

    key: str
    title: str
    caption: str
    panels: list[Panel]
    columns: int = 3
    """How many panels stand in a row on paper, at most."""
    system: str = ""

    def __post_init__(self) -> None:
        shown = [panel for panel in self.panels if panel.rows.y.notna().any()]
        object.__setattr__(self, "panels", shown)

    @property
    def systems(self) -> list[str]:
        """The systems of its panels, each once."""
        return list(dict.fromkeys(panel.system or self.system for panel in self.panels))


def _near(truth: np.ndarray, values: np.ndarray) -> Range | None:
    """A range that has all of the truth, and of ``values`` what is not far from it."""
    inside, everything = truth[np.isfinite(truth)], values[np.isfinite(values)]
    if not len(inside):
        return None
    low, high = inside.min(), inside.max()
    # A constant truth, such as an energy, varies by rounding errors only.
    room = max(0.5 * (high - low), abs(low), abs(high)) or 1.0
    bottom, top = max(low - room, everything.min()), min(high + room, everything.max())
    edge = 0.04 * (top - bottom) or 1.0
    return float(bottom - edge), float(top + edge)
