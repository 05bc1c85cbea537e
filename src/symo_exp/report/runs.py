"""Runs as one tidy table: a row for each measure of each run.

Columns that describe the run, equal in all its rows; runs that differ only in ``seed`` form a cell:

* ``variant``: settings other than the columns below, as recorded by the run; ``""`` for defaults;
* ``system``, ``time_step`` [s], ``method``, ``integrator``, ``n_traj``, ``noise_std``, ``seed``;
* ``optimizer``; ``run_id``; ``experiment``; ``sweep``: identity of the sweep, ``""`` for one run;
* ``recording``: the files of a run on recordings, otherwise ``""``;
* ``status``: ``FINISHED`` and others, with ``reason``; ``started``: UTC; ``seconds``: processor
  time of training; ``revision`` of the source;
* ``files``: path or MLflow address of the files of the run; not saved.

``metric`` and ``value`` follow. A run without measures has one row with ``metric=""``. Of equal
runs, the table has the last one that finished. ``source`` is ``floor`` for a true system in an
integrator, otherwise ``ours``.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

import pandas as pd

from symo_exp.errors import ConfigError, first_line
from symo_exp.files import write_frame
from symo_exp.report.looks import TRUE
from symo_exp.runs.folder import ABOUT, DIED, MEASURES, SERIES, RunFolder
from symo_exp.runs.series import EPOCH, TIME
from symo_exp.runs.series import read as read_series
from symo_exp.tracking.publish import PARENT, REASON, STATUS
from symo_exp.tracking.store import Store, connect_existing

log = logging.getLogger(__name__)

PAGE = 1000
"""Number of runs in one request."""
LARGEST = 1.7e308
"""SQL stores keep an infinite measure as the largest double."""
REVISION = "mlflow.source.git.commit"
PARAMETERS = {
    "system": "system",
    "time_step": "system.time_step",
    "method": "model",
    "integrator": "integrator",
    "n_traj": "data.n_traj",
    "noise_std": "data.noise_std",
    "seed": "seed",
    "optimizer": "optimizer",
}
"""The parameter of a run that each column is read from."""
CELL = ["variant", "system", "time_step", "method", "integrator", "n_traj", "noise_std"]
"""Columns that are equal in all runs of a cell."""
KNOWN = ["run_id", "experiment", "status", "reason", "started", "seconds", "revision"]
LATER = ["sweep", "recording"]
"""Columns that files of earlier versions do not have."""
SAVED = [*CELL, "seed", "optimizer", *KNOWN, *LATER, "metric", "value"]
"""The columns of ``runs.csv`` and ``runs.parquet``."""
COLUMNS = [*SAVED, "files", "source"]
WHOLE = ["n_traj", "seed"]
NUMBERS = ["time_step", "noise_std", "seconds", "value", *WHOLE]

DAMAGED = OSError, ValueError, TypeError, KeyError, AttributeError
"""Errors in reading files that hold something else than a run writes."""

Row = tuple[Mapping[str, Any], Mapping[str, float]]
"""A run: its columns and its measures."""


def load_runs(
    source: Store | Sequence[Path],
    experiments: Sequence[str] = (),
    *,
    systems: Sequence[str] = (),
    seeds: Sequence[int] = (),
) -> pd.DataFrame:
    """Return the runs of a tracking store, or those of folders and saved tables together.

    One request to a store reads a thousand runs with all their measures. Saved tables have no files
    of studies, so that their figures are missing.

    Args:
        source: A store, or folders of runs and ``runs.csv`` and ``runs.parquet`` of reports.
        experiments: Names of experiments; all if empty.
        systems: Names of systems; all if empty.
        seeds: Seeds; all if empty.

    Raises:
        ConfigError: The source cannot be read or has no run, or no run has a name that is asked
            for.
    """
    if isinstance(source, Store):
        try:
            stored = list(_in_store(source, experiments))
        except ConfigError:
            raise
        except Exception as error:  # of MLflow or of the database
            told = f"tracking store {source} cannot be read: {first_line(error)}"
            raise ConfigError(f"{told}; give folders of runs, such as outputs/NAME") from error
        return _asked(tidy(stored), (), systems, seeds)
    found = [_load_folders(path) if path.is_dir() else _load_table(path) for path in source]
    return _asked(pd.concat(found), experiments, systems, seeds)


def tidy(runs: Iterable[Row]) -> pd.DataFrame:
    """Return the table of runs, without those of other projects (no method or no system)."""
    rows = []
    for about, measures in runs:
        if about["method"] and about["system"]:
            found = measures if about["status"] == "FINISHED" else {}
            values = (found or {"": math.nan}).items()
            rows += [{**about, "metric": metric, "value": value} for metric, value in values]
    return _last_of_each(_typed(pd.DataFrame(rows, columns=COLUMNS[:-1])))


def save_runs(runs: pd.DataFrame, path: Path) -> Path:
    """Write a table for ``load_runs``, as CSV or Parquet by the suffix of ``path``."""
    write_frame(path, runs[SAVED].astype(dict.fromkeys(WHOLE, "Int64")))
    return path


def without_result(runs: pd.DataFrame) -> pd.DataFrame:
    """Return a row for each run that has not finished."""
    return runs[runs.status != "FINISHED"].drop_duplicates("run_id")


def local_folder(files: str) -> Path | None:
    """Return the folder of a run's files, ``None`` if it is not on this computer."""
    parts = urlsplit(files)
    if parts.scheme not in ("", "file") or not files:
        return None
    return Path(unquote(parts.path) if parts.scheme else files)


def _in_store(store: Store, experiments: Sequence[str]) -> Iterator[Row]:
    client = connect_existing(store, "choose one with --tracking-uri or --directory")
    there = {found.name: found.experiment_id for found in client.search_experiments()}
    _check_names("experiment", experiments, set(there) - {"Default"}, str(store))
    for name in experiments or sorted(there):
        token: str | None = ""
        while token is not None:
            page = client.search_runs([there[name]], max_results=PAGE, page_token=token or None)
            for run in page:
                info, tags, metrics = run.info, run.data.tags, run.data.metrics
                yield _parameters(run.data.params) | {
                    "run_id": info.run_id, "experiment": name, "status": info.status,
                    "reason": tags.get(REASON), "revision": tags.get(REVISION),
                    "started": pd.Timestamp(info.start_time, unit="ms", tz="UTC"),
                    # not the time from start to end: a run may have been resumed
                    "seconds": metrics.get("training_seconds"), "files": info.artifact_uri,
                    "sweep": tags.get(PARENT),
                }, metrics  # fmt: skip
            token = page.token or None


def _in_folder(folder: RunFolder) -> Row:
    """Return the run of a folder as a store would; a killed run has failed."""
    about, outcome = folder.about(), folder.outcome()
    if about is None:
        raise ValueError(f"{ABOUT} does not describe a run")
    if folder.has_damaged_measures():
        raise ValueError(
            f"{MEASURES} holds no measures; the command of the run computes them again"
        )
    died = folder.died()
    numbers = {k: v for row in read_series(folder / SERIES) for k, v in row.items()}
    measures = {k: v for k, v in numbers.items() if k not in (EPOCH, TIME)} | folder.measures()
    return _parameters({**about.parameters, "variant": about.variant}) | {
        "run_id": about.identity,
        "experiment": about.parameters.get("experiment", folder.path.parent.name),
        "status": STATUS["failed" if died else outcome.status],
        "reason": DIED if died else outcome.reason,
        "revision": about.tags.get(REVISION),
        "started": pd.Timestamp(about.started, unit="s", tz="UTC"),
        "seconds": measures.get("training_seconds"),
        "files": str(folder.path),
        "sweep": about.sweep,
    }, measures


def _parameters(told: Mapping[str, Any]) -> dict[str, Any]:
    preset = told.get("preset", "default")
    row = {column: told.get(name) for column, name in PARAMETERS.items()}
    return {
        "variant": told.get("variant", "" if preset == "default" else preset),
        "recording": told.get("data.path"),
        **row,
    }


def _load_folders(path: Path) -> pd.DataFrame:
    rows = []
    for file in sorted(path.rglob(ABOUT)):
        folder = RunFolder(file.parent)
        try:
            rows.append(_in_folder(folder))
        except DAMAGED as error:
            told = "%s is left out, since one of its files is damaged: %s"
            log.warning(told, folder, first_line(error))
    if not rows:
        raise ConfigError(f"{path} has no run in it, nor in a folder below")
    return tidy(rows)


def run_table(file: Path) -> pd.DataFrame | None:
    """Return a table of a run, nothing if it is not there or, as is logged, damaged."""
    try:
        return pd.read_parquet(file) if file.exists() else None
    except DAMAGED as error:
        log.warning("%s is left out, since it is damaged: %s", file, first_line(error))
        return None


def _load_table(path: Path) -> pd.DataFrame:
    try:
        if path.suffix == ".parquet":
            table = pd.read_parquet(path)
        else:
            table = pd.read_csv(path, dtype=str, keep_default_na=False)
        absent = [name for name in SAVED if name not in table and name not in LATER]
        if not absent:
            if "sweep" not in table:  # all runs of an experiment count as one sweep
                table = table.assign(sweep=table.experiment, recording="")
            return _typed(table[SAVED].assign(files=""))
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or first_line(error)
        raise ConfigError(f"{path} cannot be read ({reason})") from error
    raise ConfigError(
        f"{path} has no column {absent[0]!r}: give the runs.csv or runs.parquet of a report"
    )


def _typed(table: pd.DataFrame) -> pd.DataFrame:
    """Convert the columns to numbers, times and text."""
    table = table.replace({"None": None, "null": None})
    table[NUMBERS] = table[NUMBERS].apply(pd.to_numeric).astype(float)
    infinite = table.value.abs() > LARGEST
    table["value"] = table.value.mask(infinite, table.value * math.inf)
    table["started"] = pd.to_datetime(table.started, utc=True, format="ISO8601")
    words = [str(column) for column in table if column not in (*NUMBERS, "started")]
    table[words] = table[words].fillna("").astype(str)
    return table.assign(source=table.method.isin(TRUE).map({True: "floor", False: "ours"}))


def _asked(
    runs: pd.DataFrame, experiments: Sequence[str], systems: Sequence[str], seeds: Sequence[int]
) -> pd.DataFrame:
    for column, wanted in (("experiment", experiments), ("system", systems), ("seed", seeds)):
        if wanted:
            there = {f"{x:g}" if column == "seed" else x for x in runs[column].dropna()}
            runs = runs[runs[column].isin(wanted)]
            if column != "seed" or runs.empty:  # not every system need have every seed
                _check_names(column, list(map(str, wanted)), there, "these runs")
    return _last_of_each(runs)


def _last_of_each(runs: pd.DataFrame) -> pd.DataFrame:
    """Keep of equal runs the finished one that started last."""
    each = runs.drop_duplicates("run_id")
    each = each.assign(done=each.status == "FINISHED").sort_values(["done", "started"])
    kept = each.drop_duplicates([*CELL, "seed"], keep="last").run_id
    runs = runs[runs.run_id.isin(kept)]
    return runs.drop_duplicates(["run_id", "metric"]).reset_index(drop=True)


def _check_names(kind: str, asked: Sequence[str], there: set[str], where: str) -> None:
    if missing := [name for name in asked if name not in there]:
        have = ", ".join(sorted(there)) or "none"
        raise ConfigError(f"no {kind} {missing[0]!r} in {where}; there are: {have}")
