"""Errors of predicted recordings over horizons of 0.5, 1 and 2 s, and over whole recordings.

The protocol needs no true system. Windows of 2 s begin every 0.25 s (or up to a step less) of each
trajectory; those in which nothing moves are left out (``movement``). A model predicts each window
from a start and the measured inputs alone, in open loop. There are two starts:

* *fitted*: the state that makes the model's own motion fit the configurations of a run-in of 0.2 s
  (its nodes, the last of which is the window's first). It depends on no velocity sensor;
* *measured*: configuration and velocity of the window's first node, as they were recorded.

A trajectory shorter than run-in and window gives one window of all it has. Where all of them are
shorter than 0.8 s, the run-in is a quarter of the longest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence

from symo_exp.data.sensors import noise_of
from symo_exp.data.weak import ROUNDING
from symo_exp.evaluation.measures import VALID_ERROR, squared, steps_within
from symo_exp.evaluation.rollouts import CHUNK
from symo_exp.mechanics.roots import Sizes
from symo_exp.mechanics.space import Space, space_of
from symo_exp.mechanics.types import Trajectories, Trajectory
from symo_exp.models.starts import ITERATIONS, RollsOut, State, fitted_start
from symo_exp.optim.robust import median_of_rows

HORIZONS = (0.5, 1.0, 2.0)
"""Times up to which errors are measured [s]; the last is the length of a window."""
EVERY, RUN_IN = 0.25, 0.2
"""Distance of the starts of windows, and length of the run-in before each [s]."""
LONG = 2.0 * HORIZONS[-1]
"""Length from which a recording is also compared as a whole [s]."""
MOVES, SHARE, ABOVE_NOISE = 0.2, 0.05, 10.0
"""A coordinate moves in a window where its range exceeds so many rad or m, or this share of its
range in the recordings if that is less, and so many times its noise."""
TOLERANCE, TURNS, STILL = 0.1, 1.0, 2.0
"""Share of the motion in a window up to which a prediction is usable, the motion of an angle [rad]
at most, and that over the noise up to which a coordinate stands still."""
DOUBLE = torch.zeros((), dtype=torch.float64)
"""Double precision on the processor, where baselines are predicted."""


class PredictionWindows(NamedTuple):
    """Pieces of trajectories, padded to the longest: run-in and prediction.

    After the end of its trajectory a piece has no configurations (NaN) and no input (0).

    Attributes:
        trajectory: Index of the trajectory that each was cut from.
        first: Its node with which the window begins.
        lead: Node of the piece that is the first of the window; the run-in ends there.
        q: Configurations.
        v: Velocities.
        u: Inputs.
    """

    trajectory: Int[Tensor, " windows"]
    first: Int[Tensor, " windows"]
    lead: int
    q: Float[Tensor, "windows nodes n"]
    v: Float[Tensor, "windows nodes n"]
    u: Float[Tensor, "windows nodes m"]


@dataclass(frozen=True)
class Predictions:
    """Predicted windows, in float64; node 0 is the start.

    Attributes:
        time_step: Distance of the nodes [s].
        windows: The predicted windows.
        q: Predicted configurations.
        v: Predicted velocities.
    """

    time_step: float
    windows: PredictionWindows
    q: Float[Tensor, "windows nodes n"]
    v: Float[Tensor, "windows nodes n"]

    @property
    def q_true(self) -> Float[Tensor, "windows nodes n"]:
        """Measured configurations; NaN after the end of a trajectory."""
        return self.windows.q[:, self.windows.lead :]

    @property
    def v_true(self) -> Float[Tensor, "windows nodes n"]:
        """Measured velocities; NaN after the end of a trajectory."""
        return self.windows.v[:, self.windows.lead :]

    def errors(self, units: Float[Tensor, " n"] | float = 1.0) -> Float[Tensor, "windows steps"]:
        """Return the mean squared error over coordinates at each predicted node.

        Infinite where the prediction is not finite, NaN after the end of the trajectory.

        Args:
            units: Units of the coordinates' errors [rad, m].
        """
        return self._at_nodes(units)[:, 1:]

    def distances(self) -> Float[Tensor, "windows nodes"]:
        """Return the root mean square error over coordinates at each node, the start included."""
        return self._at_nodes(1.0).sqrt()

    def _at_nodes(self, units: Tensor | float) -> Tensor:
        """Return the mean squared error over coordinates at each node, the start included."""
        error = _mean_squares(space_of(self.q, self.v), self.q_true, self.q, units)
        return error.where(self.q_true.isfinite().all(2), torch.nan)

    def rmse(
        self, seconds: float, units: Float[Tensor, " n"] | float = 1.0
    ) -> Float[Tensor, " windows"]:
        """Return the root mean square error of each window over coordinates and time."""
        return self._until(seconds, units).nanmean(1).sqrt()

    def valid_seconds(self) -> Float[Tensor, " windows"]:
        """Return the time until the error, RMS over coordinates, exceeds 0.1 [rad, m]."""
        return self._within(self.errors().sqrt(), VALID_ERROR)

    def usable_seconds(self, tolerance: Float[Tensor, " n"]) -> Float[Tensor, " windows"]:
        """Return the time until the error over ``tolerance``, RMS over coordinates, exceeds 1."""
        return self._within(self.errors(tolerance), 1.0)

    def measured_seconds(self) -> Float[Tensor, " windows"]:
        """Return the time that was measured in each window; less than 2 s at the end of one."""
        return self._within(self.errors(), torch.inf)

    def _within(self, error: Tensor, most: float) -> Tensor:
        """Return the time until the error exceeds a number or nothing was measured any more."""
        return steps_within(error, most) * self.time_step

    def measures(self) -> dict[str, float]:
        """Return ``rmse_<T>s``, ``pooled_rmse_<T>s`` [rad, m] and ``valid_s`` [s]."""
        found = {"valid_s": median(self.valid_seconds())}
        for seconds in HORIZONS:
            name = f"rmse_{seconds:g}s"
            found[name] = median(self.rmse(seconds))
            found[f"pooled_{name}"] = self._until(seconds).nanmean().sqrt().item()
        return found

    def _until(self, seconds: float, units: Tensor | float = 1.0) -> Tensor:
        return self.errors(units)[:, : steps_in(seconds, self.time_step)]


def cut(
    trajectories: Sequence[Trajectory],
    time_step: float,
    *,
    run_in: bool,
    seconds: float = HORIZONS[-1],
) -> PredictionWindows | None:
    """Return the windows of all trajectories, with or without a run-in; ``None`` without any.

    ``seconds`` is their length without the run-in.
    """
    lead = _run_in(trajectories, time_step) if run_in else 0
    length = lead + steps_in(seconds, time_step)
    pieces = [
        (at, start + lead, Trajectory(*(x[start : start + length + 1] for x in whole)))
        for at, whole in enumerate(trajectories)
        for start in _starts(len(whole.q) - 1, lead, length, time_step)
    ]
    least = movement(trajectories)
    pieces = [piece for piece in pieces if bool((_ranges(_plain(piece[2])[lead:]) > least).any())]
    if not pieces:
        return None
    trajectory, first, cuts = zip(*pieces, strict=True)
    return PredictionWindows(torch.tensor(trajectory), torch.tensor(first), lead, *_padded(cuts))


def movement(trajectories: Sequence[Trajectory]) -> Float[Tensor, " n"]:
    """Return the range of each coordinate beyond which it moves in a window [rad, m]."""
    ranges = torch.stack([_ranges(_plain(one)) for one in trajectories]).amax(0)
    least = (SHARE * ranges).clamp(max=MOVES)
    return torch.maximum(least, ABOVE_NOISE * noise(trajectories))


def noise(trajectories: Sequence[Trajectory]) -> Float[Tensor, " n"]:
    """Return the standard deviation of each coordinate's noise at the nodes, an estimate."""
    columns = zip(*(_plain(one).double().unbind(1) for one in trajectories), strict=True)
    found = [noise_of([x.numpy() for x in each]) for each in columns]
    return torch.tensor(found, dtype=torch.float64).nan_to_num(0.0)


def tolerance(
    windows: PredictionWindows, turning: Sequence[bool], noise: Float[Tensor, " n"] | float = 0.0
) -> Float[Tensor, " n"]:
    """Return the error of each coordinate up to which a prediction is usable [rad, m].

    It is a tenth of the motion in a window: of its standard deviation, root mean square over
    windows and, of a rotation, over the three components. Of an angle or a rotation that moves by
    more than 1 rad, it is 0.1 rad; of a coordinate that does not move by more than its ``noise``,
    that of the coordinate which moves most.
    """
    space = space_of(windows.q, windows.v)
    q = space.along(windows.q[:, windows.lead :])
    motion = (q - q.nanmean(1, keepdim=True)).square().nanmean((0, 1)).sqrt()
    flat, turns = motion.split((len(motion) - 3 * space.rotations, 3 * space.rotations))
    whole = turns.view(-1, 3).square().mean(1, keepdim=True).sqrt()
    motion = torch.cat((flat, whole.expand(-1, 3).flatten()))
    motion = torch.where(torch.tensor(turning), motion.clamp(max=TURNS), motion)
    rounding = ROUNDING * q.abs().nan_to_num().amax((0, 1))
    moves = motion > torch.maximum(STILL * torch.as_tensor(noise), rounding)
    return TOLERANCE * motion.where(moves, motion.max())


@torch.no_grad()
def predict(
    model: RollsOut,
    windows: PredictionWindows,
    place: Tensor = DOUBLE,
    units: Float[Tensor, " n"] | float = 1.0,
    iterations: int = ITERATIONS,
) -> Predictions:
    """Return a model's motions through the windows, from fitted starts where they have a run-in.

    ``place`` is a tensor of the precision and on the device in which the model works; ``units``
    are those of the coordinates [rad, m], and ``iterations`` those of ``fitted_start``.
    """
    lead, space, sizes = windows.lead, space_of(windows.q, windows.v), _sizes(units)
    measured = (x.to(place).split(CHUNK) for x in (windows.q, windows.v, windows.u))
    paths = []
    for q, v, u in zip(*measured, strict=True):
        start = State(q[:, 0], v[:, 0])
        if lead:
            given = q[:, : lead + 1], u[:, : lead + 1]
            start = fitted_start(model, *given, iterations, space=space, sizes=sizes)
        path = model.rollout(*start, u)
        paths.append([x[:, lead:].double().cpu() for x in (path.q, path.v)])
    q, v = (torch.cat(field) for field in zip(*paths, strict=True))
    return Predictions(model.time_step, windows, q, v)


@torch.no_grad()
def predict_whole(
    model: RollsOut,
    trajectories: Sequence[Trajectory],
    place: Tensor = DOUBLE,
    units: Float[Tensor, " n"] | float = 1.0,
) -> Predictions:
    """Return a model's motions along whole trajectories, in open loop from their first nodes.

    The start is fitted to the configurations of the first 0.2 s, in ``units`` [rad, m].
    """
    (q, v, u), start = _started(model, trajectories, place, _sizes(units))
    count = torch.arange(len(trajectories))
    whole = PredictionWindows(count, torch.zeros_like(count), 0, q, v, u)
    path = model.rollout(*start, u.to(place))
    return Predictions(model.time_step, whole, path.q.double().cpu(), path.v.double().cpu())


@torch.no_grad()
def whole_error(
    model: RollsOut,
    trajectories: Sequence[Trajectory],
    place: Tensor = DOUBLE,
    units: Float[Tensor, " n"] | float = 1.0,
) -> float | None:
    """Return the error over whole recordings of 4 s or more; ``None`` if there are none.

    It is the root mean square over recordings in ``units`` [rad, m] of the coordinates, each in
    open loop from its first nodes and at most the standard deviation of its motion, where nothing
    is known of the configuration. A rollout ends where this bound is certain to be reached, as it
    soon is for a chaotic motion.
    """
    h = model.time_step
    long = [one for one in trajectories if (len(one.q) - 1) * h >= LONG * (1 - 1e-9)]
    if not long:
        return None
    (q, v, u), state = _started(model, long, place, _sizes(units))
    u, space = u.to(place), space_of(q, v)
    plain, there = space.along(q) / torch.as_tensor(units), q.isfinite().all(2)
    most = (plain - plain.nanmean(1, keepdim=True)).square().nanmean((1, 2))
    total, count = torch.zeros_like(most), there.sum(1)
    rows, segment, last = torch.arange(len(q)), steps_in(HORIZONS[-1], h), q.shape[1] - 1
    for k in range(0, last, segment):
        end = min(k + segment, last)
        path, predicted = model.rollout(*state, u[rows, k : end + 1]), slice(k + 1, end + 1)
        error = _mean_squares(space, q[rows, predicted], path.q[:, 1:].double().cpu(), units)
        total[rows] += error.where(there[rows, predicted], 0.0).sum(1)
        left = (total < most * count)[rows] & there[rows, end]
        rows, state = rows[left], State(path.q[left, -1], path.v[left, -1])
        if len(rows) == 0:
            break
    return float(torch.minimum(total / count, most).mean().sqrt())


def _started(
    model: RollsOut,
    trajectories: Sequence[Trajectory],
    place: Tensor,
    sizes: Sizes,
) -> tuple[Trajectories, State]:
    """Return the padded trajectories, and the state that fits the first 0.2 s of each."""
    whole = _padded(trajectories)
    run_in = _run_in(trajectories, model.time_step)
    lead = min(run_in, min(len(one.q) for one in trajectories) - 1)
    q, u = (x[:, : lead + 1].to(place) for x in (whole.q, whole.u))
    return whole, fitted_start(model, q, u, space=space_of(whole.q, whole.v), sizes=sizes)


def _mean_squares(
    space: Space, true: Tensor, found: Tensor, units: Tensor | float
) -> Float[Tensor, "rows nodes"]:
    """Return the mean squared error over coordinates, in their units, at each node."""
    squares = squared(space.difference(true, found))
    return (squares / torch.as_tensor(units).square()).mean(2)


def _sizes(units: Tensor | float) -> Sizes:
    """Return units as numbers; a single one is that of all coordinates."""
    return tuple(torch.as_tensor(units).reshape(-1).tolist())


def _starts(steps: int, lead: int, length: int, time_step: float) -> range:
    """Nodes at which a run-in, or without one a window, begins in a trajectory."""
    if steps < length:
        return range(1 if steps > lead else 0)
    return range(0, steps - length + 1, max(1, int(EVERY / time_step + 1e-9)))


def _run_in(trajectories: Sequence[Trajectory], time_step: float) -> int:
    """Return the steps of a run-in."""
    longest = max(len(one.q) for one in trajectories) - 1
    return max(2, min(round(RUN_IN / time_step) - 1, longest // 4))


def _ranges(q: Tensor) -> Tensor:
    return q.amax(0) - q.amin(0)


def _plain(one: Trajectory) -> Tensor:
    """Return the configurations with n numbers each, which do not jump."""
    return space_of(one.q, one.v).unrolled(one.q)


def _padded(trajectories: Sequence[Trajectory]) -> Trajectories:
    """Return trajectories as one of the longest: then NaN follows, and inputs of zero."""
    q, v, u = (
        pad_sequence([x.double() for x in field], batch_first=True, padding_value=torch.nan)
        for field in zip(*trajectories, strict=True)
    )
    return Trajectories(q, v, u.nan_to_num())


def steps_in(seconds: float, time_step: float) -> int:
    """Return the number of steps in a time, at least one."""
    return max(1, round(seconds / time_step))


def median(values: Tensor) -> float:
    """Return the median, the mean of the two in the middle where their number is even."""
    return median_of_rows(values.double()).item()
