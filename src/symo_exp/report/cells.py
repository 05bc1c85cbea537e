"""Cells: measures of runs that differ in the seed alone, summed up."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd

from symo_exp.report.runs import CELL

SUMMARY = ["seeds", "median", "low", "high", "seconds"]


def cells(runs: pd.DataFrame) -> pd.DataFrame:
    """A row for each cell and metric: how many ``seeds``, their ``median``, the ``low``est and
    ``high``est value, and the median ``seconds`` that a run trained."""
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


def main_variant(rows: pd.DataFrame) -> str:
    """The variant that figures show: the defaults if there are any, else the most frequent."""
    variants = rows[rows.source == "ours"].variant.value_counts()
    return "" if "" in variants or variants.empty else str(variants.idxmax())


def usual_steps(rows: pd.DataFrame) -> dict[str, float]:
    """The time step of each system: the one that most of its learned runs have, or of all."""
    learned = rows[rows.source == "ours"].dropna(subset="time_step")
    others = rows[~rows.system.isin(learned.system)].dropna(subset="time_step")
    steps = pd.concat([learned, others]).groupby("system").time_step
    return {str(system): float(values.mode().iloc[-1]) for system, values in steps}


def at_step(rows: pd.DataFrame, steps: Mapping[str, float]) -> pd.DataFrame:
    """The rows of runs with the given time step; of a system without one, all."""
    usual = rows.system.map(steps).fillna(rows.time_step).astype(float)
    return rows[np.isclose(rows.time_step.astype(float), usual, equal_nan=True)]


def _median(values: pd.Series) -> float:
    """With infinite values too; pandas' own turns a pair of them into NaN."""
    ordered = np.sort(values.to_numpy(dtype=float))  # NaN last, as if worst
    low, high = ordered[(len(ordered) - 1) // 2], ordered[len(ordered) // 2]
    return float(low if low == high else 0.5 * (low + high))
