"""What the methods share that learn a Lagrangian."""

from __future__ import annotations

from typing import Any

from symo_exp.mechanics.lagrangian import Lagrangian
from symo_exp.models.base import DynamicsModel
from symo_exp.nets.structured_lagrangian import StructuredLagrangian


class LearnsLagrangian(DynamicsModel):
    """A method with ``ℒ = ½ vᵀ H(q) v − V(q)``, ``H`` and ``V`` from one network."""

    _lagrangian: Lagrangian

    def __init__(
        self, *, width: int, depth: int = 2, initial_inertia: float | None = 1.0, **base: Any
    ) -> None:
        super().__init__(**base)
        self._lagrangian = StructuredLagrangian(
            angular=self.coordinates.angular,
            width=width,
            depth=depth,
            initial_inertia=initial_inertia,
        )

    @property
    def lagrangian(self) -> Lagrangian:
        return self._lagrangian
