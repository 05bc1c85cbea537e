"""Accuracy, time and memory over the number of coordinates."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd

from symo_exp.report.cells import (
    DEFAULTS,
    at_step,
    cells,
    medians,
    settings_of,
    table_note,
    usual_steps,
)
from symo_exp.report.curves import Axis, panels, seeds_caption
from symo_exp.report.figures import Figure
from symo_exp.report.looks import number, pair_names
from symo_exp.report.tables import ResultTable
from symo_exp.words import counted

COORDINATES = Axis("coordinates", "coordinates", log=False, ticks=True)
OVER_N = (
    "test_relative", "valid_steps", "inertia_mse_aligned", "training_seconds", "step_ms",
    "peak_memory",
)  # fmt: skip
KEYS = ["system", "settings", "n_traj", "method", "integrator", "coordinates"]


def growth(runs: pd.DataFrame) -> tuple[list[ResultTable], list[Figure]]:
    """Return a table and a figure for each system run with several numbers of coordinates.

    Settings of the system are not compared; runs with the usual time step of a system are shown.
    """
    tables, figures = [], []
    for (system, settings, n_traj), rows in _grown(runs):
        told = f"{settings or DEFAULTS}, {counted(n_traj, 'trajectory')}"
        key = f"growth_{system}_{settings}_{number(n_traj)}"
        tables.append(_table(key, f"{system} over its coordinates ({told})", rows))
        figures.append(
            Figure(key, f"{system} over its coordinates ({told})", seeds_caption(rows),
                   panels(rows, COORDINATES, OVER_N))
        )  # fmt: skip
    return tables, figures


def _grown(runs: pd.DataFrame) -> Iterator[tuple[tuple[str, str, float], pd.DataFrame]]:
    counts = runs[runs.metric == "coordinates"].set_index("run_id").value
    learned = runs[(runs.source == "ours") & ~(runs.noise_std > 0)]
    found = cells(at_step(learned, usual_steps(learned)))
    of = runs.assign(coordinates=runs.run_id.map(counts)).dropna(subset="coordinates")
    of = of[["system", "variant", "coordinates"]].drop_duplicates(["system", "variant"])
    found = found.merge(of, on=["system", "variant"])
    own = [[x for x in settings_of(one) if not x.startswith("system.")] for one in found.variant]
    found = found.assign(settings=[", ".join(words) for words in own])
    for key, rows in found.groupby(["system", "settings", "n_traj"]):
        if rows.coordinates.nunique() > 1:
            yield key, rows


def _table(key: str, title: str, rows: pd.DataFrame) -> ResultTable:
    wide = medians(rows, KEYS, OVER_N).reset_index()
    seeds = rows.groupby(KEYS).seeds.max().astype(str)
    names = {"method": pair_names(wide), "coordinates": wide.coordinates.map(number)}
    shown = pd.DataFrame({**names, "seeds": seeds.to_numpy()}).join(wide.drop(columns=KEYS))
    notes = [table_note(rows)]
    steps = rows[(rows.metric == "step_ms") & (rows["median"] > 0)]
    for _, one in steps.groupby(["method", "integrator"]):
        if len(one) > 1:
            power = np.polyfit(np.log(one.coordinates), np.log(one["median"]), 1)[0]
            name = pair_names(one.head(1))[0]
            notes.append(f"{name}: the time of a step grows as n to the power {power:.2f}.")
    return ResultTable(key, title, shown, notes)
