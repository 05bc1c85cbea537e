"""Trajectories of a known system from random initial states."""

from __future__ import annotations

import numpy as np
import torch

from symo_exp.mechanics.types import Trajectories
from symo_exp.systems.base import System
from symo_exp.systems.simulation import Solver, simulate


def generate(
    system: System,
    *,
    count: int,
    steps: int,
    forced: bool,
    solver: Solver,
    seed: int | tuple[int, ...],
) -> Trajectories:
    """``count`` trajectories from uniform draws of the system's box; the first are always the same.

    An unforced trajectory has ``u = 0``.
    """
    box = np.array([*system.sampling_box.q, *system.sampling_box.v, *system.sampling_box.u])
    draws = np.random.default_rng(seed).uniform(box[:, 0], box[:, 1], size=(count, len(box)))
    n = system.coordinates.n
    q0, v0, u = (torch.from_numpy(part) for part in np.split(draws, [n, 2 * n], axis=1))
    return simulate(system, q0, v0, u if forced else torch.zeros_like(u), steps, solver)
