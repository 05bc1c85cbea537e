"""E2E-SyMo: a SyMo trained through its root finding (thesis section 5.2)."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from symo_exp.mechanics.lagrangian import solve
from symo_exp.mechanics.roots import Newton, rounding, row_norm
from symo_exp.mechanics.types import Windows
from symo_exp.mechanics.variational import Forces, MomentumMatching, differentiable_pose
from symo_exp.models.compiled import Program
from symo_exp.models.learned import LearnsLagrangian
from symo_exp.models.variational import VariationalModel


class E2ESyMo(LearnsLagrangian, VariationalModel):
    """Trains on the error of the root, differentiated by the implicit function theorem.

    A row whose root is not found has no implicit gradient. With ``fallback`` its residual is the
    preconditioned one, ``h H⁻¹ g``: the error of the root to first order. Without it the last
    iterate is taken for a root, as in the thesis.
    """

    def __init__(self, *, fallback: bool = True, **base: Any) -> None:
        super().__init__(**base)
        self.fallback = fallback

    def residuals(self, windows: Windows) -> Tensor:
        """``q*_{k+1} − q_{k+1}`` (thesis (5.28))."""
        impulse, forces = self._impulse(windows), self._forces(windows)
        guess = 2.0 * windows.q - windows.q_prev
        root = self.root.solve(self._problem(windows, impulse), guess)
        self._count("newton_iterations", root.iterations.float().mean())
        self._count("newton_failed", (~root.converged).float().mean())
        if not self.fallback or bool(root.converged.all()):
            pose = differentiable_pose(root.x, root.evaluation, windows.q, impulse, forces)
            return pose - windows.q_next
        found, lost = (rows.nonzero().squeeze(-1) for rows in (root.converged, ~root.converged))
        pose = differentiable_pose(
            root.x[found],
            root.evaluation.rows(found),
            windows.q[found],
            impulse[found],
            forces.rows(found),
        )
        error = torch.zeros_like(windows.q).index_copy(0, found, pose - windows.q_next[found])
        return error.index_copy(0, lost, self.preconditioned_residuals(windows.rows(lost)))

    def _forces(self, windows: Windows) -> Forces:
        """The generalised forces at nodes ``k`` and ``k+1``."""
        return Forces(self._force(windows.u, windows.q), self._force(windows.u_next, windows.q))

    def _impulse(self, windows: Windows) -> Tensor:
        """``p_k + f⁻``: what does not depend on the next pose."""
        f_minus, _ = self.integrator.impulses(*self._forces(windows), self.time_step)
        return self._momentum_before(windows) + f_minus

    def _problem(self, windows: Windows, impulse: Tensor) -> MomentumMatching:
        forces = self._forces(windows)
        return MomentumMatching(
            self.integrator, self._lagrangian, windows.q, impulse, self.time_step, forces
        )

    @property
    def can_be_compiled(self) -> bool:
        """Where roots are found by Newton's method row by row, as the compiled iteration does."""
        by_row = isinstance(self.root, Newton) and self.root.stopping == "row"
        return by_row and super().can_be_compiled

    def compile_training(self) -> None:
        self._program = CompiledRootLoss(self)


class CompiledRootLoss:
    """Loss and gradients of E2E-SyMo in three compiled pieces around the iteration.

    Newton's method converges quadratically, ``‖g⁺‖ ≈ C ‖g‖²`` with a ``C`` that the last step has
    told (1 before there is one). Once one more step must make every row a root it is taken unseen,
    and the last piece, which needs the residuals anyhow, checks them. A batch with a row for which
    this goes on failing is left to the uncompiled path with its safeguards. The choice depends on
    the numbers of the batch alone, so that a resumed run repeats it.
    """

    def __init__(self, model: E2ESyMo) -> None:
        self._model = model
        self._start = Program(model, self._first_step, gradients=False)
        self._iterate = Program(model, self._newton_step, gradients=False)
        self._finish = Program(model, self._loss_at, gradients=True)

    def __call__(self, windows: Windows) -> tuple[Tensor, Any, Any]:
        model = self._model
        tolerance = model.root.tolerance
        impulse, x, worst = self._start(windows)
        norm, contraction = worst.item(), 1.0
        for iteration in range(1, min(model.root.max_iterations, 5) + 1):
            if contraction * norm**2 <= tolerance:
                loss, converged, gradients = self._finish(windows, x)
                if converged.item():
                    model._count("newton_iterations", loss.new_tensor(float(iteration)))
                    model._count("newton_failed", loss.new_tensor(0.0))
                    return loss, (), gradients
            x, worst = self._iterate(windows, impulse, x)
            before, norm = norm, worst.item()
            contraction = norm / max(before, tolerance) ** 2
        model.zero_grad()
        loss = model.loss(windows)
        return loss.detach(), (), torch.autograd.grad(loss, list(model.parameters()))

    def _first_step(self, windows: Windows) -> tuple[Tensor, Tensor, Tensor]:
        impulse = self._model._impulse(windows)
        x, worst = self._newton_step(windows, impulse, 2.0 * windows.q - windows.q_prev)
        return impulse, x, worst

    def _newton_step(self, windows: Windows, impulse: Tensor, x: Tensor) -> tuple[Tensor, Tensor]:
        at = self._model._problem(windows, impulse).at(x)
        return x + solve(at.jacobian(), -at.residual), row_norm(at.residual).amax()

    def _loss_at(self, windows: Windows, x: Tensor) -> tuple[Tensor, Tensor]:
        model = self._model
        impulse, forces = model._impulse(windows), model._forces(windows)
        at = self._model._problem(windows, impulse).at(x)
        pose = differentiable_pose(x, at, windows.q, impulse, forces)
        small = row_norm(at.residual) <= model.root.tolerance
        settled = ((pose - x).abs() <= rounding(x)).all(-1)
        return (pose - windows.q_next).square().mean(), (small | settled).all()
