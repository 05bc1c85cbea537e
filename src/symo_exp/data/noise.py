"""Measurement noise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from symo_exp.mechanics.types import Trajectories


def add_noise(trajectories: Trajectories, std: float, seed: int | Sequence[int]) -> Trajectories:
    """``q + σ z`` and ``v + σ z'`` with independent standard normal z at every node.

    σ has the unit of what it is added to. Controls are commanded, not measured: they stay clean.
    The draws of a trajectory depend on the seed and its position only, so they are the same in
    smaller sets and scale with σ.
    """
    if std == 0:
        return trajectories
    z = torch.from_numpy(
        np.random.default_rng(seed).standard_normal(
            (*trajectories.q.shape[:2], 2, trajectories.q.shape[2])
        )
    )
    q, v = trajectories.q, trajectories.v
    return trajectories._replace(q=q + std * z[:, :, 0].to(q), v=v + std * z[:, :, 1].to(v))
