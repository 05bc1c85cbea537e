"""Smoothing splines through measured trajectories, the start of total least squares."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Float
from scipy.interpolate import make_smoothing_spline
from torch import Tensor

from symo_exp.mechanics.space import space_of
from symo_exp.mechanics.types import Trajectory


def smoothed(trajectories: Sequence[Trajectory], velocities: bool) -> Float[Tensor, "nodes d"]:
    """Return every coordinate smoothed by a spline, by generalised cross-validation.

    Rotations are smoothed by their entries; the result has the coordinates of the nearest rotation
    in the chart at the measured one.
    """
    return torch.cat([_smoothed(t, velocities) for t in trajectories])


def _smoothed(trajectory: Trajectory, velocities: bool) -> Tensor:
    q, v = trajectory.q.double(), trajectory.v.double()
    space = space_of(q, v)
    y = _splines(torch.cat((q, v), dim=1) if velocities else q)
    near = space.normalised(y[:, : q.shape[1]])
    return torch.cat((space.chart(q, near), y[:, q.shape[1] :]), dim=1)


def _splines(y: Tensor) -> Tensor:
    if len(y) < 6:  # fewer than a spline needs
        return y.clone()
    time = torch.arange(len(y)).double().numpy()
    columns = [make_smoothing_spline(time, c)(time) for c in y.T.numpy()]
    return torch.stack([torch.as_tensor(c) for c in columns], dim=1)
