"""SyMo: a symplectic-momentum network (thesis section 5.1)."""

from torch import Tensor

from symo_exp.mechanics.types import Windows
from symo_exp.mechanics.variational import del_residual
from symo_exp.models.variational import VariationalModel


class SyMo(VariationalModel):
    """Trains on the violation of the discrete Euler-Lagrange equations; finds roots to predict."""

    def residuals(self, windows: Windows) -> Tensor:
        """``g(q_{k−1}, q_k, q_{k+1})`` at the data [N s] (thesis (5.20))."""
        return del_residual(
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
