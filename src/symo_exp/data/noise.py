"""Measurement noise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from symo_exp.mechanics.space import space_of
from symo_exp.mechanics.types import Trajectory


def add_noise(
    trajectories: Sequence[Trajectory],
    std: float,
    seed: int | Sequence[int],
    input_std: float = 0.0,
) -> list[Trajectory]:
    """Return ``q + σ z``, ``v + σ z'`` and ``u + σ_u z''``, all z independent standard normal.

    The draws of a trajectory depend on the seed and on those before it only, so that they are the
    same in smaller sets and scale with σ. A rotation turns by the rotation vector ``σ z``.

    Args:
        trajectories: The clean trajectories.
        std: σ, in the units of configurations and of velocities.
        seed: Seed of the noise.
        input_std: σ_u, for measured inputs; commanded ones are clean.
    """
    if std == 0 and input_std == 0:
        return list(trajectories)
    sequence = np.random.SeedSequence(seed)
    of_state, of_input = (np.random.default_rng(s) for s in (sequence, *sequence.spawn(1)))
    noisy = []
    for q, v, u in trajectories:
        nodes, n = v.shape
        moved = space_of(q, v).retract
        z = torch.from_numpy(of_state.standard_normal((nodes, 2, n)))
        z_u = torch.from_numpy(of_input.standard_normal(tuple(u.shape)))
        noisy.append(
            Trajectory(
                moved(q, std * z[:, 0].to(q)), v + std * z[:, 1].to(v), u + input_std * z_u.to(u)
            )
        )
    return noisy
