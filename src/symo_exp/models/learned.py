"""The Lagrangian that L-NODE, SyMo and E2E-SyMo learn."""

from __future__ import annotations

from typing import Any, Protocol

from symo_exp.mechanics.dissipation import Dissipation, DissipativeLagrangian
from symo_exp.mechanics.lagrangian import Lagrangian
from symo_exp.mechanics.types import Coordinates
from symo_exp.models.base import DynamicsModel
from symo_exp.models.objectives import Objective
from symo_exp.nets.structured_lagrangian import StructuredLagrangian


class MakesDissipation(Protocol):
    """A dissipation of some coordinates, to be learned (``conf/dissipation``)."""

    def __call__(self, *, coordinates: Coordinates) -> Dissipation: ...


class LearnsLagrangian(DynamicsModel):
    """Networks for inertia and potential, and a dissipation where one is to be learned, for the
    class beside it, which makes a flow of a Lagrangian."""

    def __init__(
        self,
        objective: Objective,
        /,
        *,
        coordinates: Coordinates,
        width: int,
        depth: int = 2,
        initial_inertia: float | None = 1.0,
        harmonics: int = 0,
        dissipation: MakesDissipation | None = None,
        **base: Any,
    ) -> None:
        lagrangian: Lagrangian = StructuredLagrangian(
            angular=coordinates.angular,
            width=width,
            depth=depth,
            initial_inertia=initial_inertia,
            harmonics=harmonics,
        )
        if dissipation is not None:
            lagrangian = DissipativeLagrangian(lagrangian, dissipation(coordinates=coordinates))
        super().__init__(lagrangian, objective, coordinates=coordinates, **base)  # type: ignore
