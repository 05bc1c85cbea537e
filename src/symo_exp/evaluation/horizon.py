"""How far a model predicts recorded motions: errors over horizons of 0.5, 1 and 2 s.

The protocol needs no truth. Windows of 2 s begin every 0.25 s (or up to a step less) of each
trajectory; those in which nothing moves by 0.2 rad (m) are left out. A model predicts each from a
start and the measured inputs alone, open loop. There are two starts:

* *fitted*: the state that makes the model's own motion fit the configurations of a run-in of 0.2 s
  (its nodes, the last of which is the window's first). It asks the model, not a velocity sensor;
* *measured*: configuration and velocity of the window's first node, as they were recorded.

A trajectory shorter than run-in and window gives one window of what it has.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor

from symo_exp.evaluation.measures import VALID_ERROR, squared_error
from symo_exp.evaluation.rollouts import CHUNK
from symo_exp.evaluation.starts import RollsOut, State, fitted_start
from symo_exp.mechanics.types import Trajectory

HORIZONS = (0.5, 1.0, 2.0)
"""Up to which errors are measured [s]; the last is the length of a window."""
EVERY, RUN_IN = 0.25, 0.2
"""From the start of a window to that of the next, and what is fitted before it [s]."""
MOVES = 0.2
"""Range of a coordinate [rad, m] below which it rests."""


class Windows(NamedTuple):
    """Pieces of trajectories, padded to the longest: run-in and prediction.

    Node ``lead`` is the first of the window; the run-in ends there. After the end of its
    trajectory a piece has no configurations (NaN) and no input (0).
    """

    trajectory: Int[Tensor, " windows"]
    first: Int[Tensor, " windows"]
    """Node of the trajectory with which the window begins."""
    lead: int
    q: Float[Tensor, "windows nodes n"]
    v: Float[Tensor, "windows nodes n"]
    u: Float[Tensor, "windows nodes m"]


@dataclass(frozen=True)
class Predictions:
    """What a model made of the windows, in float64; node 0 is the start.

    ``q_true`` and ``v_true`` were measured; after the end of a trajectory they are NaN.
    """

    time_step: float
    windows: Windows
    q: Float[Tensor, "windows nodes n"]
    v: Float[Tensor, "windows nodes n"]

    @property
    def q_true(self) -> Float[Tensor, "windows nodes n"]:
        return self.windows.q[:, self.windows.lead :]

    @property
    def v_true(self) -> Float[Tensor, "windows nodes n"]:
        return self.windows.v[:, self.windows.lead :]

    @property
    def span(self) -> float:
        """Length of the longest window [s]."""
        return (self.q.shape[1] - 1) * self.time_step

    def errors(self) -> Float[Tensor, "windows steps"]:
        """Mean squared error over the coordinates at each predicted node, the start left out.

        Infinite where the prediction is not finite, NaN after the end of the trajectory.
        """
        true = self.q_true[:, 1:]
        error = squared_error(self.q[:, 1:], true).mean(2)
        return error.where(true.isfinite().all(2), torch.nan)

    def rmse(self, seconds: float) -> Float[Tensor, " windows"]:
        """Root mean square error of each window over coordinates and time to ``seconds``."""
        return self._until(seconds).nanmean(1).sqrt()

    def valid_seconds(self) -> Float[Tensor, " windows"]:
        """Until the error, root mean square over coordinates, exceeds 0.1 [rad, m]."""
        error = self.errors()
        left = (error.sqrt() > VALID_ERROR) | error.isnan()
        return (left.cumsum(1) == 0).sum(1).double() * self.time_step

    def measures(self) -> dict[str, float]:
        """``rmse_<T>s``, ``pooled_rmse_<T>s`` [rad, m] and ``valid_s`` (docs/metrics.md)."""
        found = {"valid_s": median(self.valid_seconds())}
        for seconds in HORIZONS:
            name = f"rmse_{seconds:g}s"
            found[name] = median(self.rmse(seconds))
            found[f"pooled_{name}"] = self._until(seconds).nanmean().sqrt().item()
        return found

    def _until(self, seconds: float) -> Tensor:
        return self.errors()[:, : round(seconds / self.time_step)]


def cut(trajectories: Sequence[Trajectory], time_step: float, *, run_in: bool) -> Windows | None:
    """The windows of all trajectories, with or without a run-in; ``None`` if there are none."""
    lead = max(2, round(RUN_IN / time_step) - 1) if run_in else 0
    length = lead + round(HORIZONS[-1] / time_step)
    pieces = [
        (at, start + lead, Trajectory(*(x[start : start + length + 1] for x in whole)))
        for at, whole in enumerate(trajectories)
        for start in _starts(len(whole.q) - 1, lead, length, time_step)
    ]
    pieces = [piece for piece in pieces if _moves(piece[2].q[lead:])]
    if not pieces:
        return None
    trajectory, first, cuts = zip(*pieces, strict=True)
    q, v, u = (_padded(field) for field in zip(*cuts, strict=True))
    return Windows(torch.tensor(trajectory), torch.tensor(first), lead, q, v, u.nan_to_num())


@torch.no_grad()
def predict(model: RollsOut, windows: Windows, time_step: float, place: Tensor) -> Predictions:
    """A model's motions through the windows, from the fitted start where they have a run-in.

    ``place`` is a tensor of the precision and on the device in which the model works.
    """
    q_true, v_true, inputs = (x.to(place).split(CHUNK) for x in (windows.q, windows.v, windows.u))
    parts = [
        _roll_out(model, *chunk, windows.lead, time_step)
        for chunk in zip(q_true, v_true, inputs, strict=True)
    ]
    q, v = (torch.cat(field) for field in zip(*parts, strict=True))
    return Predictions(time_step, windows, q, v)


def _roll_out(
    model: RollsOut, q: Tensor, v: Tensor, u: Tensor, lead: int, time_step: float
) -> tuple[Tensor, Tensor]:
    start = State(q[:, 0], v[:, 0])
    if lead:
        start = fitted_start(model, q[:, : lead + 1], u[:, : lead + 1], time_step)
    path = model.rollout(*start, u)
    return path.q[:, lead:].double().cpu(), path.v[:, lead:].double().cpu()


def _starts(steps: int, lead: int, length: int, time_step: float) -> range:
    """Nodes at which a run-in, or without one a window, begins in a trajectory."""
    if steps < length:
        return range(1 if steps > lead else 0)
    return range(0, steps - length + 1, max(1, int(EVERY / time_step + 1e-9)))


def _moves(q: Tensor) -> bool:
    return bool((q.amax(0) - q.amin(0) >= MOVES).any())


def _padded(pieces: Sequence[Tensor]) -> Tensor:
    double = [piece.double() for piece in pieces]
    return torch.nn.utils.rnn.pad_sequence(double, batch_first=True, padding_value=torch.nan)


def median(values: Tensor) -> float:
    """The median, the mean of the two in the middle where their number is even."""
    ordered = values.double().sort().values
    return (0.5 * (ordered[(len(values) - 1) // 2] + ordered[len(values) // 2])).item()
