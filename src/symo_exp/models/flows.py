"""Flows: the map of a mechanical system's state over one time step.

``ExplicitFlow`` integrates a vector field by a Runge-Kutta method, ``VariationalFlow`` solves the
discrete Euler-Lagrange equations of a Lagrangian. Shapes: configurations ``q`` and velocities ``v``
(batch, n), controls ``u`` (batch, m); a control is linear in time between two nodes.
"""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import ClassVar, Literal, NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from symo_exp.mechanics.euler_lagrange import generalised_force
from symo_exp.mechanics.explicit import RungeKutta
from symo_exp.mechanics.lagrangian import Lagrangian
from symo_exp.mechanics.roots import RootFinder
from symo_exp.mechanics.types import Windows
from symo_exp.mechanics.variational import (
    DiscreteExpansion,
    DiscreteLagrangian,
    Forces,
    MomentumMatching,
    VariationalIntegrator,
    VariationalStep,
)
from symo_exp.models.adjoint import adjoint_step
from symo_exp.models.fields import Field

Carried = tuple[Tensor, Tensor, Tensor]
"""What a rollout carries from node to node, ``(q, y)``, and which rows have their root."""


class Step(NamedTuple):
    """The state one time step later, with the status of the root finding row by row."""

    q: Float[Tensor, "batch n"]
    v: Float[Tensor, "batch n"]
    converged: Bool[Tensor, " batch"]
    iterations: Int[Tensor, " batch"]


class Rollout(NamedTuple):
    """A trajectory from node 0 to node ``steps``; ``converged`` belongs to the steps between."""

    q: Float[Tensor, "batch nodes n"]
    v: Float[Tensor, "batch nodes n"]
    converged: Bool[Tensor, "batch steps"]


class Flow(nn.Module, ABC):
    """``(q_k, v_k, u_k, u_{k+1}) → (q_{k+1}, v_{k+1})``, one ``time_step`` [s] later."""

    reads_velocity: ClassVar[bool]
    """Whether predictions start from measured velocities; else these follow from configurations."""
    branch_free = False
    """Whether no operation of a step depends on a number, as a search for roots does."""
    input_matrix: Float[Tensor, "n m"]
    """``B`` of the generalised force ``F = B u``."""
    lagrangian: Lagrangian | None
    """The Lagrangian that moves the system, where there is one."""

    def __init__(self, time_step: float) -> None:
        super().__init__()
        self.time_step = float(time_step)

    @abstractmethod
    def step(self, q: Tensor, v: Tensor, u: Tensor, u_next: Tensor) -> Step:
        """One time step, differentiable in all arguments and in the parameters."""

    @abstractmethod
    def initial_velocity(self, windows: Windows) -> Float[Tensor, "samples n"]:
        """The velocity at node ``k`` with which a prediction starts."""

    def predict(self, windows: Windows) -> Step:
        """The one-step prediction of node ``k+1`` that every measure uses."""
        return self.step(windows.q, self.initial_velocity(windows), windows.u, windows.u_next)

    def converged(self) -> Flow:
        """A copy with everything that is iterated carried to convergence, for measuring."""
        return copy.deepcopy(self)

    @torch.no_grad()
    def rollout(
        self,
        q: Float[Tensor, "batch n"],
        v: Float[Tensor, "batch n"],
        u: Float[Tensor, "batch nodes m"],
        advance: Callable[..., Carried] | None = None,
    ) -> Rollout:
        """From ``(q, v)`` under the controls ``u`` at every node; all trajectories at once. It
        carries ``(q, y)``, ``y`` the velocity or what a flow has instead; ``advance`` does what
        ``self.advance`` does."""
        y, none = self.encode(q, v), torch.zeros(len(q), dtype=torch.bool, device=q.device)
        nodes: list[Carried] = [(q, y, none)]
        for k in range(u.shape[1] - 1):
            nodes.append((advance or self.advance)(*nodes[-1][:2], u[:, k], u[:, k + 1]))
        q, y, converged = (torch.stack(x, 1) for x in zip(*nodes, strict=True))
        v = self.decode(q.flatten(0, 1), y.flatten(0, 1)).view_as(q)
        return Rollout(q, v, converged[:, 1:])

    def encode(self, q: Tensor, v: Tensor) -> Tensor:
        """``y`` of a state."""
        return v

    def decode(self, q: Tensor, y: Tensor) -> Tensor:
        """The velocity that belongs to ``(q, y)``."""
        return y

    def advance(self, q: Tensor, y: Tensor, u: Tensor, u_next: Tensor) -> Carried:
        """``(q, y)`` one time step later in a rollout, and which rows have their root."""
        step = self.step(q, y, u, u_next)
        return step.q, step.v, step.converged


class ExplicitFlow(Flow):
    """``v̇ = a(q, v, u)`` over one step of an explicit Runge-Kutta method (thesis section 3.2), in
    rollouts of the ``rollout_integrator``. Gradients are those of the step itself, or with
    ``sensitivity="adjoint"`` those of the continuous problem, by torchdiffeq (section 4.2.2).
    """

    reads_velocity = True

    def __init__(
        self,
        field: Field,
        integrator: RungeKutta,
        time_step: float,
        sensitivity: Literal["direct", "adjoint"] = "direct",
        rollout_integrator: RungeKutta | None = None,
    ) -> None:
        super().__init__(time_step)
        if sensitivity not in ("direct", "adjoint"):
            raise ValueError(f"sensitivity must be direct or adjoint, got {sensitivity}")
        self.field, self.integrator, self.sensitivity = field, integrator, sensitivity
        self.rollout_integrator = rollout_integrator or integrator
        self.branch_free = sensitivity == "direct"

    @property
    def input_matrix(self) -> Tensor:  # type: ignore[override]
        return self.field.input_matrix

    @property
    def lagrangian(self) -> Lagrangian | None:  # type: ignore[override]
        return self.field.lagrangian

    def step(self, q: Tensor, v: Tensor, u: Tensor, u_next: Tensor) -> Step:
        rule, h = self.integrator, self.time_step
        if self.sensitivity == "adjoint" and torch.is_grad_enabled():
            state = adjoint_step(self.field, q, v, u, u_next, h, method=rule.name)
        else:  # without the hooks of a module, several times a step
            state = rule.step(self.field.forward, q, v, u, u_next, h)
        converged = torch.ones(q.shape[0], dtype=torch.bool, device=q.device)
        return Step(*state, converged, torch.zeros_like(converged, dtype=torch.int64))

    def advance(self, q: Tensor, y: Tensor, u: Tensor, u_next: Tensor) -> Carried:
        state = self.rollout_integrator.step(self.field.forward, q, y, u, u_next, self.time_step)
        return *state, torch.ones_like(q[:, 0], dtype=torch.bool)

    def initial_velocity(self, windows: Windows) -> Tensor:
        return windows.v


class VariationalFlow(Flow):
    """The discrete Euler-Lagrange equations of a Lagrangian (thesis section 3.3).

    ``q_{k+1}`` is the root of ``p⁻(q_k, q_{k+1}) = p_k``; then ``p_{k+1} = p⁺(q_k, q_{k+1})``. It
    reads configurations only. The velocity at a node is that of the discrete Legendre transform,
    ``v_k = H(q_k)⁻¹ p⁺(q_{k−1}, q_k)``, which belongs to the integrator. A rollout carries ``p``.
    """

    reads_velocity = False
    lagrangian: Lagrangian

    def __init__(
        self,
        lagrangian: Lagrangian,
        integrator: VariationalIntegrator,
        time_step: float,
        input_matrix: Float[Tensor, "n m"],
        *,
        root: RootFinder,
        evaluation_root: RootFinder | None = None,
        rollout_root: RootFinder | None = None,
    ) -> None:
        super().__init__(time_step)
        self.lagrangian, self.integrator = lagrangian, integrator
        self.root, self.evaluation_root = root, evaluation_root or root
        self.rollout_root = rollout_root or self.evaluation_root
        self.register_buffer(
            "input_matrix", input_matrix.to(torch.get_default_dtype()), persistent=False
        )

    def step(self, q: Tensor, v: Tensor, u: Tensor, u_next: Tensor) -> Step:
        guess = q + self.time_step * v
        return self._state(self._move(q, self.encode(q, v), u, u_next, guess, self.root))

    def predict(self, windows: Windows) -> Step:
        q, p, guess = windows.q, self.momentum_before(windows), 2.0 * windows.q - windows.q_prev
        return self._state(self._move(q, p, windows.u, windows.u_next, guess, self.root))

    def advance(self, q: Tensor, y: Tensor, u: Tensor, u_next: Tensor) -> Carried:
        guess = q + self.time_step * self.decode(q, y)
        step = self._move(q, y, u, u_next, guess, self.rollout_root)
        return step.q, step.p, step.root.converged

    def _move(
        self, q: Tensor, p: Tensor, u: Tensor, u_next: Tensor, guess: Tensor, root: RootFinder
    ) -> VariationalStep:
        return self.discrete.step(root, q, p, self.forces(u, u_next), guess)

    def _state(self, at: VariationalStep) -> Step:
        return Step(at.q, self.decode(at.q, at.p), at.root.converged, at.root.iterations)

    def initial_velocity(self, windows: Windows) -> Tensor:
        return self.decode(windows.q, self.momentum_before(windows))

    def converged(self) -> VariationalFlow:
        twin = copy.deepcopy(self)
        twin.root, twin.integrator = self.evaluation_root, self.integrator.converged()
        return twin

    @property
    def discrete(self) -> DiscreteLagrangian:
        """The discrete Lagrangian ``L_d`` of a time step."""
        return DiscreteLagrangian(self.integrator, self.lagrangian, self.time_step)

    def encode(self, q: Tensor, v: Tensor) -> Tensor:
        return self.lagrangian.momentum(q, v)

    def decode(self, q: Tensor, y: Tensor) -> Tensor:
        return self.lagrangian.velocity(q, y)

    def forces(self, u: Tensor, u_next: Tensor) -> Forces:
        """The generalised forces ``F = B u`` at the ends of an interval."""
        return Forces(*(generalised_force(self.input_matrix, x) for x in (u, u_next)))

    def matching(self, q: Tensor, impulse: Tensor, forces: Forces) -> MomentumMatching:
        """``g(q_{k+1}) = impulse + D₁L_d(q_k, q_{k+1}) = 0`` with ``impulse = p_k + f⁻``."""
        return MomentumMatching(self.discrete, q, impulse, forces)

    def expand_before(self, windows: Windows) -> DiscreteExpansion:
        """``L_d`` around ``(q_{k−1}, q_k)``."""
        forces = self.forces(windows.u_prev, windows.u)
        return self.discrete.expand(windows.q_prev, windows.q, forces)

    def momentum_before(self, windows: Windows, at: DiscreteExpansion | None = None) -> Tensor:
        """``p_k = p⁺(q_{k−1}, q_k)``; ``at`` is ``L_d`` around them, where it is known."""
        forces = self.forces(windows.u_prev, windows.u)
        return self.discrete.momentum(windows.q_prev, windows.q, forces, at)
