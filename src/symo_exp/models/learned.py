"""The Lagrangian that L-NODE, SyMo and E2E-SyMo learn."""

from __future__ import annotations

import copy
from typing import Protocol, TypeVar, runtime_checkable

from symo_exp.mechanics.dissipation import Dissipation, DissipativeLagrangian
from symo_exp.mechanics.lagrangian import Lagrangian
from symo_exp.mechanics.roots import RootFinder
from symo_exp.mechanics.scaled import ScaledDissipation, ScaledLagrangian
from symo_exp.mechanics.types import Coordinates
from symo_exp.mechanics.units import SI
from symo_exp.nets.springs import LinearSprings, SprungLagrangian

Root = TypeVar("Root", bound="RootFinder | None")


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
    scaled, plain = coordinates.units != SI, coordinates._replace(units=SI)
    conservative = lagrangian(coordinates=plain)
    if springs is not None:
        conservative = SprungLagrangian(conservative, springs(coordinates=plain))
    if scaled:
        conservative = ScaledLagrangian(conservative, coordinates)
    if dissipation is None:
        return conservative
    friction = dissipation(coordinates=plain)
    if scaled:
        friction = ScaledDissipation(friction, coordinates)
    return DissipativeLagrangian(conservative, friction)


def in_units(root: Root, coordinates: Coordinates) -> Root:
    """Return a root finder of momenta whose tolerances are in the units of the coordinates."""
    if root is None or coordinates.units == SI:
        return root
    momenta = coordinates.units.size("N m s") / coordinates.sizes
    found = copy.copy(root)
    found.tolerance = root.tolerance * float(momenta.min())
    found.sizes = tuple(coordinates.sizes.tolist())
    return found
