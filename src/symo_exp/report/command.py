"""The command line of a report. Exit codes: 0 written, 2 bad input."""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from symo_exp.errors import ConfigError

if TYPE_CHECKING:
    import pandas as pd

    from symo_exp.report.write import Report
    from symo_exp.tracking.store import Store

Make = Callable[["pd.DataFrame", str, "Store | None"], "Report"]
"""A report from runs, a text that says where they are from, and the store, if it is one."""
OUTPUTS, STORE = Path("outputs"), "mlruns"
SEVERAL: dict[str, Any] = {"nargs": "+", "default": []}
OPTIONS: dict[str, dict[str, Any]] = {
    "--experiment": {**SEVERAL, "metavar": "NAME", "help": "only these experiments; default: {}"},
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
        "nargs": "*", "default": ["png", "pdf"], "choices": ("png", "pdf", "svg"),
        "metavar": "FORMAT",
        "help": "of the figures: png, pdf, svg, or none of them; default: png pdf",
    },
    "--no-page": {"action": "store_true", "help": "leave out index.html (5 MB)"},
}  # fmt: skip


def main(
    argv: Sequence[str] | None, module: str, about: str, make: Make, experiments: Sequence[str] = ()
) -> int:
    """The command line. Returns the exit code."""
    parser = argparse.ArgumentParser(prog=f"python -m {module}", description=about)
    default = ", ".join(experiments) + ", and of saved runs all" if experiments else "all"
    for name, option in OPTIONS.items():
        parser.add_argument(name, **{**option, "help": option["help"].format(default)})
    options = parser.parse_args(argv)
    start = time.perf_counter()
    try:
        files = _made(options, make, experiments)
    except ConfigError as error:
        print(f"{module}: error: {error}", file=sys.stderr)
        return 2
    seconds = time.perf_counter() - start
    names = {path.name: path for path in files}
    first = names.get("index.html", names["report.md"])
    print(f"{first}: {len(files)} files in {options.out} ({seconds:.0f} s)")
    return 0


def _made(options: argparse.Namespace, make: Make, experiments: Sequence[str]) -> list[Path]:
    from symo_exp.report.runs import load, read
    from symo_exp.report.write import write
    from symo_exp.tracking.store import find

    asked = {"systems": options.system, "seeds": options.seed}
    named, paths, store = options.experiment, options.runs, None
    told = options.tracking_uri or options.directory or os.environ.get("MLFLOW_TRACKING_URI")
    if not (paths or told or Path(STORE, "mlflow.db").exists()) and OUTPUTS.is_dir():
        paths, named = [OUTPUTS], named or experiments
    if paths:
        runs = load(paths, named, **asked)
    else:
        store, named = find(options.tracking_uri, options.directory or STORE), named or experiments
        runs = read(store, named, **asked)
    of = {"experiment": named, "saved runs": paths, **asked}
    source = "; ".join(f"{k} {', '.join(map(str, words))}" for k, words in of.items() if words)
    made = make(runs, f"From {source or 'all experiments'}.", store)
    try:
        return write(made, options.out, formats=options.formats, web=not options.no_page)
    except OSError as error:
        reason = error.strerror or error
        raise ConfigError(f"--out {options.out} cannot be written ({reason})") from error
