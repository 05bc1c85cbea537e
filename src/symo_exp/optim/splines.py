"""Smoothing splines through measured trajectories, the start of total least squares."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Float
from scipy.interpolate import make_smoothing_spline
from torch import Tensor

from symo_exp.mechanics.types import Trajectory


def smoothed(trajectories: Sequence[Trajectory], velocities: bool) -> Float[Tensor, "nodes d"]:
    """Return every coordinate smoothed by a spline, by generalised cross-validation."""
    return torch.cat([_splines(t, velocities) for t in trajectories])


def _splines(trajectory: Trajectory, velocities: bool) -> Tensor:
    y = torch.cat((trajectory.q, trajectory.v), dim=1) if velocities else trajectory.q
    if len(y) < 6:  # fewer than a spline needs
        return y.double().clone()
    time = torch.arange(len(y)).double().numpy()
    columns = [make_smoothing_spline(time, c)(time) for c in y.double().T.numpy()]
    return torch.stack([torch.as_tensor(c) for c in columns], dim=1)
