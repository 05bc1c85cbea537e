"""Measurement noise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from symo_exp.mechanics.types import Trajectory


def add_noise(
    trajectories: Sequence[Trajectory], std: float, seed: int | Sequence[int]
) -> list[Trajectory]:
    """``q + σ z`` and ``v + σ z'`` with independent standard normal z at every node.

    σ has the unit of what it is added to. Controls are commanded, not measured: they stay clean.
    The draws of a trajectory depend on the seed and on those before it only, so they are the same
    in smaller sets and scale with σ.
    """
    if std == 0:
        return list(trajectories)
    generator = np.random.default_rng(seed)
    noisy = []
    for q, v, u in trajectories:
        nodes, n = q.shape
        z = torch.from_numpy(generator.standard_normal((nodes, 2, n)))
        noisy.append(Trajectory(q + std * z[:, 0].to(q), v + std * z[:, 1].to(v), u))
    return noisy
