"""Intervals of predicted recordings: widened by errors of recordings, and how much they cover."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from symo_exp.evaluation.horizon import (
    HORIZONS,
    Predictions,
    PredictionWindows,
    cut,
    predict,
    steps_in,
)  # fmt: skip
from symo_exp.mechanics.rows import take_rows
from symo_exp.mechanics.types import Trajectory
from symo_exp.models.base import DynamicsModel
from symo_exp.models.uncertainty import (
    Interval,
    ModelPosterior,
    quantile,
    sensitivity,
    spread,
    variance,
)  # fmt: skip
from symo_exp.optim.posterior import Posterior

LEVEL = 0.9
"""Probability of the intervals whose coverage is measured."""
ROLLOUTS = 12
"""Number behind the intervals of all windows, whose time is that of evaluations."""
WINDOWS = 300
"""Number of windows whose errors widen intervals, at most."""
SCALES = 11
"""Number of equally probable sizes that the errors of another recording may have."""
SMALLEST = 1e-300


class Predicted(NamedTuple):
    """Recordings and the model that predicts them.

    Attributes:
        model: A model, in float64, with the same settings that was not trained on the recordings,
            as in a cross-validation; ``None``: the one whose intervals are widened.
        trajectories: The recordings.
    """

    model: DynamicsModel | None
    trajectories: Sequence[Trajectory]


def widened(
    model: DynamicsModel, posterior: Posterior, recordings: Sequence[Predicted]
) -> ModelPosterior:
    """Return the posterior with the error beyond it that windows of recordings show.

    With ``σ`` the standard deviation of the parameters and ``s`` the sensitivity of a rollout,
    intervals have the variance ``σ² + κ² s²``; see ``relative_error`` for ``κ``. Without windows,
    or where the parameters explain the errors, there is no such error.

    Args:
        model: The model, in float64.
        posterior: Posterior of its parameters.
        recordings: Recordings and the models that predict them.
    """
    every = [trajectory for one in recordings for trajectory in one.trajectories]
    windows = cut(every, model.time_step, run_in=True) if every else None
    if windows is None:
        return ModelPosterior(posterior)
    if len(windows.q) > WINDOWS:
        windows = take_rows(windows, torch.linspace(0, len(windows.q) - 1, WINDOWS).round().long())
    own = _predicted(model, windows)
    rolled = _rolled(model, own)
    by_parameters = spread(model.flow, posterior, *rolled, ROLLOUTS).double().cpu()
    by_start = sensitivity(model.flow, *rolled).double().cpu()
    q = _by_each_model(recordings, own)
    error = (q - own.q_true).where(q.isfinite(), torch.nan)
    kappa = relative_error(error, by_parameters, by_start, windows.trajectory)
    return ModelPosterior(posterior, kappa if bool((kappa > 0.0).any()) else None)


def _by_each_model(recordings: Sequence[Predicted], own: Predictions) -> Tensor:
    """Return the configurations of each window as the model for its recording predicts them."""
    counts = torch.tensor([len(one.trajectories) for one in recordings])
    group = torch.arange(len(recordings)).repeat_interleave(counts)
    q = own.q.clone()
    for k, one in enumerate(recordings):
        rows = group[own.windows.trajectory] == k
        if one.model is not None and bool(rows.any()):
            q[rows] = _predicted(one.model, take_rows(own.windows, rows)).q
    return q


def relative_error(
    error: Float[Tensor, "windows nodes n"],
    variance: Float[Tensor, "windows nodes n"],
    sensitivity: Float[Tensor, "windows nodes n"],
    recording: Float[Tensor, " windows"],
) -> Float[Tensor, "nodes n"]:
    """Return ``κ`` with which ``σ² + κ² s²`` holds 90 % of the errors of another recording.

    At each node, ``κ`` is the 90 % quantile of the least one with which an error is inside. Every
    recording has the same weight. The sizes of their errors differ: the size for another recording
    is log-normal, with the variance ``τ² (1 + 1/R)`` of the logarithm, ``τ²`` being that of the
    ``R`` recordings at hand, and multiplies the errors.

    Args:
        error: Errors of windows; NaN where nothing was measured or a rollout diverged.
        variance: ``σ²``, that of the parameters.
        sensitivity: ``s``.
        recording: Index of the recording of each window.
    """
    inside = (error / quantile(LEVEL)).square()
    least = (inside - variance).clamp_min(0.0) / sensitivity.square()
    rows = [recording == one for one in recording.unique()]
    weight = torch.stack([row / row.sum() for row in rows]).sum(0)
    typical = torch.stack([least[row].nanmean(0) for row in rows]).nanmean(0)
    share = inside / (variance + typical * sensitivity.square()).clamp_min(SMALLEST)
    size = torch.stack([share[row].nanmean() for row in rows])
    size = size[size.isfinite()].clamp_min(SMALLEST)
    others = 0.0
    if len(size) > 1:
        others = float((0.5 * size.log()).std()) * math.sqrt(1.0 + 1.0 / len(size))
    middle = (torch.arange(SCALES, dtype=torch.float64) + 0.5) / SCALES
    scales = (others * torch.special.ndtri(middle)).exp()
    scaled = (scales.view(-1, 1, 1, 1) * least.sqrt()).flatten(0, 1)
    return _quantile(scaled, weight.repeat(SCALES), LEVEL)


def _quantile(
    values: Float[Tensor, "rows nodes n"], weight: Float[Tensor, " rows"], level: float
) -> Float[Tensor, "nodes n"]:
    """Return the weighted quantile over rows; at nodes without values that of the last with one."""
    there = values.isfinite()
    ordered, order = values.where(there, torch.inf).sort(0)
    share = (weight.view(-1, 1, 1) * there).gather(0, order).cumsum(0)
    at = (share < level * share[-1]).sum(0, keepdim=True).clamp_max(len(values) - 1)
    found = ordered.gather(0, at)[0]
    for k in range(1, len(found)):
        found[k] = found[k].where(found[k].isfinite(), found[k - 1])
    return found.nan_to_num(0.0, 0.0)


def _predicted(model: DynamicsModel, windows: PredictionWindows) -> Predictions:
    return predict(model, windows, model.input_matrix, model.coordinates.sizes)


def interval_of(model: DynamicsModel, posterior: ModelPosterior, found: Predictions) -> Interval:
    """Return the 90 % interval of predicted windows about the prediction."""
    about = variance(model.flow, posterior, *_rolled(model, found), ROLLOUTS).double().cpu()
    width = quantile(LEVEL) * about.sqrt()
    return Interval(found.q - width, found.q + width)


def coverage(found: Predictions, interval: Interval) -> dict[str, float]:
    """Return ``coverage_90_<T>s`` and ``width_90_<T>s`` [rad, m].

    They are the share of measured configurations inside the interval and its median half width,
    over windows, coordinates and time to T.
    """
    true = found.q_true
    inside = ((true >= interval.lower) & (true <= interval.upper)).double()
    inside = inside.where(true.isfinite(), torch.nan)
    half = (0.5 * (interval.upper - interval.lower)).where(true.isfinite(), torch.nan)
    measures = {}
    for seconds in HORIZONS:
        until = slice(1, 1 + steps_in(seconds, found.time_step))
        name = f"{100 * LEVEL:.0f}_{seconds:g}s"
        measures[f"coverage_{name}"] = inside[:, until].nanmean().item()
        measures[f"width_{name}"] = half[:, until].nanmedian().item()
    return measures


def _rolled(model: DynamicsModel, found: Predictions) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return starts, inputs and rollouts of predicted windows, where the model works."""
    u = found.windows.u[:, found.windows.lead :]
    fields = found.q[:, 0], found.v[:, 0], u, found.q
    q, v, u, middle = (x.to(model.input_matrix) for x in fields)
    return q, v, u, middle
