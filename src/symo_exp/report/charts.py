"""What a figure shows, apart from who draws it: on paper (``paper``) or in a browser (``page``)."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Literal

Source = Literal["ours", "published", "floor", "truth"]
SMALLEST, LARGEST = 1e-16, 1e12
"""What an axis shows at most, whatever has diverged."""


@dataclass(frozen=True)
class Series:
    """One line or cloud of points, with what a reader can switch on and off by.

    ``method`` and ``integrator`` are names of the configuration; they set colour and stroke.
    ``low`` and ``high`` bound each point. ``hover`` is said of each point in a browser.
    """

    method: str
    integrator: str
    x: list[float]
    y: list[float]
    source: Source = "ours"
    low: list[float] = field(default_factory=list)
    high: list[float] = field(default_factory=list)
    hover: list[str] = field(default_factory=list)
    points: bool = False
    """Points that no line joins."""
    lined: bool = False
    """A line without marks at its points."""
    name: str = ""
    """What the legend says; left out, the method and the integrator."""

    @property
    def level(self) -> bool:
        """Whether it is but a level to compare with."""
        return self.source == "floor" and len(self.x) == 2 and self.y[0] == self.y[1]


@dataclass(frozen=True)
class Panel:
    """One pair of axes."""

    title: str
    x_label: str
    y_label: str
    series: list[Series]
    x_log: bool = False
    y_log: bool = True
    ticks: list[float] = field(default_factory=list)
    """Where the x axis has its ticks; empty: anywhere."""
    y_range: tuple[float, float] | None = None
    """What a linear y axis shows; none: everything."""

    def within(self, low: float, high: float) -> Panel:
        """The same with bounds."""
        return replace(self, y_range=(low, high))

    def limits(self) -> tuple[float, float] | None:
        """What the y axis shows: one diverged method must not squeeze the others."""
        if not self.y_log:
            return self.y_range
        values = [y for s in self.series for y in (*s.y, *s.low, *s.high)]
        values = [y for y in values if math.isfinite(y) and y > 0]
        if not values:
            return None
        low, high = max(min(values), SMALLEST), min(max(values), LARGEST)
        return low / 2, 2 * max(high, 10 * low)


@dataclass(frozen=True)
class Chart:
    """One figure: ``key`` names its files, ``number`` the figure of the thesis it repeats."""

    key: str
    title: str
    caption: str
    panels: list[Panel]
    number: str = ""

    @property
    def empty(self) -> bool:
        return not any(series.x for panel in self.panels for series in panel.series)
