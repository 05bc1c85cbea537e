"""L-NODE: a neural ordinary differential equation through the Euler-Lagrange equations."""

from typing import Any

from symo_exp.models.base import LagrangianOde
from symo_exp.models.learned import LearnsLagrangian
from symo_exp.models.learner import Learner
from symo_exp.models.objectives import StateError


class LNODE(LearnsLagrangian, LagrangianOde, Learner):
    """``v̇ = H⁻¹ (B u − Ḣ v + ℒ_q)`` of a learned Lagrangian (thesis section 4.3.4); trained on the
    error of the next state."""

    def __init__(self, **base: Any) -> None:
        super().__init__(StateError(), **base)
