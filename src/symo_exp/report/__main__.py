"""``python -m symo_exp.report``: tables, figures and a page from runs, whatever they are of."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

from symo_exp.report import command

if TYPE_CHECKING:
    import pandas as pd

    from symo_exp.report.write import Report
    from symo_exp.tracking.store import Store

ABOUT = "Tables, figures and an interactive page from the runs of a store, or saved ones."


def report(runs: pd.DataFrame, source: str, store: Store | None = None) -> Report:
    """Everything that can be said of the runs; ``source`` says where they are from."""
    from symo_exp.report.overview import sections
    from symo_exp.report.write import Report

    title = ", ".join(sorted(set(runs.experiment))) or "No runs"
    return Report(title, source, sections(runs, store), runs)


def main(argv: Sequence[str] | None = None) -> int:
    """The command line. Returns the exit code."""
    return command.main(argv, "symo_exp.report", ABOUT, report)


if __name__ == "__main__":
    sys.exit(main())
