"""The published figures of the thesis, as data.

``published.csv`` has a row for each number of each of its 198 runs:

* ``system``, ``time_step`` [s], ``method``, ``integrator``, ``n_traj``, ``noise_std``: the cell;
* ``learning_rate``: with noise the thesis trains with another one;
* ``metric``, ``value``, ``std``: the measure by our name and, where it is one over trajectories,
  its standard deviation over them. One run a cell: there is no spread over seeds;
* ``over``: what the value is a mean over. The thesis defines its errors over the pose; what it
  prints is in places over the whole state, or over the pose and one velocity.
"""

from __future__ import annotations

import functools
from pathlib import Path

import pandas as pd

FILE = Path(__file__).with_suffix(".csv")
CELL = ["system", "time_step", "method", "integrator", "n_traj", "noise_std"]
TIME_STEPS = {"pendulum": 0.1, "acrobot": 0.05, "cartpole": 0.05}
"""Of the chapter's tables and figures [s]; the file has runs with smaller steps, too."""

LIKE = {
    ("test_mse", "state"): "test_mse_state",
    ("integration_mse", "state"): "integration_mse_state",
    ("energy_mse", "finite-difference velocity"): "energy_mse_fd",
}
"""Our measure that averages over the same as the published one, where it is not the same name."""

NOTES = {
    "pose": "over the pose, like ours",
    "state": "over positions and velocities together",
    "pose and first velocity": "over the pose and one velocity: like nothing that is defined",
    "own velocity": "with the velocity of the model, like ours",
    "finite-difference velocity": (
        "with the velocity (q' - q)/h paired with q', half a step old: an error of that mismatch "
        "more than of the motion"
    ),
    "matrix entries": "over the entries of the matrix, like ours",
}
"""What each value of ``over`` means."""
NOISY = "the published test data are noisy, ours are not"


@functools.cache
def published() -> pd.DataFrame:
    """The file above."""
    return pd.read_csv(FILE)


def note(metric: str, over: str) -> str:
    """What a published value of ``over`` says beside ours."""
    alike = "; ours, made alike, is compared with it" if (metric, over) in LIKE else ""
    return NOTES[over] + alike


def like(metric: str, over: str) -> str:
    """The measure of ours to hold against a published value."""
    return LIKE.get((metric, over), metric)
