"""The published numbers of the thesis, as data and compared with results.

``published.csv`` has a row for each number of each of the 198 runs of the thesis:

* ``system``, ``time_step`` [s], ``method``, ``integrator``, ``n_traj``, ``noise_std``: the cell;
* ``learning_rate``: the thesis trains with another one on noisy data;
* ``metric``, ``value``, ``std``: the measure by its name here and, of a mean over trajectories, the
  standard deviation, that of a sample (ours is that of the population). Of the errors over 500
  steps of the pendulum it is over all nodes of all trajectories. There is one run in each cell;
* ``over``: what the value averages over. The thesis defines its errors over the configuration; some
  printed values average over the state, or over the configuration and one velocity.

``over.csv`` has for each measure and ``over`` the measure here that is ``like`` it, and a note.
"""

from __future__ import annotations

import functools
from pathlib import Path

import pandas as pd

from symo_exp.report.cells import SUMMARY, at_step

FOLDER = Path(__file__).parent
CELL = ["system", "time_step", "method", "integrator", "n_traj", "noise_std"]
TIME_STEPS = {"pendulum": 0.1, "acrobot": 0.05, "cartpole": 0.05}
"""Time steps [s] of the tables and figures; the file also has runs with smaller ones."""
NOISY = "; the published test data are noisy, ours are not"


@functools.cache
def published() -> pd.DataFrame:
    """Return the numbers and what they average over."""
    table = pd.read_csv(FOLDER / "published.csv")
    return table.merge(pd.read_csv(FOLDER / "over.csv"), on=["metric", "over"], how="left")


def thesis_figures() -> dict[str, str]:
    """Return the numbers of the figures of the thesis by the keys of the figures here."""
    return dict(pd.read_csv(FOLDER / "figures.csv", dtype=str).to_numpy().tolist())


def as_cells(variant: str) -> pd.DataFrame:
    """Return the published numbers as cells at the time steps of the chapter."""
    table = at_step(published(), TIME_STEPS)
    nothing = dict.fromkeys(("low", "high", "seconds"), float("nan"))
    return table.rename(columns={"value": "median"}).assign(
        source="published", variant=variant, seeds=1, text="published, " + table.note, **nothing
    )


def with_ours(found: pd.DataFrame) -> pd.DataFrame:
    """Return a row for each published number, with the result of the cell if it has been run.

    ``like`` is the measure here with the same average, ``alike`` its median and ``factor`` the
    ratio of ``alike`` to the published value.

    Args:
        found: Cells of runs (``report.cells``).
    """
    theirs = published().rename(columns={"value": "published", "std": "published_std"})
    noisy = (theirs.metric == "test_mse") & (theirs.noise_std > 0)
    theirs = theirs.assign(note=theirs.note.where(~noisy, theirs.note + NOISY))
    merged = theirs.merge(
        found[["variant", *CELL, "metric", *SUMMARY]], on=[*CELL, "metric"], how="left"
    )
    alike = found[["variant", *CELL, "metric", "median"]]
    alike = alike.rename(columns={"metric": "like", "median": "alike"})
    merged = merged.merge(alike, on=["variant", *CELL, "like"], how="left")
    return merged.assign(factor=merged.alike / merged.published)
