"""Statements of the thesis on its methods, as comparisons that runs decide.

Each row of ``claims.csv`` states that every pair of ``lower`` has a smaller ``metric`` than every
pair of ``higher`` has of ``higher_metric``, by the factor ``times`` at least.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from symo_exp.report.looks import Pair
from symo_exp.report.ranking import BLOCK, margin, wide
from symo_exp.thesis import published

PAIRS: list[Pair] = [
    ("node", "midpoint"),
    ("node", "rk4"),
    ("l_node", "midpoint"),
    ("l_node", "rk4"),
    ("symo", "midpoint"),
    ("e2e_symo", "midpoint"),
]
"""The methods of the chapter."""
CLAIMS = pd.read_csv(published.FOLDER / "claims.csv", dtype={"section": str})


class Verdict(NamedTuple):
    """The verdict of runs on a statement.

    Args:
        said: ``holds``, ``does not hold``, ``undecided`` or ``not run``.
        margin: The factor found over the claimed one; above 1 the statement holds.
        interval: The interval of the margin.
        seeds: Number of seeds.
    """

    said: str
    margin: float
    interval: tuple[float, float]
    seeds: int


def judge(measures: pd.DataFrame) -> list[tuple[Mapping[Any, Any], Verdict, Verdict]]:
    """Return each statement with its verdict by the published numbers and by runs.

    Args:
        measures: Runs of one variant at the time step of the thesis.
    """
    theirs = published.published().assign(seed=0)
    theirs = theirs[theirs.time_step == theirs.system.map(published.TIME_STEPS)]
    metrics = {*CLAIMS.metric, *CLAIMS.higher_metric}
    tables = [{name: wide(source, name) for name in metrics} for source in (theirs, measures)]
    return [
        (claim, _decide(claim, tables[0]), _decide(claim, tables[1]))
        for claim in CLAIMS.to_dict("records")
    ]


def _decide(claim: Mapping[Any, Any], tables: Mapping[str, pd.DataFrame]) -> Verdict:
    small, large = (_cell(claim, tables[claim[m]]) for m in ("metric", "higher_metric"))
    size, interval, seeds = margin(small, _pairs(claim["lower"]), _pairs(claim["higher"]), large)
    factor, low, high = (10.0**x / claim["times"] for x in (size, *interval))
    said = "holds" if low > 1 else "does not hold" if high <= 1 else "undecided"
    return Verdict(said if seeds else "not run", factor, (low, high), seeds)


def _pairs(words: str) -> list[Pair]:
    pairs = (word.split("/") for word in words.split())
    return [(method, integrator) for method, integrator in pairs]


def _cell(claim: Mapping[Any, Any], table: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of the cell of a statement, one for each seed."""
    block = [level for level in BLOCK if level != "seed"]
    wanted = tuple(claim[level] for level in block)
    at = [tuple(values) == wanted for values in table.index.droplevel("seed")]
    return table[np.array(at, dtype=bool)].droplevel(block)
