"""The runs of a tracking store as tables: one row for each run, one for each of its measures."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import pandas as pd

from symo_exp.errors import ConfigError
from symo_exp.report.variant import variant
from symo_exp.tracking.runs import REASON
from symo_exp.tracking.store import Store, check, connect

if TYPE_CHECKING:
    from mlflow.entities import Run

PAGE = 1000
"""Runs in one request."""
LARGEST = 1.7e308
"""An SQL store keeps an infinite measure as the largest double."""
AXES = {
    "system": "system",
    "time_step": "system.time_step",
    "method": "model",
    "integrator": "integrator",
    "n_traj": "data.n_traj",
    "noise_std": "data.noise_std",
    "seed": "seed",
}
"""Column: the parameter of the run behind it."""
NUMBERS = {"time_step": float, "n_traj": int, "noise_std": float, "seed": int}
CELL = ["variant", *(axis for axis in AXES if axis != "seed")]
"""What a cell of a table is: the runs that differ in nothing but the seed."""
ABOUT = ["run_id", "experiment", "status", "reason", "started", "seconds", "revision", "files"]
COLUMNS = [*CELL, "seed", "optimizer", *ABOUT]


class Runs(NamedTuple):
    """``table`` has a row for each run (``COLUMNS``), ``measures`` a row for each measure of each
    finished run: the same columns, then ``metric`` and ``value``."""

    table: pd.DataFrame
    measures: pd.DataFrame


def read(
    store: Store,
    experiments: Sequence[str],
    *,
    systems: Sequence[str] = (),
    seeds: Sequence[int] = (),
) -> Runs:
    """All runs of the experiments; of those that finished twice the same, the last.

    The requests are as many as there are thousands of runs, whatever the number of measures.
    """
    rows, values = [], []
    for run, experiment in _found(store, experiments):
        row = _row(run, experiment)
        if row is None or (systems and row["system"] not in systems):
            continue
        if seeds and row["seed"] not in seeds:
            continue
        rows.append(row)
        values.append(run.data.metrics)
    table = pd.DataFrame(rows, columns=COLUMNS)
    done = last_of_each(table[table.status == "FINISHED"])
    long = [
        {**row, "metric": name, "value": _number(value)}
        for row, index in zip(done.to_dict("records"), done.index, strict=True)
        for name, value in values[index].items()
    ]
    return Runs(table, pd.DataFrame(long, columns=[*COLUMNS, "metric", "value"]))


def last_of_each(runs: pd.DataFrame) -> pd.DataFrame:
    """Of runs that are the same, the one that started last."""
    ordered = runs.sort_values("started", kind="stable")
    return ordered.drop_duplicates([*CELL, "seed"], keep="last")


def _found(store: Store, experiments: Sequence[str]) -> Iterator[tuple[Run, str]]:
    if store.database is not None and not store.database.exists():
        raise ConfigError(
            f"no tracking store at {store.database}: say which with --tracking-uri or --directory"
        )
    check(store, timeout=5.0)
    client = connect(store)
    there = {found.name: found.experiment_id for found in client.search_experiments()}
    for name in experiments:
        if name not in there:
            others = ", ".join(sorted(set(there) - {"Default"})) or "none"
            raise ConfigError(f"no experiment {name!r} in {store}; it has: {others}")
        token = None
        while True:
            page = client.search_runs([there[name]], max_results=PAGE, page_token=token)
            yield from ((run, name) for run in page)
            token = page.token
            if not token:
                break


def _row(run: Run, experiment: str) -> dict[str, Any] | None:
    """What a run is; nothing for one that is none of ours, such as the parent of a sweep."""
    parameters: Mapping[str, str] = run.data.params
    if not {"model", "system", "seed"} <= set(parameters):
        return None
    row: dict[str, Any] = {axis: parameters.get(name) for axis, name in AXES.items()}
    for axis, kind in NUMBERS.items():
        row[axis] = None if row[axis] in (None, "None") else kind(row[axis])
    info, tags = run.info, run.data.tags
    # not from start to end: a run may have been cut and continued, or studied much later
    seconds = run.data.metrics.get("training_seconds", math.nan)
    return row | {
        "variant": variant(parameters),
        "optimizer": parameters.get("optimizer", ""),
        "run_id": info.run_id,
        "experiment": experiment,
        "status": info.status,
        "reason": tags.get(REASON, ""),
        "started": pd.Timestamp(info.start_time, unit="ms", tz="UTC"),
        "seconds": seconds,
        "revision": tags.get("mlflow.source.git.commit", ""),
        "files": info.artifact_uri,
    }


def _number(value: float) -> float:
    return math.copysign(math.inf, value) if abs(value) > LARGEST else value
