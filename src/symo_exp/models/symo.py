"""SyMo: a symplectic-momentum network (thesis section 5.1)."""

from typing import Any

from symo_exp.models.base import VariationalModel
from symo_exp.models.learned import LearnsLagrangian
from symo_exp.models.learner import Learner
from symo_exp.models.objectives import Objective, Residual


class SyMo(LearnsLagrangian, VariationalModel, Learner):
    """A learned Lagrangian in a variational integrator, trained on the violation of the discrete
    Euler-Lagrange equations at the data; it finds roots only to predict."""

    def __init__(self, *, objective: Objective | None = None, **base: Any) -> None:
        """``objective`` is one of a variational flow, ``Residual`` if left out."""
        super().__init__(objective or Residual(), **base)
