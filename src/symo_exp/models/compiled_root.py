"""The compiled training step of E2E-SyMo: pieces around an iteration of unknown length."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import torch
from torch import Tensor

from symo_exp.mechanics.lagrangian import solve
from symo_exp.mechanics.roots import Newton, RootFinder, joint_norm, rounding, row_norm
from symo_exp.mechanics.types import Windows
from symo_exp.mechanics.variational import (
    DiscreteExpansion,
    MidpointExpansion,
    MomentumMatching,
    differentiable_pose,
)
from symo_exp.models.compiled import Packed, Program, carry
from symo_exp.nets.structured_lagrangian import StructuredExpansion

if TYPE_CHECKING:
    from symo_exp.models.e2e_symo import E2ESyMo

carry(StructuredExpansion, "_lagrangian")
carry(MidpointExpansion, "_h")


class Iterate(NamedTuple):
    """The residual at one iterate ``x``, and the step of Newton's method from there."""

    x: Tensor
    after: DiscreteExpansion
    """``L_d`` around ``(q_k, x)``."""
    jacobian: Tensor
    step: Tensor


def iterate(problem: MomentumMatching, root: RootFinder, x: Tensor) -> tuple[Iterate, Tensor]:
    """An iterate, and which rows end the iteration there: roots, or as near as rounding lets them
    be; by the rule of the thesis, all together or none."""
    assert isinstance(root, Newton)
    at = problem.at(x)
    jacobian = at.jacobian()
    step = solve(jacobian, -at.residual)
    if root.stopping == "batch":
        found = (joint_norm(at.residual) <= root.tolerance).expand(len(x))
    else:
        settled = (step.abs() <= rounding(x)).all(-1)
        found = (row_norm(at.residual) <= root.tolerance) | settled
    return Iterate(x, at.expansion, jacobian, step), found


class CompiledRootLoss:
    """Loss, and gradients if wanted, of E2E-SyMo in compiled pieces around the iteration.

    The first takes the one step of Newton's method that is always needed, others further steps
    where a row needs them, the last differentiates. What a pass computed travels on, so that
    nothing is evaluated twice. A batch with a row that a few steps do not bring home is left to
    the uncompiled path with its safeguards.
    """

    most_iterations = 5

    def __init__(self, model: E2ESyMo, *, gradients: bool) -> None:
        self._model, self._gradients = model, gradients
        self._start = Program(model, self._first_step, gradients=False)
        self._iterate = Program(model, self._next_step, gradients=False)
        self._finish = Program(model, self._loss_at, gradients=gradients)
        self.parameters = self._finish.parameters

    def __call__(self, windows: Windows) -> tuple[Any, ...]:
        model = self._model
        before, impulse, at, converged = self._start(windows)
        iterations = 1
        while not converged.item():
            if iterations == min(model.root.max_iterations, self.most_iterations):
                loss = model.loss(windows)
                if not self._gradients:
                    return (loss,)
                return loss.detach(), Packed(torch.autograd.grad(loss, self.parameters))
            at, converged = self._iterate(windows, impulse, at)
            iterations += 1
        model._count("newton_iterations", impulse.new_tensor(float(iterations)))
        model._count("newton_failed", impulse.new_tensor(0.0))
        return self._finish(windows, before, at)

    def _first_step(self, windows: Windows) -> tuple[Packed, Tensor, Packed, Tensor]:
        before = self._model.before(windows)
        impulse = self._model.impulse(windows, before)
        guess, _ = self._evaluate(windows, impulse, self._model.initial_guess(windows))
        at, converged = self._evaluate(windows, impulse, guess.x + guess.step)
        return Packed(before), impulse, Packed(at), converged

    def _next_step(self, windows: Windows, impulse: Tensor, at: Packed) -> tuple[Packed, Tensor]:
        last: Iterate = at.open()
        following, converged = self._evaluate(windows, impulse, last.x + last.step)
        return Packed(following), converged

    def _evaluate(self, windows: Windows, impulse: Tensor, x: Tensor) -> tuple[Iterate, Tensor]:
        model = self._model
        at, found = iterate(model.problem(windows, impulse), model.root, x)
        return at, found.all()

    def _loss_at(self, windows: Windows, before: Packed, at: Packed) -> Tensor:
        model, root = self._model, at.open()
        impulse, forces = model.impulse(windows, before.open()), model.forces(windows)
        pose = differentiable_pose(root.x, root.after, root.jacobian, windows.q, impulse, forces)
        return (pose - windows.q_next).square().mean()
