"""L-NODE: a neural ordinary differential equation through the Euler-Lagrange equations."""

from typing import Any

from torch import Tensor

from symo_exp.mechanics.euler_lagrange import acceleration, generalised_force
from symo_exp.models.ode import OdeModel
from symo_exp.nets.structured_lagrangian import StructuredLagrangian


class LNODE(OdeModel):
    """``v̇ = H⁻¹ (B u − Ḣ v + ℒ_q)`` of a learned Lagrangian (thesis section 4.3.4)."""

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
    def lagrangian(self) -> StructuredLagrangian:
        return self._lagrangian

    def acceleration(self, q: Tensor, v: Tensor, u: Tensor) -> Tensor:
        return acceleration(self._lagrangian, q, v, generalised_force(self.input_matrix, u))
