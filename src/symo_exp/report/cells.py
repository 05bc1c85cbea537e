"""Cells: measures of runs that differ in the seed alone, summed up, beside the published."""

from __future__ import annotations

import numpy as np
import pandas as pd

from symo_exp.report import published
from symo_exp.report.runs import CELL
from symo_exp.report.style import TRUE

SUMMARY = ["seeds", "median", "low", "high", "seconds"]


def cells(measures: pd.DataFrame) -> pd.DataFrame:
    """A row for each cell and metric: how many ``seeds``, their ``median``, the ``low``est and
    ``high``est value, and the median ``seconds`` that a run trained."""
    if measures.empty:
        return pd.DataFrame(columns=[*CELL, "metric", *SUMMARY])
    grouped = measures.groupby([*CELL, "metric"], sort=True)
    found = grouped.agg(
        seeds=("seed", "nunique"),
        median=("value", _median),
        low=("value", "min"),
        high=("value", "max"),
        seconds=("seconds", "median"),
    )
    return found.reset_index()


def beside_published(found: pd.DataFrame) -> pd.DataFrame:
    """A row for each published number: with ours, where that cell has been run.

    ``like`` names our measure that averages over the same, ``alike`` is its median and ``factor``
    is ``alike`` over the published value.
    """
    theirs = published.published().rename(columns={"value": "published", "std": "published_std"})
    theirs = theirs.assign(
        like=[published.like(*pair) for pair in zip(theirs.metric, theirs.over, strict=True)]
    )
    keys = published.CELL
    ours = found[["variant", *keys, "metric", *SUMMARY]]
    merged = theirs.merge(ours, on=[*keys, "metric"], how="left")
    alike = found[["variant", *keys, "metric", "median"]]
    alike = alike.rename(columns={"metric": "like", "median": "alike"})
    merged = merged.merge(alike, on=["variant", *keys, "like"], how="left")
    factor = merged.alike / merged.published
    pairs = zip(merged.metric, merged.over, strict=True)
    note = pd.Series([published.note(*pair) for pair in pairs], index=merged.index, dtype=object)
    noisy = (merged.metric == "test_mse") & (merged.noise_std > 0)
    return merged.assign(factor=factor, note=note.where(~noisy, note + "; " + published.NOISY))


def main_variant(found: pd.DataFrame) -> str:
    """The variant that figures show: the defaults if there are any, else the most frequent."""
    variants = found[~found.method.isin(TRUE)].variant.value_counts()
    return "" if "" in variants or variants.empty else str(variants.idxmax())


def _median(values: pd.Series) -> float:
    """With infinite values too; pandas' own turns a pair of them into NaN."""
    ordered = np.sort(values.to_numpy(dtype=float))  # NaN last, as if worst
    low, high = ordered[(len(ordered) - 1) // 2], ordered[len(ordered) // 2]
    return float(low if low == high else 0.5 * (low + high))
