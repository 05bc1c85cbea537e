"""The report with chapter 6 of the thesis: ``python -m symo_exp.report --thesis``."""

from __future__ import annotations

from dataclasses import replace

import pandas as pd

from symo_exp.report.cells import Compared, at_step, cells, last_compared
from symo_exp.report.document import Report, Section
from symo_exp.report.overview import sections
from symo_exp.thesis import chapter, published
from symo_exp.tracking.store import Store

TITLE = "Symplectic momentum networks: the experiments of chapter 6"


def thesis_report(
    runs: pd.DataFrame, source: str, store: Store | None = None, settings: str | None = None
) -> Report:
    """Return the general report with the published values and the statements of the chapter.

    Args:
        runs: The tidy table of runs (``report.runs``).
        source: Where the runs are from, for the last line.
        store: Where the files of studies are, unless in folders.
        settings: The settings of the answer; the defaults, or the most frequent ones, if not given.
    """
    every = tuple(sorted(set(runs[runs.source == "ours"].variant)))
    compared = Compared(chapter.main_variant(runs), every)
    if settings is not None:
        compared = last_compared(runs, settings)
    variant, found = compared.variant, cells(runs)
    theirs = published.with_ours(found)
    usual = at_step(found, published.TIME_STEPS)
    mine = at_step(runs[(runs.variant == variant) & (runs.source == "ours")], published.TIME_STEPS)
    first, *others = map(_numbered, sections(runs, compared, store, published.as_cells(variant)))
    own = [
        Section("claims", "The statements of the thesis", tables=[chapter.claims(mine)]),
        Section("agreement", "Agreement with the published numbers",
                tables=[chapter.agreement(theirs)]),
        Section("chapter", "Tables of chapter 6", tables=[*chapter.chapter_tables(usual, theirs)]),
    ]  # fmt: skip
    last = Section("progress", "Runs of chapter 6", tables=[*chapter.progress(runs)], folded=True)
    parts = [first, *filter(None, own), *others, last]
    return Report(TITLE, source, parts, runs, {"published.csv": theirs})


def _numbered(section: Section) -> Section:
    """Return the section with the numbers of the thesis' figures in its titles."""
    told = {
        key: f" (thesis, figure {number})" for key, number in published.thesis_figures().items()
    }
    titled = [replace(one, title=one.title + told.get(one.key, "")) for one in section.figures]
    return replace(section, figures=titled)
