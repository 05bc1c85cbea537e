"""L-NODE: a neural ordinary differential equation through the Euler-Lagrange equations."""

from torch import Tensor

from symo_exp.mechanics.euler_lagrange import acceleration, generalised_force
from symo_exp.models.learned import LearnsLagrangian
from symo_exp.models.ode import OdeModel


class LNODE(LearnsLagrangian, OdeModel):
    """``v̇ = H⁻¹ (B u − Ḣ v + ℒ_q)`` of a learned Lagrangian (thesis section 4.3.4)."""

    def acceleration(self, q: Tensor, v: Tensor, u: Tensor) -> Tensor:
        return acceleration(self._lagrangian, q, v, generalised_force(self.input_matrix, u))
