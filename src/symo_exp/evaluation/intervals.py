"""Intervals of predicted recordings: widened by held-out errors, and how much they cover."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from symo_exp.evaluation.horizon import HORIZONS, Predictions, cut, predict
from symo_exp.mechanics.types import Trajectory
from symo_exp.models.base import DynamicsModel
from symo_exp.models.uncertainty import Interval, ModelPosterior, extended, quantile, spread
from symo_exp.optim.posterior import Posterior

LEVEL = 0.9
"""Probability of the intervals whose coverage is measured."""
BISECTIONS = 40
ROLLOUTS = 12
"""Number behind the intervals of all windows, whose time is that of evaluations."""


def widened(
    model: DynamicsModel, posterior: Posterior, trajectories: Sequence[Trajectory]
) -> ModelPosterior:
    """Return the posterior with the error beyond it that held-out motions show.

    Intervals of the parameters alone are widened, ``√(σ² + κ² m²)`` with ``m`` the root mean square
    error of held-out windows up to each node, by the least ``κ`` with which they hold 90 % of these
    windows. Without windows, or where the parameters explain the errors, there is no such error.

    Args:
        model: The model, in float64.
        posterior: Posterior of its parameters.
        trajectories: Motions that it was not trained on.
    """
    windows = cut(trajectories, model.time_step, run_in=True) if trajectories else None
    if windows is None:
        return ModelPosterior(posterior)
    found = predict(model, windows, model.time_step, model.input_matrix)
    variance = _variance(model, posterior, found)
    error = (found.q - found.q_true).square()
    error = error.where(found.q.isfinite() | error.isnan(), torch.nan)
    mean = error.nanmean(0).nan_to_num(0.0).cummax(0).values
    low, high = 0.0, 100.0
    if _share(error, variance) >= LEVEL:
        return ModelPosterior(posterior)
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        if _share(error, variance + middle**2 * mean) >= LEVEL:
            high = middle
        else:
            low = middle
    return ModelPosterior(posterior, high * mean.sqrt())


def interval_of(model: DynamicsModel, posterior: ModelPosterior, found: Predictions) -> Interval:
    """Return the 90 % interval of predicted windows about the prediction."""
    variance = _variance(model, posterior.parameters, found)
    if posterior.error is not None:
        variance = variance + extended(posterior.error, found.q.shape[1]).square()
    width = quantile(LEVEL) * variance.sqrt()
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
        until = slice(1, 1 + max(1, round(seconds / found.time_step)))
        name = f"{100 * LEVEL:.0f}_{seconds:g}s"
        measures[f"coverage_{name}"] = inside[:, until].nanmean().item()
        measures[f"width_{name}"] = half[:, until].nanmedian().item()
    return measures


def _variance(
    model: DynamicsModel, posterior: Posterior, found: Predictions
) -> Float[Tensor, "windows nodes n"]:
    """Return the variance of the windows' rollouts from their starts under the posterior."""
    place = model.input_matrix
    q, v = found.q[:, 0].to(place), found.v[:, 0].to(place)
    u = found.windows.u[:, found.windows.lead :].to(place)
    return spread(model.flow, posterior, q, v, u, found.q.to(place), ROLLOUTS).double().cpu()


def _share(error: Tensor, variance: Tensor) -> float:
    """Share of measured nodes after the first within the interval of 90 %."""
    inside = (error <= quantile(LEVEL) ** 2 * variance).double()
    return inside.where(error.isfinite(), torch.nan)[:, 1:].nanmean().item()
