"""``python -m symo_exp.report``: tables, figures and a page of runs.

Exit codes: 0 written, 2 bad input, 130 interrupted.
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
from symo_exp.words import counted

if TYPE_CHECKING:
    import pandas as pd

    from symo_exp.report.document import Report
    from symo_exp.tracking.store import Store

THESIS = "symo_exp.thesis.view:thesis_report"
"""By name, so that nothing imports the thesis."""
OUTPUTS, STORE = Path("outputs"), "mlruns"
SEVERAL: dict[str, Any] = {"nargs": "+", "default": []}
OPTIONS: dict[str, dict[str, Any]] = {
    "--experiment": {
        **SEVERAL, "metavar": "NAME",
        "help": "only these experiments; default: if there are several, the command asks for one; "
        "without a terminal it takes the last one that ran",
    },
    "--all": {"action": "store_true", "help": "all experiments together"},
    "--settings": {
        "metavar": "TEXT",
        "help": "compare the runs with these settings, in the words of the tables (defaults for "
        "runs that change none); default: those of the last sweep",
    },
    "--system": {**SEVERAL, "metavar": "NAME", "help": "only these systems"},
    "--seed": {**SEVERAL, "metavar": "N", "type": int, "help": "only these seeds"},
    "--tracking-uri": {
        "metavar": "URI",
        "help": "tracking store; default: MLFLOW_TRACKING_URI, else SQLite in --directory",
    },
    "--directory": {
        "metavar": "FOLDER",
        "help": f"folder of the SQLite store; default: {STORE} or, without a store, the runs in "
        f"{OUTPUTS}",
    },
    "--runs": {**SEVERAL, "type": Path, "metavar": "PATH", "help": "the same as PATH above"},
    "--out": {
        "default": "report", "type": Path, "metavar": "FOLDER",
        "help": "folder to write; default: report",
    },
    "--formats": {
        "nargs": "*", "default": [], "choices": ("png", "pdf", "svg"), "metavar": "FORMAT",
        "help": "also write the figures as files: png, pdf, svg",
    },
    "--no-page": {"action": "store_true", "help": "do not write index.html"},
    "--thesis": {
        "action": "store_true",
        "help": "add chapter 6 of the thesis: its published numbers, tables and claims",
    },
}  # fmt: skip


def general_report(
    runs: pd.DataFrame, source: str, store: Store | None = None, settings: str | None = None
) -> Report:
    """Return the report of any runs.

    Args:
        runs: The tidy table of runs (``report.runs``).
        source: Where the runs are from, for the last line.
        store: Where the files of studies are, unless in folders.
        settings: The settings of the answer; those of the last sweep if not given.
    """
    from symo_exp.report.cells import last_compared
    from symo_exp.report.document import Report
    from symo_exp.report.overview import sections, title

    simulated = runs[runs.recording == ""]
    parts = sections(runs, last_compared(simulated, settings), store)
    return Report(title(runs), source, parts, runs)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m symo_exp.report",
        description="Compare methods by their runs: a page, tables and figures.",
    )
    parser.add_argument(
        "paths", nargs="*", type=Path, metavar="PATH",
        help="folders of runs (outputs/demo), runs.csv or runs.parquet of earlier reports; "
        "default: the tracking store",
    )  # fmt: skip
    for name, option in OPTIONS.items():
        parser.add_argument(name, **option)
    options = parser.parse_intermixed_args(argv)
    start = time.perf_counter()
    try:
        files = _write(options)
    except ConfigError as error:
        print(f"symo_exp.report: error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("symo_exp.report: interrupted", file=sys.stderr)
        return 130
    seconds = time.perf_counter() - start
    names = {path.name: path for path in files}
    first = names.get("index.html", names["report.md"])
    print(f"{first}: {len(files)} files in {options.out} ({seconds:.0f} s)")
    return 0


def _write(options: argparse.Namespace) -> list[Path]:
    from symo_exp.report.files import write_report

    runs, source, store = _read(options)
    view: Callable[..., Report] = general_report
    if options.thesis:
        view = pkgutil.resolve_name(THESIS)
    report = view(runs, source, store, options.settings)
    try:
        return write_report(report, options.out, formats=options.formats, page=not options.no_page)
    except OSError as error:
        reason = error.strerror or error
        raise ConfigError(f"--out {options.out} cannot be written ({reason})") from error


def _read(options: argparse.Namespace) -> tuple[pd.DataFrame, str, Store | None]:
    """Return the runs, a sentence on where they are from, and their store unless in folders."""
    from symo_exp.report.runs import load_runs
    from symo_exp.tracking.store import find

    asked = {"systems": options.system, "seeds": options.seed}
    named, paths = options.experiment, _paths(options)
    store = None if paths else find(options.tracking_uri, options.directory or STORE)
    runs = load_runs(store or paths, named, **asked)
    every = options.all or named or options.paths or options.runs
    if not every and runs.experiment.nunique() > 1:
        named = [_chosen(runs)]
        runs = runs[runs.experiment.isin(named)].reset_index(drop=True)
    of = {"experiment": named, "saved runs": paths, **asked}
    source = "; ".join(f"{k} {', '.join(map(str, words))}" for k, words in of.items() if words)
    return runs, f"From {source or 'all experiments'}.", store


def _paths(options: argparse.Namespace) -> list[Path]:
    """Return folders and files of runs; that of all runs if none is given and there is no store."""
    given = [*options.paths, *options.runs]
    told = options.tracking_uri or options.directory or os.environ.get("MLFLOW_TRACKING_URI")
    if given or told or Path(STORE, "mlflow.db").exists() or not OUTPUTS.is_dir():
        return given
    return [OUTPUTS]


def _chosen(runs: pd.DataFrame) -> str:
    """Return the experiment that is chosen at a terminal, or else the one that ran last."""
    each = runs.drop_duplicates("run_id").groupby("experiment")
    started = each.started.max().sort_values(ascending=False)
    names, last = list(map(str, started.index)), str(started.index[0])
    if sys.stdin.isatty() and sys.stdout.isatty():
        print("Experiments, the last first:")
        for i, name in enumerate(names):
            runs_of = counted(len(each.get_group(name)), "run")
            print(f"{i + 1:4d}  {name}: {runs_of}, {started[name]:%F %H:%M}")
        return _answered(names)
    print(
        f"{last}: the last of {len(names)} experiments; --experiment NAME chooses another "
        f"({', '.join(names[1:])}), --all takes all."
    )
    return last


def _answered(names: Sequence[str]) -> str:
    """Return the name that is typed at a terminal, by itself or by its number."""
    try:
        answer = input(f"Which one? [1: {names[0]}] ").strip() or "1"
    except EOFError:
        print()
        raise ConfigError("no experiment was chosen; give --experiment NAME, or --all") from None
    if answer.isdigit() and 0 < int(answer) <= len(names):
        return names[int(answer) - 1]
    if answer in names:
        return answer
    raise ConfigError(f"no experiment {answer!r}; give its number or name")


if __name__ == "__main__":
    sys.exit(main())
