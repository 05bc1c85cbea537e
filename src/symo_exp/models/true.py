"""The truth as a model: its error is that of the integrator alone, a floor of learning.

The Lagrangian is handed in; nothing is trained. Two classes, since a variational integrator and
a Runge-Kutta method, be they both called midpoint, are different maps with different floors.
"""

from typing import Any

from torch import Tensor

from symo_exp.mechanics.euler_lagrange import acceleration, generalised_force
from symo_exp.mechanics.lagrangian import Lagrangian
from symo_exp.mechanics.types import Windows
from symo_exp.models.ode import OdeModel
from symo_exp.models.variational import VariationalModel


class TrueVariational(VariationalModel):
    """A given Lagrangian in a variational integrator: what SyMo and E2E-SyMo would best be."""

    def __init__(self, *, lagrangian: Lagrangian, width: int | None = None, **base: Any) -> None:
        """``width`` is that of a net, which a system sets for all models; there is none here."""
        super().__init__(**base)
        self._lagrangian = lagrangian

    def residuals(self, windows: Windows) -> Tensor:
        """``g(q_{k−1}, q_k, q_{k+1})`` at the data: what a perfect SyMo would be left with."""
        return self.del_residuals(windows)


class TrueOde(OdeModel):
    """A given Lagrangian in a Runge-Kutta method: what L-NODE, and NODE, would best be."""

    def __init__(self, *, lagrangian: Lagrangian, width: int | None = None, **base: Any) -> None:
        """``width`` is that of a net, which a system sets for all models; there is none here."""
        super().__init__(**base)
        self._lagrangian = lagrangian

    @property
    def lagrangian(self) -> Lagrangian:
        return self._lagrangian

    def acceleration(self, q: Tensor, v: Tensor, u: Tensor) -> Tensor:
        return acceleration(self._lagrangian, q, v, generalised_force(self.input_matrix, u))
