"""The compiled step of a variational rollout: pieces around an iteration of unknown length."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from torch import Tensor

from symo_exp.mechanics.variational import Forces, MomentumMatching
from symo_exp.models.compiled import Program
from symo_exp.models.compiled_root import iterate

if TYPE_CHECKING:
    from symo_exp.models.variational import VariationalModel


class Reached(NamedTuple):
    """An iterate ``q`` of ``q_{k+1}``, with the momentum ``p = p⁺(q_k, q)`` there."""

    q: Tensor
    p: Tensor
    converged: Tensor
    """Which rows are roots."""
    step: Tensor
    """The way to the next iterate."""
    over: Tensor
    """Whether every row is a root, or was lost before."""


class CompiledStep:
    """``(q_k, p_k, u_k, u_{k+1}) → (q_{k+1}, p_{k+1}, converged)`` in compiled pieces.

    The first takes the one step of Newton's method that is nearly always needed, others one more
    each. A row that they do not bring home leaves all of them to the uncompiled step with its
    safeguards.
    """

    most_iterations = 10

    def __init__(self, model: VariationalModel) -> None:
        self._model = model
        self._start = Program(model, self._first, gradients=False)
        self._iterate = Program(model, self._evaluate, gradients=False)

    def __call__(
        self, q: Tensor, p: Tensor, u: Tensor, u_next: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        at = Reached(*self._start(q, p, u, u_next))
        most = min(self._model.rollout_root.max_iterations, self.most_iterations)
        for _ in range(most - 1):
            if at.over.item():
                break
            at = Reached(*self._iterate(q, p, u, u_next, (at.q + at.step).contiguous()))
        if at.over.item():
            return at.q, at.p, at.converged
        return self._model._advance(q, p, u, u_next)

    def _first(self, q: Tensor, p: Tensor, u: Tensor, u_next: Tensor) -> Reached:
        guess = q + self._model.time_step * self._model.lagrangian.velocity(q, p)
        at = self._evaluate(q, p, u, u_next, guess)
        return self._evaluate(q, p, u, u_next, at.q + at.step)

    def _evaluate(self, q: Tensor, p: Tensor, u: Tensor, u_next: Tensor, x: Tensor) -> Reached:
        model = self._model
        forces = Forces(model._force(u, q), model._force(u_next, q))
        f0, f1 = model.integrator.impulses(*forces, model.time_step)
        problem = MomentumMatching(
            model.integrator, model.lagrangian, q, p + f0, model.time_step, forces
        )
        at, converged = iterate(problem, model.rollout_root, x)
        lost = ~(q.isfinite() & p.isfinite()).all(-1)
        return Reached(x, at.after.values.d2 + f1, converged, at.step, (converged | lost).all())
