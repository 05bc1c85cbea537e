"""The Lagrangian that L-NODE, SyMo and E2E-SyMo learn."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from symo_exp.mechanics.dissipation import Dissipation, DissipativeLagrangian
from symo_exp.mechanics.lagrangian import Lagrangian
from symo_exp.mechanics.types import Coordinates
from symo_exp.nets.springs import LinearSprings, SprungLagrangian


@runtime_checkable
class MakesLagrangian(Protocol):
    """A factory of Lagrangians to be learned (``conf/lagrangian``)."""

    def __call__(self, *, coordinates: Coordinates) -> Lagrangian:
        """Return a new Lagrangian of these coordinates."""


@runtime_checkable
class MakesDissipation(Protocol):
    """A factory of dissipations to be learned (``conf/dissipation``)."""

    def __call__(self, *, coordinates: Coordinates) -> Dissipation:
        """Return a new dissipation of these coordinates."""


@runtime_checkable
class MakesSprings(Protocol):
    """A factory of springs to be learned (``conf/springs``)."""

    def __call__(self, *, coordinates: Coordinates) -> LinearSprings:
        """Return new springs of these coordinates."""


def learned_lagrangian(
    coordinates: Coordinates,
    lagrangian: MakesLagrangian,
    dissipation: MakesDissipation | None,
    springs: MakesSprings | None,
) -> Lagrangian:
    """Return a new Lagrangian, with springs and a dissipation if there are factories of them."""
    conservative = lagrangian(coordinates=coordinates)
    if springs is not None:
        conservative = SprungLagrangian(conservative, springs(coordinates=coordinates))
    if dissipation is None:
        return conservative
    return DissipativeLagrangian(conservative, dissipation(coordinates=coordinates))
