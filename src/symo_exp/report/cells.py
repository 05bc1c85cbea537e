"""Cells: measures of runs that differ only in the seed, summarised; and which of them to show."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd

from symo_exp.errors import ConfigError
from symo_exp.report.looks import all_angles, measure_name, short
from symo_exp.report.runs import CELL

SUMMARY = ["seeds", "median", "low", "high", "seconds"]
DEFAULTS = "defaults"
"""Printed name of the settings of runs that change none."""


class Compared(NamedTuple):
    """Settings of the runs that an answer compares.

    Args:
        variant: The settings in which methods are compared.
        rivals: The settings that are compared where there is one method only.
    """

    variant: str
    rivals: tuple[str, ...] = ()


def cells(runs: pd.DataFrame) -> pd.DataFrame:
    """Return a row for each cell and metric.

    Its columns beside those of the cell are ``seeds`` (their number), ``median``, ``low`` and
    ``high`` of the measure over them, and the median ``seconds`` of training.
    """
    keys = [*CELL, "source", "metric"]
    measured = runs[runs.metric != ""]
    if measured.empty:
        return pd.DataFrame(columns=[*keys, *SUMMARY])
    found = measured.groupby(keys, dropna=False).agg(
        seeds=("seed", "nunique"),
        median=("value", _median),
        low=("value", "min"),
        high=("value", "max"),
        seconds=("seconds", "median"),
    )
    return found.reset_index()


def medians(found: pd.DataFrame, keys: Sequence[str], metrics: Iterable[str]) -> pd.DataFrame:
    """Return cells with a column of printed medians for each measure that there is."""
    wide = found.groupby([*keys, "metric"], dropna=False)["median"].median().unstack()
    there = wide.reindex(columns=[name for name in metrics if name in wide])
    angular = all_angles(found.metric, found["median"])
    return there.map(short).rename(columns=lambda name: measure_name(name, angular))


def over_seeds(most: float, several: str = "Medians over the seeds") -> str:
    """Return how values are summarised, where no cell has more than ``most`` seeds."""
    return several if most > 1 else "One seed"


def table_note(found: pd.DataFrame) -> str:
    """Return the note below a table of cells."""
    return f"{over_seeds(found.seeds.max())}. Training: processor time of all optimiser steps."


def last_compared(runs: pd.DataFrame, settings: str | None) -> Compared:
    """Return the settings asked for or those of the last sweep, without any sweep of the last run.

    Sweeps without a finished run are passed over.

    Raises:
        ConfigError: No run has the settings asked for.
    """
    learned = runs[runs.source == "ours"]
    if settings is not None:
        variant = "" if settings == DEFAULTS else settings
        if variant not in set(learned.variant):
            have = "; ".join(sorted({one or DEFAULTS for one in learned.variant})) or "none"
            raise ConfigError(f"--settings {settings}: no run has these; there are: {have}")
        return Compared(variant)
    learned = learned[learned.metric != ""]
    if learned.empty:
        return Compared("")
    swept = learned[learned.sweep != ""]
    last, column = (learned, "run_id") if swept.empty else (swept, "sweep")
    started = last.started.fillna(pd.Timestamp(0, tz="UTC"))
    last = last[last[column] == last[column][started.idxmax()]]
    return Compared(str(last.variant.value_counts().idxmax()), tuple(sorted(set(last.variant))))


def settings_of(variant: str) -> list[str]:
    """Return the settings that a variant lists; values may have commas."""
    return re.split(r", (?=[\w./]+=)", variant)


def usual_steps(rows: pd.DataFrame) -> dict[str, float]:
    """Return the time step of each system that most of its learned runs have, or all its runs."""
    learned = rows[rows.source == "ours"].dropna(subset="time_step")
    others = rows[~rows.system.isin(learned.system)].dropna(subset="time_step")
    steps = pd.concat([learned, others]).groupby("system").time_step
    return {str(system): float(values.mode().iloc[-1]) for system, values in steps}


def at_step(rows: pd.DataFrame, steps: Mapping[str, float]) -> pd.DataFrame:
    """Return the rows with the time step given for their system, or all rows of other systems."""
    usual = rows.system.map(steps).fillna(rows.time_step).astype(float)
    return rows[np.isclose(rows.time_step.astype(float), usual, equal_nan=True)]


def _median(values: pd.Series) -> float:
    """Return the median; pandas' own of two infinite values is NaN."""
    ordered = np.sort(values.to_numpy(dtype=float))  # NaN last, as the worst
    low, high = ordered[(len(ordered) - 1) // 2], ordered[len(ordered) // 2]
    return float(low if low == high else 0.5 * (low + high))
