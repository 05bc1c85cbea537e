"""SyMo: a symplectic-momentum network (thesis section 5.1)."""

from typing import Any, Literal

from torch import Tensor

from symo_exp.mechanics.lagrangian import solve
from symo_exp.mechanics.types import Windows
from symo_exp.mechanics.variational import del_residual
from symo_exp.models.variational import VariationalModel


class SyMo(VariationalModel):
    """Trains on the violation of the discrete Euler-Lagrange equations; finds roots to predict.

    ``objective="plain"`` is the residual ``g`` itself [N s], as in the thesis. It scales with the
    learned inertia, so that under noise ``H → 0`` solves it. ``objective="preconditioned"`` is
    ``h H⁻¹ g`` [m or rad] with ``H`` at the midpoint of the second interval,
    ``(q_k + q_{k+1})/2``: the correction of the datum ``q_{k+1}`` by one Newton step with the
    Jacobian's limit ``−H/h``, which is the error of E2E-SyMo's root to first order in ``h`` and in
    itself. ``H`` is differentiated like everything else; held fixed it would leave the trivial
    solution in place.
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
        g = del_residual(
            self.integrator,
            self._lagrangian,
            windows.q_prev,
            windows.q,
            windows.q_next,
            self._force(windows.u_prev, windows.q),
            self._force(windows.u, windows.q),
            self._force(windows.u_next, windows.q),
            self.time_step,
        )
        if self.objective == "plain":
            return g
        mass = self._lagrangian.mass_matrix(0.5 * (windows.q + windows.q_next))
        return self.time_step * solve(mass, g)
