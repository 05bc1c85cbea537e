"""A run in one line."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from itertools import chain

from symo_exp.report.looks import all_angles, duration, label_and_unit, written
from symo_exp.runs.folder import PARAMETERS, RunFolder

MEASURES = {
    "train_mse": "train", "test_mse": "test", "integration_mse": "integration",
    "energy_mse": "energy", "inertia_mse": "inertia",
    "rmse_2s": "to 2 s",  # of runs on recordings
}  # fmt: skip
"""The measures that a table shows, and their columns; the others are in the files of the run."""
UNITS = {
    "test_mse": "MSE in", "energy_mse": "energy in", "inertia_mse": "inertia in",
    "rmse_2s": "to 2 s: RMSE in",
}  # fmt: skip
"""The beginning of words on the unit of measures."""
SHORT = "test_mse", "integration_mse", "rmse_2s"
"""The measures in the line of a run."""
ROWS = 40
"""Physical parameters that are shown."""


def run_line(folder: RunFolder) -> str:
    """Return one line about a run that has ended, its folder last."""
    about, outcome, measures = folder.about(), folder.outcome(), folder.measures()
    told = [f"{MEASURES[name]} {written(measures[name])}" for name in SHORT if name in measures]
    if outcome.status != "finished":
        told = [f"{outcome.status}: {outcome.reason}"]
    name = about.name if about else folder.path.name
    return "  ".join([name, *told, duration(outcome.seconds), str(folder)])


def units_of(shown: Collection[str], found: Sequence[Mapping[str, float]]) -> list[str]:
    """Return the units of the measures that a table shows, with the measures of its runs."""
    angular = all_angles(chain(*found), chain(*(measures.values() for measures in found)))
    units = {name: label_and_unit(name, angular)[1] for name in UNITS if name in shown}
    return [f"{UNITS[name]} {unit}" for name, unit in units.items()]


def parameter_lines(folder: RunFolder) -> list[str]:
    """Return the physical parameters of a run, a line each, the first ``ROWS`` of them."""
    rows = folder.parameters()
    width = max((len(row["name"]) for row in rows), default=0)
    lines = []
    for row in rows[:ROWS]:
        value, deviation = float(row["value"]), float(row["standard_deviation"])
        size = "" if math.isnan(deviation) else f" +- {deviation:.2g}"
        unit = "" if row["unit"] == "1" else f" {row['unit']}"
        note = f" ({row['note']})" if row["note"] and row["determined"] != "yes" else ""
        lines.append(f"{row['name']:{width}}  {value:.5g}{size}{unit}{note}")
    if len(rows) > ROWS:
        lines.append(f"and {len(rows) - ROWS} more: {folder / PARAMETERS}")
    return lines


def brief(label: str) -> str:
    """``node n=8 seed=1`` for ``model=node data.n_traj=8 seed=1``."""
    named = {"model": "", "system": "", "integrator": "", "data.n_traj": "n="}
    words = []
    for word in label.split():
        key, equals, value = word.partition("=")
        told = named.get(key, key.rpartition(".")[2] + equals) + value
        words.append(told if equals else word)  # also a part of a value with blanks
    return " ".join(words)
