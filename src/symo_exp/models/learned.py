"""The Lagrangian that L-NODE, SyMo and E2E-SyMo learn."""

from __future__ import annotations

from typing import Any, Protocol, TypeVar, runtime_checkable

import torch
from torch import Tensor, nn

from symo_exp.checks import instance
from symo_exp.errors import ConfigError
from symo_exp.mechanics.dissipation import Dissipation, DissipativeLagrangian
from symo_exp.mechanics.lagrangian import Lagrangian, evaluated
from symo_exp.mechanics.returned import checked_tensor, returned
from symo_exp.mechanics.scaled import ScaledDissipation, ScaledLagrangian
from symo_exp.mechanics.types import Coordinates
from symo_exp.mechanics.units import SI
from symo_exp.nets.springs import LinearSprings, SprungLagrangian

ROUNDING = 1e-5
"""Relative differences that are due to single precision."""
Part = TypeVar("Part", covariant=True)


@runtime_checkable
class Makes(Protocol[Part]):
    """A factory: ``conf/lagrangian``, ``conf/dissipation`` or ``conf/springs``."""

    def __call__(self, *, coordinates: Coordinates) -> Part:
        """Return a new one for these coordinates."""


MakesLagrangian = Makes[Lagrangian]
MakesDissipation = Makes[Dissipation]
MakesSprings = Makes[LinearSprings]


def learned_lagrangian(
    coordinates: Coordinates,
    lagrangian: MakesLagrangian,
    dissipation: MakesDissipation | None,
    springs: MakesSprings | None,
) -> Lagrangian:
    """Return a new Lagrangian, with springs and a dissipation if there are factories of them.

    Raises:
        ConfigError: If one of them is a class of a user that cannot be learned.
    """
    scaled, plain = coordinates.units != SI, coordinates._replace(units=SI)
    conservative = lagrangian(coordinates=plain)
    _check(conservative, plain)
    if springs is not None:
        made = springs(coordinates=plain)
        instance("springs", made, LinearSprings)
        conservative = SprungLagrangian(conservative, made)
    if scaled:
        conservative = ScaledLagrangian(conservative, coordinates)
    if dissipation is None:
        return conservative
    friction = dissipation(coordinates=plain)
    _check_dissipation(friction, plain)
    if scaled:
        friction = ScaledDissipation(friction, coordinates)
    return DissipativeLagrangian(conservative, friction)


def _check(lagrangian: object, coordinates: Coordinates) -> None:
    """Refuse a Lagrangian that has no parameters to train, or terms that cannot be right."""
    kind, space, n = type(lagrangian).__name__, coordinates.space, coordinates.n
    if not isinstance(lagrangian, nn.Module) or not isinstance(lagrangian, Lagrangian):
        raise ConfigError(
            f"lagrangian: {kind} has to inherit from torch.nn.Module and "
            f"{Lagrangian.__module__}.Lagrangian"
        )
    if lagrangian.space != space:
        raise ConfigError(
            f"lagrangian: {kind}.space is {lagrangian.space}, and that of the system is {space}; "
            "define a property space that returns coordinates.space"
        )
    if not any(True for _ in lagrangian.parameters()):
        raise ConfigError(
            f"lagrangian: {kind} has no parameters to train; assign them as torch.nn.Parameter"
        )
    with torch.no_grad():
        mass = evaluated(lagrangian, space.of_vector(_points(n)), n)["mass_matrix"]
    if (mass - mass.mT).abs().max() > ROUNDING * mass.abs().max():
        raise ConfigError(f"{kind}.mass_matrix(q) is not symmetric")


def _check_dissipation(dissipation: Any, coordinates: Coordinates) -> None:
    """Refuse a dissipation whose force has a wrong shape, or adds energy."""
    instance("dissipation", dissipation, Dissipation)
    v = _points(coordinates.n)
    told = f"{type(dissipation).__name__}.force(q, v)"
    with torch.no_grad():
        found = returned(told, dissipation.force, coordinates.space.of_vector(v), v)
    checked_tensor(told, found, tuple(v.shape), v.dtype, f"v of shape {tuple(v.shape)}")
    if (v * found).sum(1).max() > ROUNDING * found.abs().max():
        raise ConfigError(f"{told} adds energy: expected v * force <= 0, summed over coordinates")


def _points(n: int) -> Tensor:
    """Return rows of numbers around zero; there are more rows than columns."""
    return torch.linspace(-1.0, 1.0, (n + 2) * n).view(n + 2, n)
