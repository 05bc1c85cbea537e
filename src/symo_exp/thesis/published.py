"""The published numbers of the thesis, as data, and beside ours.

``published.csv`` has a row for each number of each of its 198 runs:

* ``system``, ``time_step`` [s], ``method``, ``integrator``, ``n_traj``, ``noise_std``: the cell;
* ``learning_rate``: with noise the thesis trains with another one;
* ``metric``, ``value``, ``std``: the measure by our name and, where it is one over trajectories,
  its standard deviation over them. One run a cell: there is no spread over seeds;
* ``over``: what the value is a mean over. The thesis defines its errors over the configuration;
  what it prints is in places over the whole state, or over the configuration and one velocity.

``over.csv`` says, for each measure and ``over``, which measure of ours is ``like`` it, and a note.
"""

from __future__ import annotations

import functools
from pathlib import Path

import pandas as pd

from symo_exp.report.cells import SUMMARY, at_step

FOLDER = Path(__file__).parent
CELL = ["system", "time_step", "method", "integrator", "n_traj", "noise_std"]
TIME_STEPS = {"pendulum": 0.1, "acrobot": 0.05, "cartpole": 0.05}
"""Of the chapter's tables and figures [s]; the file has runs with smaller steps, too."""
NOISY = "; the published test data are noisy, ours are not"


@functools.cache
def published() -> pd.DataFrame:
    """The numbers, with what they are averages over."""
    table = pd.read_csv(FOLDER / "published.csv")
    return table.merge(pd.read_csv(FOLDER / "over.csv"), on=["metric", "over"], how="left")


def figures() -> dict[str, str]:
    """The figures of the thesis that ours repeat, by the names of ours."""
    return dict(pd.read_csv(FOLDER / "figures.csv", dtype=str).to_numpy().tolist())


def as_cells(variant: str) -> pd.DataFrame:
    """The published numbers as cells to draw beside ours, at the chapter's time steps."""
    table = at_step(published(), TIME_STEPS)
    nothing = dict.fromkeys(("low", "high", "seconds"), float("nan"))
    return table.rename(columns={"value": "median"}).assign(
        source="published", variant=variant, seeds=1, text="published, " + table.note, **nothing
    )


def with_ours(found: pd.DataFrame) -> pd.DataFrame:
    """A row for each published number: with ours, where that cell has been run.

    ``like`` names our measure that averages over the same, ``alike`` is its median and ``factor``
    is ``alike`` over the published value.
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
