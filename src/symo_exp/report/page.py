"""Figures and tables as one HTML page that needs nothing else: no network, no server, no library.

Its own script (``web/page.js``) draws the panels as SVG from the numbers here, when they come into
view: for lines, bands and marks that is a hundredth of a plotting library, and drawings take the
page's colours, light or dark.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jinja2
import numpy as np

from symo_exp.report.figures import Figure, Panel, Series
from symo_exp.report.looks import MARKERS, TRUTH, look

if TYPE_CHECKING:
    from symo_exp.report.write import Report

WEB = Path(__file__).parent / "web"
SOURCES = {
    "ours": "ours", "published": "published (hollow)", "floor": "true system (thin)",
    "truth": TRUTH.label,
}  # fmt: skip
"""What the page calls each source of a series."""


def page(made: Report) -> str:
    """The HTML text."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(WEB), autoescape=True, undefined=jinja2.StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    environment.filters["bold"] = _bold
    figures = [figure for section in made.sections for figure in section.figures]
    tables = [table for section in made.sections for table in section.tables]
    systems = {panel.system or figure.system for figure in figures for panel in figure.panels}
    systems |= {table.system for table in tables}
    panels = {figure.key: [drawn(panel) for panel in figure.panels] for figure in figures}
    return environment.get_template("page.html").render(
        made=made,
        systems=sorted(filter(None, systems)),
        toggles=toggles(figures),
        panels=json.dumps(panels, separators=(",", ":")).replace("<", "\\u003c"),
        css=(WEB / "page.css").read_text(encoding="utf-8"),
        js=(WEB / "page.js").read_text(encoding="utf-8"),
    )


def toggles(figures: Iterable[Figure]) -> dict[str, dict[str, str]]:
    """Names of every method, integrator and source of the figures, of which there are several."""
    seen = [series for figure in figures for panel in figure.panels for series in panel.series()]
    groups = {
        "method": {s.method: look(s.method).label for s in seen if s.method},
        "integrator": {s.integrator: s.stroke.label for s in seen if s.integrator},
        "source": {s.source: SOURCES[s.source] for s in seen},
    }
    return {by: boxes for by, boxes in groups.items() if len(boxes) > 1}


def drawn(panel: Panel) -> dict[str, Any]:
    """A panel as the script takes it."""
    axes = [
        {"label": panel.x_label, "log": panel.x_log, "range": panel.x_limits(),
         "ticks": panel.ticks},
        {"label": panel.y_label, "log": panel.y_log, "range": panel.limits(), "ticks": ()},
    ]  # fmt: skip
    series = [_series(one) for one in panel.series()]
    return {"title": panel.title, "mark": panel.mark, "axes": axes, "series": series}


def _series(series: Series) -> dict[str, Any]:
    rows = series.rows
    columns = ["x", "y", *(("low", "high") if series.band else ())]
    return {
        "name": series.name,
        "method": series.method, "integrator": series.integrator, "source": series.source,
        "colour": _in_both_lights(series.look.colour),
        "dash": series.stroke.web, "marker": MARKERS[series.look.marker],
        **{column: _plain(rows[column]) for column in columns},
        **({"text": rows.text.fillna("").tolist()} if "text" in rows else {}),
    }  # fmt: skip


def _in_both_lights(colour: str) -> str:
    """A grey is turned over in the dark; other colours are seen on both grounds."""
    red, green, blue = (colour[i : i + 2] for i in (1, 3, 5))
    if not red == green == blue:
        return colour
    return f"light-dark({colour},#{3 * f'{255 - int(red, 16):02x}'})"


def _bold(escaped: str) -> str:
    return re.sub(r"\*\*(.+?)\*\*", r"<b>\1</b>", str(escaped))


def _plain(values: Sequence[float]) -> list[float | None]:
    """JSON has no infinite numbers; a gap is drawn in their place."""
    numbers = np.asarray(values, dtype=float)
    return [float(f"{x:.5g}") if np.isfinite(x) else None for x in numbers]
