"""E2E-SyMo: a SyMo trained through its root finding (thesis section 5.2)."""

from typing import Any

from torch import Tensor

from symo_exp.mechanics.types import Windows
from symo_exp.mechanics.variational import Forces, next_pose
from symo_exp.models.variational import VariationalModel


class E2ESyMo(VariationalModel):
    """Trains on the error of the root, differentiated by the implicit function theorem.

    A row whose root is not found has no implicit gradient. With ``fallback`` its residual is the
    first correction of Newton's method from the datum, ``h H⁻¹ g(q_{k+1})``, which is the error
    of the root to first order; without it the last iterate is taken for a root, as in the thesis.
    """

    def __init__(self, *, fallback: bool = True, **base: Any) -> None:
        super().__init__(**base)
        self.fallback = fallback

    def residuals(self, windows: Windows) -> Tensor:
        """``q*_{k+1} − q_{k+1}`` (thesis (5.28))."""
        force, force_next = (
            self._force(windows.u, windows.q),
            self._force(windows.u_next, windows.q),
        )
        f_minus, _ = self.integrator.impulses(force, force_next, self.time_step)
        pose, root = next_pose(
            self.integrator,
            self._lagrangian,
            self.root,
            windows.q,
            self._momentum_before(windows) + f_minus,
            self.time_step,
            guess=2.0 * windows.q - windows.q_prev,
            forces=Forces(force, force_next),
            fallback=windows.q_next if self.fallback else None,
        )
        self._count("newton_iterations", root.iterations.float().mean())
        self._count("newton_failed", (~root.converged).float().mean())
        return pose - windows.q_next
