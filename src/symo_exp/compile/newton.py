"""Newton's method in compiled pieces: an iteration of unknown length between fixed sequences."""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from symo_exp.compile.inductor import carry
from symo_exp.compile.program import Program
from symo_exp.mechanics.lagrangian import solve
from symo_exp.mechanics.roots import (
    Evaluation,
    Newton,
    RootFinder,
    joint_norm,
    rounding,
    row_norm,
)
from symo_exp.mechanics.types import Windows
from symo_exp.mechanics.variational import DiscreteExpansion, MidpointExpansion, MomentumMatching
from symo_exp.models.flows import VariationalFlow
from symo_exp.models.learner import Learner
from symo_exp.models.objectives import NOTHING, RootError, Statistics
from symo_exp.nets.structured_lagrangian import StructuredExpansion

carry(StructuredExpansion, "_lagrangian")
carry(MidpointExpansion, "_h")


class Iterate(NamedTuple):
    """The residual at one iterate ``x``, and the step of Newton's method from there."""

    x: Tensor
    """``q_{k+1}``, and what the integrator solves for alongside."""
    after: DiscreteExpansion
    """``L_d`` around ``q_k`` and ``x``."""
    jacobian: Tensor
    next: Tensor
    """The next iterate."""
    found: Tensor
    """Rows that end here: roots, or as near as rounding lets them be; by the rule of the thesis,
    all together or none."""
    onward: Tensor
    """Rows that the uncompiled iteration would look at again after the next iterate."""
    iterations: Tensor
    """How many steps it would have taken, row by row, the next one included."""


def iterate(
    problem: MomentumMatching, root: RootFinder, x: Tensor, last: Iterate | None = None
) -> Iterate:
    """The iterate at ``x``, after the ``last`` one."""
    assert isinstance(root, Newton)
    at, together = problem.at(x), root.stopping == "batch"
    jacobian = at.jacobian()
    step = solve(jacobian, -at.residual)
    near, ending = small(at.residual, root), settled(step, x, root)
    if last is None:
        wanting = torch.ones_like(near) if together else ~near
        iterations = wanting.to(x.dtype)
    else:
        wanting = last.onward & ~near
        iterations = last.iterations + wanting.to(x.dtype)
    onward = wanting & ~ending
    return Iterate(x, at.expansion, jacobian, x + step, near | ending, onward, iterations)


class RootLoss:
    """Loss of ``RootError`` and its statistics; ``gradients`` are left in the parameters.

    The first piece takes the one step of Newton's method that is always needed, others further
    steps where a row needs them, the last differentiates. What a pass computed travels on, so that
    nothing is evaluated twice. A batch with a row that a few steps do not bring home is left to
    the uncompiled path with its safeguards.
    """

    most_iterations = 5

    def __init__(
        self, model: Learner, flow: VariationalFlow, objective: RootError, *, gradients: bool
    ) -> None:
        self._model, self._gradients = model, gradients
        self._flow, self._objective = flow, objective
        self._start = Program(model, self._first_step)
        self._iterate = Program(model, self._next_step)
        self._finish = Program(model, self._loss_at, gradients=gradients)

    def __call__(self, windows: Windows) -> tuple[Tensor, Statistics]:
        before, impulse, at, over = self._start(windows)
        taken = 1
        while not over.item():
            if taken == min(self._flow.root.max_iterations, self.most_iterations):
                if self._gradients:
                    return self._model.uncompiled_training(windows)
                return self._model.loss(windows), NOTHING
            at, over = self._iterate(windows, impulse, at)
            taken += 1
        loss, iterations = self._finish(windows, before, at)
        failed = torch.zeros_like(iterations)
        return loss, {"newton_iterations": iterations, "newton_failed": failed}

    def _first_step(self, windows: Windows) -> tuple[Any, ...]:
        before = self._flow.expand_before(windows)
        impulse = self._objective.impulse(self._flow, windows, before)
        problem = self._problem(windows, impulse)
        guess = iterate(problem, self._flow.root, self._objective.initial_guess(windows))
        at = iterate(problem, self._flow.root, guess.next, guess)
        return before, impulse, at, at.found.all()

    def _next_step(self, windows: Windows, impulse: Tensor, last: Iterate) -> tuple[Any, ...]:
        at = iterate(self._problem(windows, impulse), self._flow.root, last.next, last)
        return at, at.found.all()

    def _loss_at(self, windows: Windows, before: DiscreteExpansion, at: Iterate) -> tuple[Any, ...]:
        impulse = self._objective.impulse(self._flow, windows, before)
        error = self._objective.error(self._flow, windows, impulse, at.x, at.after, at.jacobian)
        return error.square().mean(), at.iterations.mean()

    def _problem(self, windows: Windows, impulse: Tensor) -> MomentumMatching:
        forces = self._flow.forces(windows.u, windows.u_next)
        return self._flow.matching(windows.q, impulse, forces)


class VariationalAdvance:
    """``VariationalFlow.advance``: ``(q_k, p_k, u_k, u_{k+1}) → (q_{k+1}, p_{k+1}, converged)``.

    The first piece takes the two steps of Newton's method that are nearly always needed, others
    one more each; where a piece ends, the Jacobian is left out. A row that they do not bring home
    leaves all of them to the uncompiled step with its safeguards.
    """

    first_iterations, most_iterations = 2, 10

    def __init__(self, model: nn.Module, flow: VariationalFlow) -> None:
        assert isinstance(flow.rollout_root, Newton)
        self._flow, self._root = flow, flow.rollout_root
        self._start, self._iterate = Program(model, self._first), Program(model, self._next)

    def __call__(self, *given: Tensor) -> tuple[Tensor, ...]:
        most = min(self._root.max_iterations, self.most_iterations)
        *reached, x, over = self._start(*given)
        for _ in range(self.first_iterations, most):
            if over.item():
                break
            *reached, x, over = self._iterate(*given, x)
        return tuple(reached) if over.item() else self._flow.advance(*given)

    def _first(self, q: Tensor, p: Tensor, u: Tensor, u_next: Tensor) -> tuple[Tensor, ...]:
        problem, _ = self._problem(q, p, u, u_next)
        x = problem.start(q + self._flow.time_step * self._flow.decode(q, p))
        for _ in range(1, min(self._root.max_iterations, self.first_iterations)):
            x = x + newton_step(problem.at(x))
        return self._next(q, p, u, u_next, x)

    def _next(
        self, q: Tensor, p: Tensor, u: Tensor, u_next: Tensor, x: Tensor
    ) -> tuple[Tensor, ...]:
        """One step from ``x``: ``q_{k+1}``, the momentum there, which rows are roots, the iterate,
        and whether every row is a root or was lost before."""
        problem, f1 = self._problem(q, p, u, u_next)
        step = newton_step(problem.at(x))
        x = x + step
        at = problem.at(x)
        found = small(at.residual, self._root) | settled(step, x, self._root)
        lost = ~(q.isfinite() & p.isfinite()).all(-1)
        q_next = x[:, : q.shape[1]].contiguous()
        return q_next, at.expansion.values.d2 + f1, found, x.contiguous(), (found | lost).all()

    def _problem(
        self, q: Tensor, p: Tensor, u: Tensor, u_next: Tensor
    ) -> tuple[MomentumMatching, Tensor]:
        """The equations of a step, and the impulse ``f⁺`` at its end."""
        flow, forces = self._flow, self._flow.forces(u, u_next)
        f0, f1 = flow.integrator.impulses(*forces, flow.time_step)
        return flow.matching(q, p + f0, forces), f1


def newton_step(at: Evaluation) -> Tensor:
    """``−J⁻¹ g``."""
    return solve(at.jacobian(), -at.residual)


def small(residual: Tensor, root: Newton) -> Tensor:
    """Rows whose ``‖g‖`` is below the tolerance; by the rule of the thesis all together or none."""
    together = root.stopping == "batch"
    norm = joint_norm(residual).expand(len(residual)) if together else row_norm(residual)
    return norm <= root.tolerance


def settled(step: Tensor, x: Tensor, root: Newton) -> Tensor:
    """Rows whose step is lost in rounding: they take it and end."""
    if root.stopping == "batch":
        return torch.zeros_like(step[:, 0], dtype=torch.bool)
    return (step.abs() <= rounding(x)).all(-1)
