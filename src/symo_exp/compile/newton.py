"""Newton's method in compiled and exported code, which cannot branch on values.

``iterate_branch_free`` is the counterpart of ``mechanics.roots.iterate``: one step as a fixed
sequence of operations on all rows. Compiled callers look between steps at whether all rows have
ended; an exported step takes a fixed number of them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from symo_exp.compile.program import Program
from symo_exp.mechanics.lagrangian import solve
from symo_exp.mechanics.roots import Newton, RootFinder, joint_norm, rounding
from symo_exp.mechanics.types import Windows
from symo_exp.mechanics.variational import DiscreteExpansion, MomentumMatching
from symo_exp.models.base import DynamicsModel
from symo_exp.models.flows import VariationalFlow
from symo_exp.models.objectives import NOTHING, Objective, RootError, Statistics


class Iterate(NamedTuple):
    """The equations at one iterate ``x``, and the step of Newton's method from there.

    A compiler removes what its caller does not use: if only ``near`` and ``expansion`` of an
    ``Iterate`` are read, it costs no Jacobian.
    """

    x: Float[Tensor, "batch k"]
    """``q_{k+1}``, and the other unknowns of the integrator."""
    expansion: DiscreteExpansion
    """``L_d`` around ``q_k`` and ``x``."""
    jacobian: Float[Tensor, "batch k k"]
    next: Float[Tensor, "batch k"]
    """The next iterate."""
    near: Bool[Tensor, " batch"]
    """Rows with a small residual; by the rule of the thesis, all together or none."""
    last: Bool[Tensor, " batch"]
    """Rows whose next step is lost in rounding."""
    onward: Bool[Tensor, " batch"]
    """Rows that ``roots.iterate`` would evaluate again after the next iterate."""
    iterations: Float[Tensor, " batch"]
    """Steps that ``roots.iterate`` would have taken, the next one included."""

    @property
    def found(self) -> Bool[Tensor, " batch"]:
        """Rows that end here: roots, or as near to one as rounding allows."""
        return self.near | self.last


def iterate_branch_free(
    problem: MomentumMatching, root: RootFinder, x: Tensor, before: Iterate | None = None
) -> Iterate:
    """Evaluate the equations at ``x`` and take a step of Newton's method from there.

    Args:
        problem: The equations.
        root: ``Newton`` with its tolerance and stopping rule.
        x: The iterate.
        before: The previous one, if there is one.
    """
    assert isinstance(root, Newton)
    at, together = problem.at(x), root.stopping == "batch"
    jacobian = at.jacobian()
    step = solve(jacobian, -at.residual)
    if together:
        length = joint_norm(at.residual, root.sizes).expand(x.shape[0])
    elif root.accuracy is None:
        length = root.bounds.norm(at.residual)
    else:  # by the Jacobian before, so that the last iterate costs none
        near_by = jacobian if before is None else before.jacobian
        length = root.bounds.norm(at.residual, solve(near_by, -at.residual))
    near = length <= root.tolerance
    settled = root.bounds.negligible(step, rounding(x, root.sizes)).all(-1)
    last = torch.zeros_like(settled) if together else settled
    if before is None:
        wanting = torch.ones_like(near) if together else ~near
        iterations = wanting.to(x.dtype)
    else:
        wanting = before.onward & ~near
        iterations = before.iterations + wanting.to(x.dtype)
    onward = wanting & ~last
    return Iterate(x, at.expansion, jacobian, x + step, near, last, onward, iterations)


class Trainable(Protocol):
    """A model, its objective, and the uncompiled functions that compiled ones replace."""

    model: DynamicsModel
    objective: Objective
    compiled: dict[str, Callable[..., Any]]

    def loss(self, windows: Windows) -> Tensor:
        """Return the loss."""

    def uncompiled_training(self, windows: Windows) -> tuple[Tensor, Statistics]:
        """Return the detached loss and the objective's statistics; leave gradients in place."""


class RootLoss:
    """Compiled loss of ``RootError`` with its statistics.

    The first piece takes the one step of Newton's method that is always needed, others further
    steps while a row needs them, the last one differentiates. Results of a piece are passed on, so
    that nothing is evaluated twice. A batch with a row that does not converge in a few steps is
    left to the uncompiled path with its safeguards.

    Args:
        learner: The learner.
        flow: Its flow.
        objective: Its objective.
        gradients: Whether a call leaves gradients in the parameters.
        open_rows: Whether kernels are for any number of rows, as of ``Program``.
    """

    most_iterations = 5

    def __init__(
        self,
        learner: Trainable,
        flow: VariationalFlow,
        objective: RootError,
        *,
        gradients: bool,
        open_rows: bool,
    ) -> None:
        self._learner, self._gradients = learner, gradients
        model = learner.model
        self._flow, self._objective = flow, objective
        self._start = Program(model, self._first_step, open_rows=open_rows)
        self._iterate = Program(model, self._next_step, open_rows=open_rows)
        self._finish = Program(model, self._loss_at, gradients=gradients, open_rows=open_rows)

    def __call__(self, windows: Windows) -> tuple[Tensor, Statistics]:
        """Return the loss and the statistics of a batch."""
        before, impulse, at, over = self._start(windows)
        taken = 1
        while not over.item():
            if taken == min(self._flow.root.max_iterations, self.most_iterations):
                if self._gradients:
                    return self._learner.uncompiled_training(windows)
                return self._learner.loss(windows), NOTHING
            at, over = self._iterate(windows, impulse, at)
            taken += 1
        loss, iterations = self._finish(windows, before, at)
        failed = torch.zeros_like(iterations)
        return loss, {"newton_iterations": iterations, "newton_failed": failed}

    def _first_step(self, windows: Windows) -> tuple[Any, ...]:
        before = self._flow.expand_before(windows)
        impulse = self._objective.impulse(self._flow, windows, before)
        problem, root = self._problem(windows, impulse), self._flow.root
        guess = iterate_branch_free(
            problem, root, self._objective.initial_guess(self._flow, windows)
        )
        at = iterate_branch_free(problem, root, guess.next, guess)
        return before, impulse.contiguous(), at, at.found.all()

    def _next_step(self, windows: Windows, impulse: Tensor, last: Iterate) -> tuple[Any, ...]:
        problem = self._problem(windows, impulse)
        at = iterate_branch_free(problem, self._flow.root, last.next, last)
        return at, at.found.all()

    def _loss_at(self, windows: Windows, before: DiscreteExpansion, at: Iterate) -> tuple[Any, ...]:
        impulse = self._objective.impulse(self._flow, windows, before)
        error = self._objective.error(self._flow, windows, impulse, at.x, at.expansion, at.jacobian)
        return error.square().mean(), at.iterations.mean()

    def _problem(self, windows: Windows, impulse: Tensor) -> MomentumMatching:
        forces = self._flow.forces(windows.u, windows.u_next)
        return self._flow.matching(windows.q, impulse, forces)


class VariationalAdvance:
    """Compiled ``VariationalFlow.advance``.

    Maps ``(q_k, p_k, u_k, u_{k+1})`` to ``(q_{k+1}, p_{k+1}, converged)``. The first piece takes
    the two steps of Newton's method that are nearly always needed, others one more each. If a row
    does not converge, the uncompiled step with its safeguards repeats all of them.

    Args:
        model: Owner of the parameters.
        flow: Its flow.
        open_rows: Whether kernels are for any number of rows, as of ``Program``.
    """

    first_iterations, most_iterations = 2, 10

    def __init__(self, model: nn.Module, flow: VariationalFlow, *, open_rows: bool) -> None:
        assert isinstance(flow.rollout_root, Newton)
        self._flow, self._root = flow, flow.rollout_root
        self._start = Program(model, self._first, open_rows=open_rows)
        self._iterate = Program(model, self._next, open_rows=open_rows)

    def __call__(self, *given: Tensor) -> tuple[Tensor, ...]:
        """Advance ``(q, p, u, u_next)``, each (batch, ·), by a time step."""
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
            x = iterate_branch_free(problem, self._root, x).next
        return self._next(q, p, u, u_next, x)

    def _next(
        self, q: Tensor, p: Tensor, u: Tensor, u_next: Tensor, x: Tensor
    ) -> tuple[Tensor, ...]:
        """Take one step from ``x``.

        Returns:
            ``q_{k+1}``, the momentum there, the rows that are roots, the iterate, and whether every
            row is a root or was not finite before.
        """
        problem, f1 = self._problem(q, p, u, u_next)
        before = iterate_branch_free(problem, self._root, x)
        at = iterate_branch_free(problem, self._root, before.next, before)
        found = at.near | before.last
        lost = ~(q.isfinite() & p.isfinite()).all(-1)
        q_next = at.x[:, : q.shape[1]].contiguous()
        p_next = at.expansion.values.d2 + f1
        return q_next, p_next, found, at.x.contiguous(), (found | lost).all()

    def _problem(
        self, q: Tensor, p: Tensor, u: Tensor, u_next: Tensor
    ) -> tuple[MomentumMatching, Tensor]:
        """Return the equations of a step, and the impulse ``f⁺`` at its end."""
        discrete, forces = self._flow.rollout_discrete, self._flow.forces(u, u_next)
        f0, f1 = discrete.impulses(forces)
        return MomentumMatching(discrete, q, p + f0, forces), f1
