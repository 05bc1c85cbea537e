"""The report as one HTML page that works without a network.

The page has the charts as Vega-Lite specifications, compressed, and the libraries that draw them.
"""

from __future__ import annotations

import base64
import functools
import gzip
import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import jinja2
import vl_convert

from symo_exp.report.charts import config, declare
from symo_exp.report.figures import Figure

if TYPE_CHECKING:
    from symo_exp.report.document import Report

WEB = Path(__file__).parent / "web"
SOURCES = {"floor": "true system"}
"""Sources whose names are not for a reader."""


def html(report: Report) -> str:
    """Return the page as text."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(WEB), autoescape=True, undefined=jinja2.StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    environment.filters["marked"] = _marked
    figures = report.figures
    systems = {system for figure in figures for system in figure.systems}
    systems |= {table.system for table in report.tables}
    return environment.get_template("page.html").render(
        report=report,
        systems=sorted(filter(None, systems)),
        toggles=toggles(figures),
        held=_held(figures),
        bundle=_bundle() if figures else "",
        css=(WEB / "page.css").read_text(encoding="utf-8"),
        js=(WEB / "embed.js").read_text(encoding="utf-8"),
    )


def toggles(figures: Sequence[Figure]) -> dict[str, dict[str, str]]:
    """Return the methods, integrators and sources, each kind if the figures show more than one.

    The keys are the names in the data of the charts, the values are for a reader.
    """
    traces = [trace for figure in figures for panel in figure.panels for trace in panel.traces()]
    groups = {
        "method": {trace.label: trace.label for trace in traces if trace.method},
        "integrator": {t.stroke.label: t.stroke.label for t in traces if t.stroke.label},
        "source": {trace.source: SOURCES.get(trace.source, trace.source) for trace in traces},
    }
    return {group: names for group, names in groups.items() if len(names) > 1}


def _marked(text: str) -> str:
    """Return a paragraph with bold words and commands as HTML."""
    return re.sub(r"`(.+?)`", r"<code>\1</code>", re.sub(r"\*\*(.+?)\*\*", r"<b>\1</b>", str(text)))


def _held(figures: Sequence[Figure]) -> str:
    specs = {
        figure.key: declare(figure, interactive=True)
        | {"usermeta": {"systems": [panel.system for panel in figure.panels]}}
        for figure in figures
    }
    # no time of writing: the same runs give the same bytes
    packed = gzip.compress(json.dumps(specs, separators=(",", ":")).encode(), mtime=0)
    themes = {theme: config(theme) for theme in ("light", "dark")}
    return json.dumps({"specs": base64.b64encode(packed).decode(), "themes": themes})


@functools.cache
def _bundle() -> str:
    """Vega, Vega-Lite and vega-embed."""
    return vl_convert.javascript_bundle("window.vegaEmbed = vegaEmbed;").replace(
        "</script", "<\\/script"
    )
