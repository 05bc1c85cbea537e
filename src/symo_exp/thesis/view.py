"""``python -m symo_exp.report --thesis``: the report with chapter 6 of the thesis beside it."""

from __future__ import annotations

from dataclasses import replace

import pandas as pd

from symo_exp.report.cells import at_step, cells, main_variant
from symo_exp.report.document import Report, Section
from symo_exp.report.overview import sections
from symo_exp.thesis import chapter, published
from symo_exp.tracking.store import Store

TITLE = "Symplectic momentum networks: the experiments of chapter 6"


def report(runs: pd.DataFrame, source: str, store: Store | None = None) -> Report:
    """The general report with the published beside it, and what the chapter says."""
    variant, found = main_variant(runs), cells(runs)
    compared = published.beside(found)
    usual = at_step(found, published.TIME_STEPS)
    mine = at_step(runs[(runs.variant == variant) & (runs.source == "ours")], published.TIME_STEPS)
    first, *others = map(_numbered, sections(runs, store, published.as_cells(variant)))
    own = [
        Section("claims", "The statements of the thesis", tables=[chapter.claims(mine)]),
        Section("agreement", "Agreement with the published numbers",
                tables=[chapter.agreement(compared)]),
        Section("chapter", "Tables of chapter 6", tables=[*chapter.beside(usual, compared)]),
    ]  # fmt: skip
    last = Section(
        "progress", "What of chapter 6 has been run", tables=[*chapter.progress(runs)], folded=True
    )
    parts = [first, *filter(None, own), *others, last]
    return Report(TITLE, source, parts, runs, {"published.csv": compared})


def _numbered(section: Section) -> Section:
    """With the numbers of the thesis' figures in the titles of ours."""
    told = {key: f" (thesis, figure {number})" for key, number in published.figures().items()}
    titled = [replace(one, title=one.title + told.get(one.key, "")) for one in section.figures]
    return replace(section, figures=titled)
