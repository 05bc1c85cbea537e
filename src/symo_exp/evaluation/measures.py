"""Mean squared errors and other measures, as functions of tensors.

``q̂`` is predicted and ``q`` true. A prediction that is not finite has an infinite error, which
makes every mean over it infinite.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

VALID_ERROR = 0.1
"""Error of a configuration [rad, m] up to which a prediction counts as valid."""


def squared(error: Tensor) -> Tensor:
    """Return the squares of errors, infinite where an error is not finite.

    Those of configurations are ``Space.difference(q, q̂)``: ``q̂ − q``, and of a rotation the vector
    by which the prediction is turned [rad]. Angles [rad] are not wrapped, lengths [m] weigh as much
    as angles (thesis section 6.2).
    """
    return error.square().nan_to_num(nan=math.inf, posinf=math.inf)


def mean_squared(error: Float[Tensor, "rows ..."]) -> Float[Tensor, " rows"]:
    """Return the mean square of each row, over all that it has: nodes, coordinates, entries.

    Rows are samples or trajectories, errors those of configurations, velocities, energies or
    inertias.
    """
    return squared(error).mean(tuple(range(1, error.ndim)))


def valid_steps(error: Float[Tensor, "trajectories steps n"]) -> Float[Tensor, " trajectories"]:
    """Return the steps until the error, RMS over coordinates, first exceeds 0.1 [rad, m].

    A rollout that stays within it counts with all its steps.
    """
    return steps_within(squared(error).mean(2).sqrt(), VALID_ERROR)


def steps_within(error: Float[Tensor, "rows steps"], most: float) -> Float[Tensor, " rows"]:
    """Return the steps before the error first exceeds a number or is not a number."""
    return (error <= most).cumprod(1).sum(1).double()


def mean_and_std(name: str, per_trajectory: Float[Tensor, " trajectories"]) -> dict[str, float]:
    """Return ``<name>_mse`` and ``<name>_std``, mean and population deviation over trajectories.

    One infinite error makes the mean infinite and leaves the deviation undefined (NaN).
    """
    deviation = torch.std(per_trajectory, correction=0)
    return {f"{name}_mse": per_trajectory.mean().item(), f"{name}_std": deviation.item()}
