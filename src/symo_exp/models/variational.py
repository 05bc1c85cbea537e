"""Methods that move by a Lagrangian in a variational integrator (thesis chapter 5)."""

from __future__ import annotations

from typing import Any

from torch import Tensor

from symo_exp.mechanics.lagrangian import Lagrangian, solve
from symo_exp.mechanics.roots import Newton, RootFinder
from symo_exp.mechanics.types import Windows
from symo_exp.mechanics.variational import (
    DiscreteExpansion,
    Forces,
    VariationalIntegrator,
    del_residual,
    momentum_before,
    variational_step,
)
from symo_exp.models.base import Advance, DynamicsModel, Step
from symo_exp.models.compiled_step import CompiledStep


class VariationalModel(DynamicsModel):
    """Predicts by solving the discrete Euler-Lagrange equations of its Lagrangian.

    A subclass has that Lagrangian, as ``_lagrangian``. It reads poses only. The velocity at a
    node is that of the discrete Legendre transform,
    ``v_k = H(q_k)⁻¹ p⁺(q_{k−1}, q_k)``, which belongs to the integrator.
    """

    reads_velocity = False

    _lagrangian: Lagrangian

    def __init__(
        self,
        *,
        integrator: VariationalIntegrator,
        root: RootFinder,
        evaluation_root: RootFinder | None = None,
        rollout_root: RootFinder | None = None,
        **base: Any,
    ) -> None:
        """``root`` serves training; ``evaluation_root`` one-step measures, ``rollout_root``
        rollouts of the copy made by ``for_evaluation``. Left out, they are the one before."""
        super().__init__(**base)
        self.integrator, self.root = integrator, root
        self._evaluation_root = evaluation_root or root
        self.rollout_root = rollout_root or self._evaluation_root

    @property
    def lagrangian(self) -> Lagrangian:
        return self._lagrangian

    def for_evaluation(self) -> VariationalModel:
        twin = super().for_evaluation()
        assert isinstance(twin, VariationalModel)
        twin.root = self._evaluation_root
        twin.integrator = self.integrator.converged()
        return twin

    @property
    def can_be_compiled(self) -> bool:
        return not self.integrator.iterates

    @property
    def rollout_can_be_compiled(self) -> bool:
        """Where roots are found by Newton's method, as the compiled iteration does."""
        newton = isinstance(self.rollout_root, Newton)
        return newton and not self.integrator.iterates and super().rollout_can_be_compiled

    def initial_velocity(self, windows: Windows) -> Tensor:
        """``v_k = H(q_k)⁻¹ p⁺(q_{k−1}, q_k)``."""
        return self._lagrangian.velocity(windows.q, self._momentum_before(windows))

    def step(
        self, q: Tensor, v: Tensor, u: Tensor | None = None, u_next: Tensor | None = None
    ) -> Step:
        p = self._lagrangian.momentum(q, v)
        return self._step(q, p, u, u_next, guess=q + self.time_step * v)

    def predict(self, windows: Windows) -> Step:
        p, guess = self._momentum_before(windows), 2.0 * windows.q - windows.q_prev
        return self._step(windows.q, p, windows.u, windows.u_next, guess=guess)

    def del_residuals(self, windows: Windows) -> Tensor:
        """``g(q_{k−1}, q_k, q_{k+1})`` at the data [N s]."""
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

    def preconditioned_residuals(self, windows: Windows) -> Tensor:
        """``h H⁻¹ g`` with ``H`` at ``(q_k + q_{k+1})/2``, in the units of the coordinates.

        One step of Newton's method from the datum ``q_{k+1}`` with ``−H/h``, the limit of the
        Jacobian for small steps: to first order the error of the root, without finding it.
        ``H`` is differentiated like everything else; held fixed, ``H → 0`` would remain a way out.
        """
        mass = self._lagrangian.mass_matrix(0.5 * (windows.q + windows.q_next))
        return self.time_step * solve(mass, self.del_residuals(windows))

    def _step(
        self, q: Tensor, p: Tensor, u: Tensor | None, u_next: Tensor | None, *, guess: Tensor
    ) -> Step:
        force = self._force(u, q)
        force_next = force if u_next is None else self._force(u_next, q)
        step = variational_step(
            self.integrator,
            self._lagrangian,
            self.root,
            q,
            p,
            force,
            force_next,
            self.time_step,
            guess,
        )
        v = self._lagrangian.velocity(step.q, step.p)
        return Step(step.q, v, step.root.converged, step.root.iterations)

    def _momentum_before(self, windows: Windows, at: DiscreteExpansion | None = None) -> Tensor:
        return momentum_before(
            self.integrator,
            self._lagrangian,
            windows.q_prev,
            windows.q,
            *self._forces_before(windows),
            self.time_step,
            at,
        )

    def _forces_before(self, windows: Windows) -> Forces:
        """The generalised forces at nodes ``k−1`` and ``k``."""
        return Forces(self._force(windows.u_prev, windows.q), self._force(windows.u, windows.q))

    def _encode(self, q: Tensor, v: Tensor) -> tuple[Tensor, Tensor]:
        return q, self._lagrangian.momentum(q, v)

    def _advance(
        self, q: Tensor, y: Tensor, u: Tensor, u_next: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        guess = q + self.time_step * self._lagrangian.velocity(q, y)
        step = variational_step(
            self.integrator,
            self._lagrangian,
            self.rollout_root,
            q,
            y,
            self._force(u, q),
            self._force(u_next, q),
            self.time_step,
            guess,
        )
        return step.q, step.p, step.root.converged

    def _decode(self, q: Tensor, y: Tensor) -> Tensor:
        return self._lagrangian.velocity(q, y)

    def _compiled_advance(self) -> Advance:
        return CompiledStep(self)
