"""The tables that studies left among the files of runs, one run for each method."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple
from urllib.parse import unquote, urlsplit

import pandas as pd

from symo_exp.report.labels import Pair, in_order
from symo_exp.tracking.artifacts import STUDIES
from symo_exp.tracking.store import Store, connect


class Studied(NamedTuple):
    """``tables`` hold the numbers of one study, by what ran it, in order."""

    study: str
    system: str
    time_step: float
    seed: int
    tables: dict[Pair, pd.DataFrame]


def studied(store: Store, measures: pd.DataFrame, names: Iterable[str]) -> list[Studied]:
    """The studies of the given runs, of which each method has one a system: the lowest seed.

    Only runs whose measures tell of a study are asked for its file.
    """
    found = []
    for name in names:
        of_study = measures[measures.metric.str.startswith(f"{name}_")]
        runs = of_study.drop_duplicates("run_id").sort_values("seed", kind="stable")
        for (system, time_step), here in runs.groupby(["system", "time_step"]):
            seed = int(here.seed.min())
            tables = {}
            for row in here[here.seed == seed].to_dict("records"):
                table = _read(store, row["run_id"], row["files"], f"{STUDIES}/{name}.parquet")
                if table is not None:
                    tables[(row["method"], row["integrator"])] = table
            ordered = dict(sorted(tables.items(), key=lambda item: in_order(item[0])))
            if ordered:
                found.append(Studied(name, str(system), float(time_step), seed, ordered))
    return found


def _read(store: Store, run_id: str, files: str, name: str) -> pd.DataFrame | None:
    """From where the files lie, if this machine can reach it, else through the store."""
    parts = urlsplit(files)
    if parts.scheme in ("", "file"):
        path = Path(unquote(parts.path)) / name
        return pd.read_parquet(path) if path.exists() else None
    with tempfile.TemporaryDirectory(prefix="symo_exp-") as copy:
        try:
            return pd.read_parquet(connect(store).download_artifacts(run_id, name, copy))
        except Exception:  # gone, or away: the figure does without
            return None
