"""The posterior of a trained model."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

from symo_exp.evaluation.intervals import Predicted, widened
from symo_exp.mechanics.types import Trajectory, Windows
from symo_exp.models.base import DynamicsModel
from symo_exp.models.uncertainty import ModelPosterior
from symo_exp.optim.posterior import posterior

log = logging.getLogger(__name__)

LARGEST = 40_000_000
"""Entries of the derivatives of all residuals in all parameters, 320 MB."""


def posterior_of(
    model: DynamicsModel,
    residuals: Callable[[Windows], Tensor],
    estimate: Mapping[str, Any] | None,
    train: Sequence[Trajectory],
    recordings: Sequence[Predicted],
) -> ModelPosterior | None:
    """Return the posterior of a model's parameters; ``None`` where it was not estimated so.

    Args:
        model: The trained model.
        residuals: Residuals that training made small.
        estimate: How: ``EpochOptimizer.estimate()``.
        train: Trajectories that it was trained on.
        recordings: Recordings whose errors widen intervals, and the models that predict them.
    """
    parameters = list(model.parameters())
    if estimate is None or any(p.dtype != torch.float64 for p in parameters):
        return None
    size = sum(p.numel() for p in parameters)
    entries = size * sum(one.q.numel() for one in train)
    if entries > LARGEST:
        log.info(
            "no posterior: %d parameters and %d configurations are too many", size, entries // size
        )
        return None
    with torch.random.fork_rng(devices=[]):
        found = posterior(
            residuals, parameters, train,
            velocities=model.reads_velocity, sizes=model.coordinates.sizes, **estimate,
        )  # fmt: skip
        if found is None:
            log.info("no posterior: the derivatives of the residuals are not finite")
            return None
        flat = not model.coordinates.space.rotations  # intervals are of lengths and angles
        whole = widened(model.for_evaluation(), found, recordings if flat else ())
    if whole.relative_error is not None:
        sizes = whole.relative_error.square().mean(1).sqrt()
        log.info(
            "intervals are widened by at most %.2g times the sensitivity to the start, after "
            "%.2g s (root mean square over coordinates): recordings deviate more than the "
            "posterior explains", sizes.max().item(), sizes.argmax().item() * model.time_step,
        )  # fmt: skip
    return whole
