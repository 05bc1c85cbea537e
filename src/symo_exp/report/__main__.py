"""``python -m symo_exp.report``: the answer, figures and tables of runs, whatever they are of.

Exit codes: 0 written, 2 bad input.
"""

from __future__ import annotations

import argparse
import os
import pkgutil
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from symo_exp.errors import ConfigError
from symo_exp.shell import python_command

if TYPE_CHECKING:
    import pandas as pd

    from symo_exp.report.document import Report
    from symo_exp.tracking.store import Store

VIEW = "symo_exp.report.__main__:report"
THESIS = "symo_exp.thesis.view:report"
"""By name: the thesis is a guest that nothing imports."""
OUTPUTS, STORE = Path("outputs"), "mlruns"
SEVERAL: dict[str, Any] = {"nargs": "+", "default": []}
OPTIONS: dict[str, dict[str, Any]] = {
    "--experiment": {**SEVERAL, "metavar": "NAME", "help": "only these experiments; default: all"},
    "--system": {**SEVERAL, "metavar": "NAME", "help": "only these systems"},
    "--seed": {**SEVERAL, "metavar": "N", "type": int, "help": "only these seeds"},
    "--tracking-uri": {
        "metavar": "URI", "help": "default: MLFLOW_TRACKING_URI, else SQLite in --directory",
    },
    "--directory": {
        "metavar": "FOLDER",
        "help": f"of the SQLite store; default: {STORE}, and without it the runs in {OUTPUTS}",
    },
    "--runs": {
        **SEVERAL, "type": Path, "metavar": "PATH",
        "help": "in place of a store: folders of runs, runs.csv or runs.parquet of earlier reports",
    },
    "--out": {"default": "report", "type": Path, "metavar": "FOLDER", "help": "default: report"},
    "--formats": {
        "nargs": "*", "default": [], "choices": ("png", "pdf", "svg"), "metavar": "FORMAT",
        "help": "figures as files besides: png, pdf, svg; a few seconds each",
    },
    "--no-page": {"action": "store_true", "help": "leave out index.html"},
    "--thesis": {
        "action": "store_const", "const": THESIS, "default": VIEW, "dest": "view",
        "help": "with chapter 6 of the thesis: its published numbers, tables and statements",
    },
}  # fmt: skip


def report(runs: pd.DataFrame, source: str, store: Store | None = None) -> Report:
    """Everything that can be said of the runs; ``source`` says where they are from."""
    from symo_exp.report.document import Report
    from symo_exp.report.overview import sections, title

    return Report(title(runs), source, sections(runs, store), runs)


def main(argv: Sequence[str] | None = None) -> int:
    """The command line. Returns the exit code."""
    parser = argparse.ArgumentParser(
        prog=python_command("symo_exp.report"),
        description="Which method is best, by these runs: a page, tables and figures. Without an "
        "option: of all runs that there are.",
    )
    for name, option in OPTIONS.items():
        parser.add_argument(name, **option)
    options = parser.parse_args(argv)
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
    from symo_exp.report.files import write_report
    from symo_exp.report.runs import load_runs, read_runs
    from symo_exp.tracking.store import find

    asked = {"systems": options.system, "seeds": options.seed}
    named, paths, store = options.experiment, options.runs, None
    told = options.tracking_uri or options.directory or os.environ.get("MLFLOW_TRACKING_URI")
    if not (paths or told or Path(STORE, "mlflow.db").exists()) and OUTPUTS.is_dir():
        paths = [OUTPUTS]
    if paths:
        runs = load_runs(paths, named, **asked)
    else:
        store = find(options.tracking_uri, options.directory or STORE)
        runs = read_runs(store, named, **asked)
    of = {"experiment": named, "saved runs": paths, **asked}
    source = "; ".join(f"{k} {', '.join(map(str, words))}" for k, words in of.items() if words)
    view: Callable[..., Report] = pkgutil.resolve_name(options.view)
    made = view(runs, f"From {source or 'all experiments'}.", store)
    try:
        return write_report(made, options.out, formats=options.formats, page=not options.no_page)
    except OSError as error:
        reason = error.strerror or error
        raise ConfigError(f"--out {options.out} cannot be written ({reason})") from error


if __name__ == "__main__":
    sys.exit(main())
