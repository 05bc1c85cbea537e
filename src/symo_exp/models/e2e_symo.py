"""E2E-SyMo: a SyMo trained through its root finding (thesis section 5.2)."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from symo_exp.mechanics.lagrangian import solve
from symo_exp.mechanics.roots import Given, Root, RootFinder, row_norm
from symo_exp.mechanics.types import Windows
from symo_exp.mechanics.variational import MomentumMatching, MomentumMismatch, next_pose
from symo_exp.models.compiled import Program
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
        fallback = windows.q_next if self.fallback else None
        guess = 2.0 * windows.q - windows.q_prev
        error, root = self._error_of_root(windows, self.root, guess, fallback)
        self._count("newton_iterations", root.iterations.float().mean())
        self._count("newton_failed", (~root.converged).float().mean())
        return error

    def compile_training(self) -> None:
        self._program = CompiledRootLoss(self)

    def _error_of_root(
        self, windows: Windows, finder: RootFinder, guess: Tensor, fallback: Tensor | None
    ) -> tuple[Tensor, Root[MomentumMismatch]]:
        pose, root = next_pose(
            self.integrator,
            self._lagrangian,
            finder,
            windows.q,
            self._impulse(windows),
            self.time_step,
            guess,
            fallback=fallback,
        )
        return pose - windows.q_next, root

    def _impulse(self, windows: Windows) -> Tensor:
        """``p_k + f⁻``: what does not depend on the next pose."""
        force = self._force(windows.u, windows.q)
        force_next = self._force(windows.u_next, windows.q)
        f_minus, _ = self.integrator.impulses(force, force_next, self.time_step)
        return self._momentum_before(windows) + f_minus


class CompiledRootLoss:
    """Loss and gradients of E2E-SyMo in three compiled pieces around the iteration.

    Newton's method converges quadratically: where every row is within the square root of the
    tolerance, one more step makes it a root, which the last piece checks. A batch with a row for
    which this fails is left to the uncompiled path with its safeguards. The choice depends on the
    numbers of the batch alone, so that a resumed run repeats it.
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
        for iteration in range(1, min(model.root.max_iterations, 5) + 1):
            if worst.item() <= tolerance**0.5:
                loss, converged, gradients = self._finish(windows, x)
                if converged.item():
                    model._count("newton_iterations", loss.new_tensor(float(iteration)))
                    model._count("newton_failed", loss.new_tensor(0.0))
                    return loss, (), gradients
            x, worst = self._iterate(windows.q, impulse, x)
        model.zero_grad()
        loss = model.loss(windows)
        return loss.detach(), (), torch.autograd.grad(loss, list(model.parameters()))

    def _first_step(self, windows: Windows) -> tuple[Tensor, Tensor, Tensor]:
        impulse = self._model._impulse(windows)
        x, worst = self._newton_step(windows.q, impulse, 2.0 * windows.q - windows.q_prev)
        return impulse, x, worst

    def _newton_step(self, q: Tensor, impulse: Tensor, x: Tensor) -> tuple[Tensor, Tensor]:
        model = self._model
        problem = MomentumMatching(model.integrator, model.lagrangian, q, impulse, model.time_step)
        at = problem.at(x)
        return x + solve(at.jacobian(), -at.residual), row_norm(at.residual).amax()

    def _loss_at(self, windows: Windows, x: Tensor) -> tuple[Tensor, Tensor]:
        finder = Given(tolerance=self._model.root.tolerance)
        error, root = self._model._error_of_root(windows, finder, x, None)
        return error.square().mean(), root.converged.all()
