"""SyMo: a symplectic-momentum network (thesis section 5.1)."""

from typing import Any, Literal

from torch import Tensor

from symo_exp.mechanics.types import Windows
from symo_exp.models.learned import LearnsLagrangian
from symo_exp.models.variational import VariationalModel


class SyMo(LearnsLagrangian, VariationalModel):
    """Trains on the violation of the discrete Euler-Lagrange equations; finds roots to predict.

    ``objective="plain"`` is the residual ``g`` itself [N s], as in the thesis. It scales with the
    learned inertia, so that under noise ``H → 0`` solves it. ``objective="preconditioned"`` is
    ``h H⁻¹ g``, in the units of the coordinates.
    """

    def __init__(
        self, *, objective: Literal["plain", "preconditioned"] = "plain", **base: Any
    ) -> None:
        super().__init__(**base)
        if objective not in ("plain", "preconditioned"):
            raise ValueError(f"objective must be plain or preconditioned, got {objective}")
        self.objective = objective

    def residuals(self, windows: Windows) -> Tensor:
        """``g(q_{k−1}, q_k, q_{k+1})`` at the data (thesis (5.20)), perhaps preconditioned."""
        preconditioned = self.objective == "preconditioned"
        return (self.preconditioned_residuals if preconditioned else self.del_residuals)(windows)
