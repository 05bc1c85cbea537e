"""``python -m symo_exp.thesis``: chapter 6 from runs, beside what is published of it."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from symo_exp.report import command

if TYPE_CHECKING:
    import pandas as pd

    from symo_exp.report.write import Report, Section
    from symo_exp.tracking.store import Store

ABOUT = "Chapter 6 of the thesis from the runs of a store, or saved ones, beside the published."
TITLE = "Symplectic momentum networks: the experiments of chapter 6"


def report(runs: pd.DataFrame, source: str, store: Store | None = None) -> Report:
    """The general report with the published beside it, and what the chapter says."""
    from symo_exp.report.cells import at_step, cells, main_variant
    from symo_exp.report.overview import sections
    from symo_exp.report.write import Report, Section
    from symo_exp.thesis import chapter, published

    variant, found = main_variant(runs), cells(runs)
    compared = published.beside(found)
    usual = at_step(found, published.TIME_STEPS)
    mine = at_step(runs[(runs.variant == variant) & (runs.source == "ours")], published.TIME_STEPS)
    state, *others = sections(runs, store, published.as_cells(variant))
    own = [
        Section("progress", "What of chapter 6 has been run", tables=[*chapter.progress(runs)]),
        Section("tables", "Tables of chapter 6", tables=[*chapter.beside(usual, compared)]),
        Section("agreement", "Agreement with the published numbers",
                tables=[chapter.agreement(compared)]),
        Section("claims", "The statements of the thesis", tables=[chapter.claims(mine)]),
    ]  # fmt: skip
    parts = [state, *filter(None, own), *map(_numbered, others)]
    return Report(TITLE, source, parts, runs, {"published.csv": compared})


def _numbered(section: Section) -> Section:
    """With the numbers of the thesis' figures in the titles of ours."""
    from symo_exp.thesis.published import figures

    told = {key: f" (thesis, figure {number})" for key, number in figures().items()}
    titled = [replace(one, title=one.title + told.get(one.key, "")) for one in section.figures]
    return replace(section, figures=titled)


def main(argv: Sequence[str] | None = None) -> int:
    """The command line. Returns the exit code."""
    return command.main(argv, "symo_exp.thesis", ABOUT, report, ["thesis"])


if __name__ == "__main__":
    sys.exit(main())
