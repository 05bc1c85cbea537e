"""Margins between methods, with intervals from resampling.

Methods are compared within a block: one system, one size of the training set, one noise, one seed.
Resampling draws seeds with replacement.
"""

from __future__ import annotations

import math

import numpy as np
import pandas as pd

from symo_exp.report.looks import Pair, in_order

BLOCK = ["system", "n_traj", "noise_std", "seed"]
PAIR = ["method", "integrator"]
DRAWS = 2000
LEVEL = 0.95


def wide(runs: pd.DataFrame, metric: str) -> pd.DataFrame:
    """Return a row for each block, a column for each pair of method and integrator."""
    rows = runs[runs.metric == metric].drop_duplicates([*BLOCK, *PAIR], keep="last")
    table = rows.set_index([*BLOCK, *PAIR])["value"].unstack(PAIR)
    return table[sorted(table.columns, key=in_order)]


def margin(
    table: pd.DataFrame, lower: list[Pair], higher: list[Pair], higher_in: pd.DataFrame
) -> tuple[float, tuple[float, float], int]:
    """Return by how much the worst of ``lower`` lies below the best of ``higher``.

    Medians are taken over the seeds that all pairs have.

    Args:
        table: Values of the pairs in ``lower``, a row for each seed.
        lower: Pairs that are said to be smaller.
        higher: Pairs that are said to be larger.
        higher_in: Values of the pairs in ``higher``, a row for each seed.

    Returns:
        The margin in powers of ten, its interval from resampled seeds, and the number of seeds;
        NaN and 0 where a pair has not been run.
    """
    nothing = math.nan, (math.nan, math.nan), 0
    if not set(lower) <= set(table.columns) or not set(higher) <= set(higher_in.columns):
        return nothing
    small, large = table[lower].dropna(), higher_in[higher].dropna()
    seeds = small.index.intersection(large.index)
    if seeds.empty:
        return nothing
    small_, large_ = (logarithms(part.loc[seeds]) for part in (small, large))

    def below(rows: np.ndarray) -> np.ndarray:
        """Return the margin for each row of seed numbers."""
        worst = np.median(small_[rows], axis=1).max(axis=1)
        return np.median(large_[rows], axis=1).min(axis=1) - worst

    every = np.arange(len(seeds))[None]
    return float(below(every)[0]), between(below(resampled(len(seeds)))), len(seeds)


def resampled(count: int, stream: int = 0) -> np.ndarray:
    """Return ``DRAWS`` rows of ``count`` numbers below ``count``, drawn with replacement."""
    return np.random.default_rng(stream).integers(0, count, (DRAWS, count))


def between(values: np.ndarray) -> tuple[float, float]:
    """Return the bounds of the central interval that has a share ``LEVEL`` of the values."""
    tail = (1 - LEVEL) / 2
    low, high = np.quantile(values, [tail, 1 - tail])
    return float(low), float(high)


def logarithms(values: pd.DataFrame | pd.Series) -> np.ndarray:
    """Return bounded logarithms, so that two methods that diverge are equal."""
    return np.log10(values.to_numpy(dtype=float).clip(1e-300, 1e30))
