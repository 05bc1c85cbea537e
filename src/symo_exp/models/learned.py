"""The Lagrangian that L-NODE, SyMo and E2E-SyMo learn."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from symo_exp.mechanics.dissipation import Dissipation, DissipativeLagrangian
from symo_exp.mechanics.lagrangian import Lagrangian
from symo_exp.mechanics.types import Coordinates


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


def learned_lagrangian(
    coordinates: Coordinates, lagrangian: MakesLagrangian, dissipation: MakesDissipation | None
) -> Lagrangian:
    """Return a new Lagrangian, with a dissipation if there is a factory of one."""
    conservative = lagrangian(coordinates=coordinates)
    if dissipation is None:
        return conservative
    return DissipativeLagrangian(conservative, dissipation(coordinates=coordinates))
