"""``python -m symo_exp.report``: tables, figures and a page from the runs of a tracking store.

Exit codes: 0 written, 2 bad input.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from symo_exp.errors import ConfigError

if TYPE_CHECKING:
    from symo_exp.report.runs import Runs
    from symo_exp.tracking.store import Store

FORMATS = ("png", "pdf", "svg")


def parser() -> argparse.ArgumentParser:
    """What can be typed."""
    made = argparse.ArgumentParser(
        prog="python -m symo_exp.report",
        description="Tables, figures and an interactive page from tracked runs, beside the "
        "published figures of the thesis.",
    )
    add = made.add_argument
    add("--experiment", nargs="+", default=[], metavar="NAME",
        help="default: thesis, and of saved runs all")  # fmt: skip
    add("--system", nargs="+", default=[], metavar="NAME", help="only these systems")
    add("--seed", nargs="+", default=[], type=int, metavar="N", help="only these seeds")
    add(
        "--tracking-uri",
        metavar="URI",
        help="default: MLFLOW_TRACKING_URI, else SQLite in --directory",
    )
    add(
        "--directory",
        default="mlruns",
        metavar="FOLDER",
        help="of the SQLite store; default: mlruns",
    )
    add("--runs", nargs="+", default=[], type=Path, metavar="FILE",
        help="runs.csv or runs.parquet of earlier reports, in place of a store")  # fmt: skip
    add("--out", default="report", type=Path, metavar="FOLDER", help="default: report")
    add("--formats", nargs="*", default=["png", "pdf"], choices=FORMATS, metavar="FORMAT",
        help="of the figures: png, pdf, svg, or none of them; default: png pdf")  # fmt: skip
    add("--no-page", action="store_true", help="leave out index.html (5 MB)")
    return made


def main(argv: Sequence[str] | None = None) -> int:
    """The command line. Returns the exit code."""
    options = parser().parse_args(argv)
    start = time.perf_counter()
    try:
        files = _made(options)
    except ConfigError as error:
        print(f"symo_exp.report: error: {error}", file=sys.stderr)
        return 2
    seconds = time.perf_counter() - start
    names = {path.name: path for path in files}
    first = names.get("index.html", names["report.md"])
    print(f"{first}: {len(files)} files in {options.out} ({seconds:.0f} s)")
    return 0


def _made(options: argparse.Namespace) -> list[Path]:
    from symo_exp.report.build import report, write

    experiments = options.experiment or ([] if options.runs else ["thesis"])
    runs, store = _read(options, experiments)
    asked = {
        "experiment": experiments,
        "saved runs": options.runs,
        "systems": options.system,
        "seeds": options.seed,
    }
    source = [f"{name} {', '.join(map(str, words))}" for name, words in asked.items() if words]
    try:
        return write(
            report(runs, "; ".join(source), store),
            options.out,
            formats=options.formats,
            web=not options.no_page,
        )
    except OSError as error:
        reason = error.strerror or error
        raise ConfigError(f"--out {options.out} cannot be written ({reason})") from error


def _read(options: argparse.Namespace, experiments: list[str]) -> tuple[Runs, Store | None]:
    """The runs that were asked for, and the store they are in, if it is one."""
    from symo_exp.report.runs import read
    from symo_exp.report.saved import load
    from symo_exp.tracking.store import find

    asked = {"systems": options.system, "seeds": options.seed}
    if options.runs:
        return load(options.runs, experiments, **asked), None
    store = find(options.tracking_uri, options.directory)
    return read(store, experiments, **asked), store


if __name__ == "__main__":
    sys.exit(main())
