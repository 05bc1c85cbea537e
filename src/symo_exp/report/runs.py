"""Runs as one tidy table: a row for each measure of each run.

What a run is, the same in all its rows; runs that differ in nothing but ``seed`` make a cell:

* ``variant``: its settings beyond the columns here, as recorded when it was made; ``""``: defaults;
* ``system``, ``time_step`` [s], ``method``, ``integrator``, ``n_traj``, ``noise_std``, ``seed``;
* ``optimizer``; ``run_id``, ``experiment``; ``status``: ``FINISHED`` and others, with ``reason``;
* ``started``: UTC; ``seconds``: processor time of training; ``revision`` of the source;
* ``files``: where the files of the run lie, a path or an address of MLflow; not saved.

Then ``metric`` and ``value``. A run without a measure has one row, with ``metric=""``. Of runs that
are the same there is one: the last that finished. ``source`` says how figures draw a row: ``ours``,
or ``floor`` for a true system in an integrator.

``read`` takes them from a tracking store, ``load`` from run folders and from the files that a
report saved. Another place to read from gives ``tidy`` its rows.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from symo_exp.errors import ConfigError
from symo_exp.report.looks import TRUE
from symo_exp.runs.folder import ABOUT, DIED, SERIES, RunFolder
from symo_exp.runs.series import EPOCH, TIME
from symo_exp.runs.series import read as read_series
from symo_exp.tracking.publish import REASON, STATUS
from symo_exp.tracking.store import Store, check, connect

PAGE = 1000
"""Runs in one request."""
LARGEST = 1.7e308
"""An SQL store keeps an infinite measure as the largest double."""
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
"""Column: the parameter of a run that it is read from."""
CELL = ["variant", "system", "time_step", "method", "integrator", "n_traj", "noise_std"]
"""What a cell of a table is: the runs that differ in nothing but the seed."""
KNOWN = ["run_id", "experiment", "status", "reason", "started", "seconds", "revision"]
SAVED = [*CELL, "seed", "optimizer", *KNOWN, "metric", "value"]
"""The columns of ``runs.csv`` and ``runs.parquet``."""
COLUMNS = [*SAVED, "files", "source"]
WHOLE = ["n_traj", "seed"]
NUMBERS = ["time_step", "noise_std", "seconds", "value", *WHOLE]

Row = tuple[Mapping[str, Any], Mapping[str, float]]
"""A run: what is known of it, by column, and its measures."""


def read_runs(
    store: Store,
    experiments: Sequence[str] = (),
    *,
    systems: Sequence[str] = (),
    seeds: Sequence[int] = (),
) -> pd.DataFrame:
    """The runs of the experiments in a store; without a name, of all.

    The requests are as many as there are thousands of runs, whatever the number of measures.
    """
    return _asked(tidy(_in_store(store, experiments)), (), systems, seeds)


def load_runs(
    paths: Sequence[Path],
    experiments: Sequence[str] = (),
    *,
    systems: Sequence[str] = (),
    seeds: Sequence[int] = (),
) -> pd.DataFrame:
    """The runs below the folders, and in the ``runs.csv`` and ``runs.parquet``, all together.

    Reports save no files of studies: their figures are not there again.
    """
    return _asked(pd.concat([_load(path) for path in paths]), experiments, systems, seeds)


def tidy(runs: Iterable[Row]) -> pd.DataFrame:
    """The table of runs; one that names no method or no system is none of ours."""
    rows = [
        {**about, "metric": metric, "value": value}
        for about, measures in runs if about["method"] and about["system"]
        for metric, value in _finished(about, measures).items()
    ]  # fmt: skip
    return _last_of_each(_typed(pd.DataFrame(rows, columns=COLUMNS[:-1])))


def save_runs(runs: pd.DataFrame, path: Path) -> Path:
    """Write a table for ``load``: CSV or Parquet by the name of the file."""
    kept = runs[SAVED].astype(dict.fromkeys(WHOLE, "Int64"))
    if path.suffix == ".parquet":
        kept.to_parquet(path, index=False)
    else:
        kept.to_csv(path, index=False)
    return path


def without_result(runs: pd.DataFrame) -> pd.DataFrame:
    """The runs that have not finished."""
    return runs[runs.status != "FINISHED"].drop_duplicates("run_id")


def _finished(about: Mapping[str, Any], measures: Mapping[str, float]) -> Mapping[str, float]:
    return measures if about["status"] == "FINISHED" and measures else {"": math.nan}


def _in_store(store: Store, experiments: Sequence[str]) -> Iterator[Row]:
    if store.database is not None and not store.database.exists():
        raise ConfigError(
            f"no tracking store at {store.database}: say which with --tracking-uri or --directory"
        )
    check(store, timeout=5.0)
    client = connect(store)
    there = {found.name: found.experiment_id for found in client.search_experiments()}
    _check_names(experiments, set(there) - {"Default"}, str(store))
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
                    # not from start to end: a run may have been cut and continued, or studied later
                    "seconds": metrics.get("training_seconds"), "files": info.artifact_uri,
                }, metrics  # fmt: skip
            token = page.token or None


def _in_folder(folder: RunFolder) -> Row | None:
    """The run of a folder, as the store would have it; a dead one has failed."""
    about, outcome = folder.about(), folder.outcome()
    if about is None:
        return None
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
    }, measures


def _parameters(told: Mapping[str, Any]) -> dict[str, Any]:
    preset = told.get("preset", "default")
    row = {column: told.get(name) for column, name in PARAMETERS.items()}
    return {"variant": told.get("variant", "" if preset == "default" else preset), **row}


def _load(path: Path) -> pd.DataFrame:
    if path.is_dir():
        found = (RunFolder(file.parent) for file in sorted(path.rglob(ABOUT)))
        rows = [row for folder in found if (row := _in_folder(folder)) is not None]
        if not rows:
            raise ConfigError(f"--runs {path} has no run in it, nor in a folder below")
        return tidy(rows)
    try:
        if path.suffix == ".parquet":
            table = pd.read_parquet(path)
        else:
            table = pd.read_csv(path, dtype=str, keep_default_na=False)
        absent = [column for column in SAVED if column not in table]
        typed = table if absent else _typed(table[SAVED].assign(files=""))
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error).partition("\n")[0]
        raise ConfigError(f"--runs {path} cannot be read ({reason})") from error
    if absent:
        raise ConfigError(
            f"--runs {path} has no column {absent[0]!r}: "
            "give the runs.csv or runs.parquet of a report"
        )
    return typed


def _typed(table: pd.DataFrame) -> pd.DataFrame:
    """Numbers, times and words, whatever the source has them as."""
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
    _check_names(experiments, set(runs.experiment), "the saved runs")
    for column, wanted in (("experiment", experiments), ("system", systems), ("seed", seeds)):
        if wanted:
            runs = runs[runs[column].isin(wanted)]
    return _last_of_each(runs)


def _last_of_each(runs: pd.DataFrame) -> pd.DataFrame:
    """Of runs that are the same, the one that finished and, of those, that started last."""
    each = runs.drop_duplicates("run_id")
    each = each.assign(done=each.status == "FINISHED").sort_values(["done", "started"])
    kept = each.drop_duplicates([*CELL, "seed"], keep="last").run_id
    runs = runs[runs.run_id.isin(kept)]
    return runs.drop_duplicates(["run_id", "metric"]).reset_index(drop=True)


def _check_names(asked: Sequence[str], there: set[str], where: str) -> None:
    if missing := [name for name in asked if name not in there]:
        have = ", ".join(sorted(there)) or "none"
        raise ConfigError(f"no experiment {missing[0]!r} in {where}; there are: {have}")
