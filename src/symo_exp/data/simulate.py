"""Trajectories of a known system from given starts."""

from __future__ import annotations

import torch

from symo_exp.data.draws import Starts
from symo_exp.mechanics.types import Trajectories
from symo_exp.systems.base import LagrangianSystem
from symo_exp.systems.simulation import Solver, simulate


def generate(
    system: LagrangianSystem,
    starts: Starts,
    *,
    steps: int,
    forced: bool,
    solver: Solver,
    lead: int = 0,
) -> Trajectories:
    """Return trajectories of ``steps + 1`` nodes, the first one ``lead`` steps after the start.

    Unforced trajectories have ``u = 0``.
    """
    u = starts.u if forced else torch.zeros_like(starts.u)
    path = simulate(system, system.space.of_vector(starts.q), starts.v, u, lead + steps, solver)
    return Trajectories(*(field[:, lead:].contiguous() for field in path))
