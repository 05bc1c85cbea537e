"""Which method is better: ranks and claims, with intervals from resampling.

A block is what methods can be compared in without comparing anything else: one system, one size
of the training set, one noise, one seed. Resampling draws blocks with replacement.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pandas as pd

from symo_exp.report.labels import Pair, in_order

BLOCK = ["system", "n_traj", "noise_std", "seed"]
DRAWS = 2000
LEVEL = 0.95


class Interval(NamedTuple):
    low: float
    high: float


def wide(measures: pd.DataFrame, metric: str) -> pd.DataFrame:
    """A row for each block, a column for each pair of method and integrator."""
    pair = ["method", "integrator"]
    rows = measures[measures.metric == metric].drop_duplicates([*BLOCK, *pair], keep="last")
    table = rows.set_index([*BLOCK, *pair])["value"].unstack(pair)
    return table[sorted(table.columns, key=in_order)]


def ranking(measures: pd.DataFrame, metric: str) -> pd.DataFrame:
    """Mean rank of each pair (1 is best, a small error) over the blocks in which all were run.

    Columns ``method``, ``integrator``, ``rank``, ``low``, ``high`` (interval of the mean rank),
    ``best`` (share of the blocks it wins) and ``blocks``. Diverged runs share the last place.
    """
    table = wide(measures, metric).dropna()
    ranks = table.rank(axis=1, method="average").to_numpy()
    count = len(ranks)
    rows = []
    means = _resampled(ranks) if count else np.empty((0, ranks.shape[1]))
    for column, (method, integrator) in enumerate(table.columns):
        if not count:
            break
        interval = _interval(means[:, column])
        best = float((ranks[:, column] == ranks.min(axis=1)).mean())
        mean = float(ranks[:, column].mean())
        rows.append((method, integrator, mean, *interval, best, count))
    names = ["method", "integrator", "rank", "low", "high", "best", "blocks"]
    return pd.DataFrame(rows, columns=names).sort_values("rank", kind="stable", ignore_index=True)


def margin(
    table: pd.DataFrame, lower: list[Pair], higher: list[Pair], higher_in: pd.DataFrame
) -> tuple[float, Interval, int]:
    """By how much the worst of ``lower`` lies below the best of ``higher``, in powers of ten.

    Of the medians over the seeds that have all of them; the interval is from resampling seeds.
    ``table`` and ``higher_in`` have a row for each seed. NaN where a pair has not been run.
    """
    if not set(lower) <= set(table.columns) or not set(higher) <= set(higher_in.columns):
        return math.nan, Interval(math.nan, math.nan), 0
    small, large = table[lower].dropna(), higher_in[higher].dropna()
    seeds = small.index.intersection(large.index)
    if seeds.empty:
        return math.nan, Interval(math.nan, math.nan), 0
    small_, large_ = (_logarithms(part.loc[seeds]) for part in (small, large))

    def below(rows: np.ndarray) -> np.ndarray:
        """For each row of seed numbers."""
        worst = np.median(small_[rows], axis=1).max(axis=1)
        return np.median(large_[rows], axis=1).min(axis=1) - worst

    every = np.arange(len(seeds))[None]
    draws = np.random.default_rng(0).integers(0, len(seeds), (DRAWS, len(seeds)))
    return float(below(every)[0]), _interval(below(draws)), len(seeds)


def _resampled(ranks: np.ndarray) -> np.ndarray:
    generator = np.random.default_rng(0)
    drawn = generator.integers(0, len(ranks), (DRAWS, len(ranks)))
    return ranks[drawn].mean(axis=1)


def _interval(values: np.ndarray) -> Interval:
    tail = (1 - LEVEL) / 2
    low, high = np.quantile(values, [tail, 1 - tail])
    return Interval(float(low), float(high))


def _logarithms(values: pd.DataFrame) -> np.ndarray:
    """Bounded: two methods that diverge are equally bad, and differ by no NaN."""
    return np.log10(values.to_numpy(dtype=float).clip(1e-300, 1e30))
