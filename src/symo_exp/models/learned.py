"""The Lagrangian that L-NODE, SyMo and E2E-SyMo learn."""

from __future__ import annotations

from typing import Protocol

from symo_exp.mechanics.dissipation import Dissipation, DissipativeLagrangian
from symo_exp.mechanics.lagrangian import Lagrangian
from symo_exp.mechanics.types import Coordinates
from symo_exp.nets.structured_lagrangian import StructuredLagrangian


class MakesDissipation(Protocol):
    """A dissipation of some coordinates, to be learned (``conf/dissipation``)."""

    def __call__(self, *, coordinates: Coordinates) -> Dissipation: ...


def learned_lagrangian(
    coordinates: Coordinates,
    *,
    width: int,
    depth: int = 2,
    initial_inertia: float | None = 1.0,
    harmonics: int = 0,
    dissipation: MakesDissipation | None = None,
) -> Lagrangian:
    """A network for inertia and potential, and a dissipation where one is to be learned."""
    lagrangian = StructuredLagrangian(
        angular=coordinates.angular,
        width=width,
        depth=depth,
        initial_inertia=initial_inertia,
        harmonics=harmonics,
    )
    if dissipation is None:
        return lagrangian
    return DissipativeLagrangian(lagrangian, dissipation(coordinates=coordinates))
