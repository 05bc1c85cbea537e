"""The runs that an earlier report saved, in place of a tracking store."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from symo_exp.errors import ConfigError
from symo_exp.report.runs import COLUMNS, NUMBERS, Runs, last_of_each

SAVED = [*(column for column in COLUMNS if column != "files"), "metric", "value"]
"""The columns of ``runs.csv`` and ``runs.parquet``."""
VALUES = ["value", "seconds", *NUMBERS]
TEXTS = [column for column in SAVED if column not in (*VALUES, "started")]


def load(
    paths: Sequence[Path],
    experiments: Sequence[str] = (),
    *,
    systems: Sequence[str] = (),
    seeds: Sequence[int] = (),
) -> Runs:
    """The finished runs in all ``paths`` together; of those that are the same, the last.

    A report saves no run without a result, and no files of studies: neither is there again.
    """
    measures = pd.concat([_load(path) for path in paths], ignore_index=True)
    if missing := [name for name in experiments if name not in set(measures.experiment)]:
        there = ", ".join(sorted(set(measures.experiment))) or "none"
        raise ConfigError(f"no experiment {missing[0]!r} in the saved runs; they have: {there}")
    for column, wanted in (("experiment", experiments), ("system", systems), ("seed", seeds)):
        if wanted:
            measures = measures[measures[column].isin(wanted)]
    runs = measures.drop_duplicates("run_id")
    kept = measures[measures.run_id.isin(last_of_each(runs).run_id)]
    kept = kept.drop_duplicates(["run_id", "metric"]).reset_index(drop=True)
    return Runs(runs[COLUMNS].reset_index(drop=True), kept)


def _load(path: Path) -> pd.DataFrame:
    try:
        if path.suffix == ".parquet":
            table = pd.read_parquet(path)
        else:
            table = pd.read_csv(path, dtype=dict.fromkeys(TEXTS, str), low_memory=False)
        absent = [column for column in SAVED if column not in table]
        typed = table if absent else _typed(table)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error).partition("\n")[0]
        raise ConfigError(f"--runs {path} cannot be read ({reason})") from error
    if absent:
        raise ConfigError(
            f"--runs {path} has no column {absent[0]!r}: "
            "give the runs.csv or runs.parquet of a report"
        )
    return typed.assign(files="")[[*COLUMNS, "metric", "value"]]


def _typed(table: pd.DataFrame) -> pd.DataFrame:
    """What CSV does not keep: empty words, numbers, times."""
    table = table[SAVED].fillna(dict.fromkeys(TEXTS, ""))
    table[VALUES] = table[VALUES].apply(pd.to_numeric)
    table["started"] = pd.to_datetime(table.started, utc=True, format="ISO8601")
    return table
