"""Forces of a system that a model of it cannot learn."""

from __future__ import annotations

import math
from collections.abc import Iterator

import torch
from jaxtyping import Float
from torch import Tensor

from symo_exp.mechanics.dissipation import DissipativeLagrangian
from symo_exp.mechanics.lagrangian import Lagrangian
from symo_exp.mechanics.types import Coordinates
from symo_exp.models.base import DynamicsModel
from symo_exp.nets.springs import LinearSprings
from symo_exp.systems.base import System

WINDING = 1e-3
"""Change of a potential with a whole turn, relative to its range, that springs on angles cause."""
ROUNDING = 1e-6
"""Differences of potentials and forces, relative to their size, that are due to rounding."""


def unlearned_forces(model: DynamicsModel, system: System) -> Iterator[str]:
    """Yield a line for each kind of force that the system has and the model cannot learn."""
    if not model.learns or model.lagrangian is None:
        return
    if system.dissipation is not None and model.dissipation is None:
        yield (
            "the system loses energy and dissipation=none learns no friction: "
            "give dissipation=viscous, friction or drag"
        )
    if system.lagrangian is None:
        return
    q, _, u = system.points(8, seed=0)
    own = _by_matrix(system.lagrangian, system, q, u)
    if _by_matrix(model.lagrangian, system, q, u) and not own:
        yield (
            "the system has a method input_force, and the model learns with the constant input "
            "matrix: give lagrangian=known or model=node"
        )
    if any(isinstance(module, LinearSprings) for module in model.modules()):
        return
    winds = [_winds(x, system.coordinates, q) for x in (system.lagrangian, model.lagrangian)]
    if winds == [True, False]:
        yield (
            "the system has springs on angles, and models that are periodic in angles learn none: "
            "give springs=linear"
        )


@torch.no_grad()
def _by_matrix(
    lagrangian: Lagrangian, system: System, q: Float[Tensor, "batch N"], u: Float[Tensor, "batch m"]
) -> bool:
    """Return whether the forces of inputs are those of the input matrix of the coordinates."""
    given = [x.to(torch.get_default_dtype()) for x in (system.input_matrix, q, u)]
    found, plain = (x.input_force(*given) for x in (lagrangian, system.coordinates))
    return bool((found - plain).abs().max() <= ROUNDING * plain.abs().max())


@torch.no_grad()
def _winds(lagrangian: Lagrangian, coordinates: Coordinates, q: Float[Tensor, "batch N"]) -> bool:
    """Return whether the potential changes with a whole turn of all angles."""
    if isinstance(lagrangian, DissipativeLagrangian):
        lagrangian = lagrangian.conservative
    angles = torch.tensor(coordinates.angular[: len(coordinates.flat)])
    start = q.to(torch.get_default_dtype())
    end = start.clone()
    end[:, : len(angles)] += 2.0 * math.pi * angles
    before, after = lagrangian.potential(start), lagrangian.potential(end)
    spread = before.max() - before.min() + ROUNDING * before.abs().max()
    return bool((after - before).abs().max() > WINDING * spread)
