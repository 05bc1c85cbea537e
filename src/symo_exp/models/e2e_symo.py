"""E2E-SyMo: a SyMo trained through its root finding (thesis section 5.2)."""

from __future__ import annotations

from typing import Any, Literal

import torch
from torch import Tensor

from symo_exp.mechanics.roots import Newton
from symo_exp.mechanics.types import Windows
from symo_exp.mechanics.variational import (
    DiscreteExpansion,
    Forces,
    MomentumMatching,
    differentiable_pose,
)
from symo_exp.models.compiled_root import CompiledRootLoss
from symo_exp.models.learned import LearnsLagrangian
from symo_exp.models.variational import VariationalModel


class E2ESyMo(LearnsLagrangian, VariationalModel):
    """Trains on the error of the root, differentiated by the implicit function theorem.

    In training the root is sought from the pose that it is to meet, ``guess="datum"``: the nearer
    the model is to the truth the fewer steps it takes, soon one. ``guess="inertial"``, uniform
    motion, is that of the thesis and of every prediction.

    A row whose root is not found has no implicit gradient. With ``fallback`` its residual is the
    preconditioned one, ``h H⁻¹ g``: the error of the root to first order. Without it the last
    iterate is taken for a root, as in the thesis.
    """

    def __init__(
        self,
        *,
        guess: Literal["datum", "inertial"] = "datum",
        fallback: bool = True,
        **base: Any,
    ) -> None:
        super().__init__(**base)
        if guess not in ("datum", "inertial"):
            raise ValueError(f"guess must be datum or inertial, got {guess}")
        self.guess, self.fallback = guess, fallback

    def residuals(self, windows: Windows) -> Tensor:
        """``q*_{k+1} − q_{k+1}`` (thesis (5.28))."""
        impulse, forces = self.impulse(windows, self.before(windows)), self.forces(windows)
        root = self.root.solve(self.problem(windows, impulse), self.initial_guess(windows))
        self._count("newton_iterations", root.iterations.float().mean())
        self._count("newton_failed", (~root.converged).float().mean())
        if not self.fallback or bool(root.converged.all()):
            after, jacobian = root.evaluation.expansion, root.evaluation.jacobian()
            pose = differentiable_pose(root.x, after, jacobian, windows.q, impulse, forces)
            return pose - windows.q_next
        found, lost = (rows.nonzero().squeeze(-1) for rows in (root.converged, ~root.converged))
        at = root.evaluation.rows(found)
        pose = differentiable_pose(
            root.x[found],
            at.expansion,
            at.jacobian(),
            windows.q[found],
            impulse[found],
            forces.rows(found),
        )
        error = torch.zeros_like(windows.q).index_copy(0, found, pose - windows.q_next[found])
        return error.index_copy(0, lost, self.preconditioned_residuals(windows.rows(lost)))

    def initial_guess(self, windows: Windows) -> Tensor:
        inertial = self.guess == "inertial"
        return 2.0 * windows.q - windows.q_prev if inertial else windows.q_next

    def forces(self, windows: Windows) -> Forces:
        """The generalised forces at nodes ``k`` and ``k+1``."""
        return Forces(self._force(windows.u, windows.q), self._force(windows.u_next, windows.q))

    def before(self, windows: Windows) -> DiscreteExpansion:
        """``L_d`` around ``(q_{k−1}, q_k)``."""
        forces = self._forces_before(windows)
        return self.integrator.expand(
            self._lagrangian, windows.q_prev, windows.q, self.time_step, forces
        )

    def impulse(self, windows: Windows, before: DiscreteExpansion) -> Tensor:
        """``p_k + f⁻``: what does not depend on the next pose."""
        f_minus, _ = self.integrator.impulses(*self.forces(windows), self.time_step)
        return self._momentum_before(windows, before) + f_minus

    def problem(self, windows: Windows, impulse: Tensor) -> MomentumMatching:
        forces = self.forces(windows)
        return MomentumMatching(
            self.integrator, self._lagrangian, windows.q, impulse, self.time_step, forces
        )

    @property
    def can_be_compiled(self) -> bool:
        """Where roots are found by Newton's method, as the compiled iteration does."""
        return isinstance(self.root, Newton) and super().can_be_compiled

    def _compiled_loss(self, *, gradients: bool) -> CompiledRootLoss:
        return CompiledRootLoss(self, gradients=gradients)
