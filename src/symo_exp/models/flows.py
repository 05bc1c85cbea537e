"""Flows: the map of a mechanical system's state over one time step.

``ExplicitFlow`` integrates a vector field by a Runge-Kutta method, ``VariationalFlow`` solves the
discrete Euler-Lagrange equations of a Lagrangian. Shapes: configurations ``q`` and velocities ``v``
(batch, n), controls ``u`` (batch, m); a control is linear in time between two nodes.
"""

from __future__ import annotations

import copy
import itertools
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any, ClassVar, Literal, NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn
from typing_extensions import override

from symo_exp.checks import instance, one_of
from symo_exp.errors import ConfigError
from symo_exp.mechanics.chart import Controlled
from symo_exp.mechanics.explicit import RungeKutta
from symo_exp.mechanics.geodesic import on_space
from symo_exp.mechanics.lagrangian import Lagrangian
from symo_exp.mechanics.returned import checked_tensor, returned
from symo_exp.mechanics.roots import Newton, RootFinder, Sizes, iterate
from symo_exp.mechanics.space import FLAT, Space
from symo_exp.mechanics.stretches import StretchMatching, StretchNewton, StretchPoint
from symo_exp.mechanics.types import Coordinates, Windows
from symo_exp.mechanics.variational import (
    DiscreteExpansion,
    DiscreteLagrangian,
    Forces,
    MomentumMatching,
    VariationalIntegrator,
    VariationalStep,
)
from symo_exp.models.adjoint import FIXED_STEP, adjoint_step
from symo_exp.models.fields import Field
from symo_exp.nets.affine import parameter_jacobian
from symo_exp.nets.inputs import LearnedInputs

Carried = tuple[Tensor, Tensor, Tensor]
"""The state ``(q, y)`` of a rollout at a node, and which rows have converged."""
ACCURACY = 1e-11
"""Bound on the error of a root in rollouts and in evaluation [unit of the coordinate]."""
STRETCH, MOST_UPDATES = 10, 8
"""Steps that a rollout solves at once, and iterations after which those that are solved count.

Where ten steps need more iterations, they are found in less time one by one."""


class Step(NamedTuple):
    """The state one time step later, with the status of the root finding row by row."""

    q: Float[Tensor, "batch N"]
    v: Float[Tensor, "batch n"]
    converged: Bool[Tensor, " batch"]
    iterations: Int[Tensor, " batch"]


class Rollout(NamedTuple):
    """A trajectory from node 0 to node ``steps``; ``converged`` belongs to the steps between."""

    q: Float[Tensor, "batch nodes N"]
    v: Float[Tensor, "batch nodes n"]
    converged: Bool[Tensor, "batch steps"]


class Flow(nn.Module, ABC):
    """The map ``(q_k, v_k, u_k, u_{k+1}) → (q_{k+1}, v_{k+1})`` over one time step.

    Args:
        time_step: Time step [s].
    """

    reads_velocity: ClassVar[bool]
    """True if predictions start from measured velocities, or from configurations alone."""
    branch_free = False
    """True if no operation of a step depends on values, as those of a root finder do."""
    input_matrix: Float[Tensor, "n m"]
    """``B`` of the generalised force ``F = B u``."""
    lagrangian: Lagrangian | None
    """The Lagrangian of the system, if the flow has one."""
    space: Space = FLAT
    """The space of configurations."""
    sizes: Sizes = None
    """Units of the coordinates."""
    momentum_sizes: Sizes = None
    """Units of their momenta."""

    def __init__(self, time_step: float) -> None:
        super().__init__()
        self.time_step = float(time_step)

    def set_units(self, coordinates: Coordinates) -> None:
        """Measure errors, residuals and roots in the units of coordinates."""
        action, sizes = coordinates.units.size("N m s"), coordinates.sizes
        self.sizes = tuple(sizes.tolist())
        self.momentum_sizes = tuple((action / sizes).tolist())

    @abstractmethod
    def step(self, q: Tensor, v: Tensor, u: Tensor, u_next: Tensor) -> Step:
        """Take one time step, differentiable in all arguments and in the parameters."""

    def initial_velocity(self, windows: Windows) -> Float[Tensor, "samples n"]:
        """Return the velocity at node ``k`` with which a prediction starts: the measured one.

        A flow that does not read it returns an estimate; in evaluation, its rows in which no motion
        between nodes is found are NaN.
        """
        if not self.reads_velocity:
            raise ConfigError(
                f"{type(self).__name__} has reads_velocity = False, but no initial_velocity of its "
                "own; define it, or set reads_velocity = True to start from measured velocities"
            )
        return windows.v

    def predict(self, windows: Windows) -> Step:
        """Return the one-step prediction of node ``k+1``, which all measures use."""
        return self.step(windows.q, self.initial_velocity(windows), windows.u, windows.u_next)

    def converged(self) -> Flow:
        """Return a copy for evaluation whose iterations run to convergence."""
        return copy.deepcopy(self)

    @torch.no_grad()
    def rollout(
        self,
        q: Float[Tensor, "batch N"],
        v: Float[Tensor, "batch n"],
        u: Float[Tensor, "batch nodes m"],
        advance: Callable[..., Carried] | None = None,
    ) -> Rollout:
        """Return trajectories from ``(q, v)`` under the controls ``u`` at all nodes.

        The state carried from node to node is ``(q, y)``, with ``y`` of ``encode``. ``advance``
        replaces ``self.advance``, as a compiled one does.
        """
        q, y, converged = self.advance_all(q, self.encode(q, v), u, advance)
        v = self.decode(q.flatten(0, 1), y.flatten(0, 1)).view_as(y)
        return Rollout(q, v, converged)

    def rollout_slopes(
        self, q: Float[Tensor, "batch n"], v: Float[Tensor, "batch n"], u: Tensor
    ) -> tuple[Float[Tensor, "batch nodes n"], Float[Tensor, "batch nodes n 2n"]] | None:
        """Return the configurations of rollouts and their derivatives in ``(q, v)``.

        Those of rotations are along ``retract``. Rows whose roots are not found are NaN from there
        on, where several steps are solved at once. ``None`` if there is no closed form.
        """
        if not self.space.rotations:
            return None
        path, n = self.rollout(q, v, u), v.shape[1]
        if not path.converged.all():
            return None
        moved, v = torch.zeros_like(v).requires_grad_(), v.clone().requires_grad_()
        carried = parameter_jacobian(
            lambda: self.encode(self.space.retract(q, moved), v), (), (moved, v)
        )
        one = torch.eye(2 * n).to(q).expand(len(q), -1, -1)
        start = torch.cat((one[:, :n], torch.cat(carried.inputs, dim=2)), dim=1)
        slopes = chained(self.step_slopes(path.q, path.v, u)[0], start)
        return path.q, slopes[:, :, :n]

    def step_slopes(
        self,
        q: Float[Tensor, "batch nodes N"],
        v: Float[Tensor, "batch nodes n"],
        u: Float[Tensor, "batch nodes m"],
        parameters: Sequence[Tensor] = (),
    ) -> tuple[Float[Tensor, "batch steps 2n 2n"], Float[Tensor, "batch steps 2n p"]]:
        """Return the derivatives of each step of a rollout in its state and in the parameters.

        The state is ``(q, y)``, what a rollout carries; derivatives are along ``retract``.
        """
        space, (count, nodes, n) = self.space, v.shape
        here, there = (x.flatten(0, 1) for x in (q[:, :-1], q[:, 1:]))
        before, after = (x.flatten(0, 1) for x in (u[:, :-1], u[:, 1:]))
        moved = torch.zeros(len(here), n).to(q).requires_grad_()
        with torch.no_grad():
            y = self.encode(here, v[:, :-1].flatten(0, 1))
        y = y.clone().requires_grad_()

        def step() -> Tensor:
            reached, carried, _ = self.advance(space.retract(here, moved), y, before, after)
            return torch.cat((space.difference(there, reached), carried), dim=1)

        found = parameter_jacobian(step, parameters, (moved, y))
        shape = (count, nodes - 1)
        by_state = torch.cat(found.inputs, dim=2).unflatten(0, shape)
        return by_state, found.parameters.unflatten(0, shape)

    def encode(self, q: Tensor, v: Tensor) -> Tensor:
        """Return ``y`` of a state: the velocity, unless a flow carries something else."""
        return v

    def decode(self, q: Tensor, y: Tensor) -> Tensor:
        """Return the velocity of ``(q, y)``."""
        return y

    def advance(self, q: Tensor, y: Tensor, u: Tensor, u_next: Tensor) -> Carried:
        """Return ``(q, y)`` one time step later in a rollout, and which rows have converged."""
        step = self.step(q, y, u, u_next)
        return step.q, step.v, step.converged

    def advance_all(
        self, q: Tensor, y: Tensor, u: Tensor, advance: Callable[..., Carried] | None = None
    ) -> Carried:
        """Return ``(q, y)`` at all nodes, and which steps between them have converged."""
        nodes: list[Carried] = [(q, y, torch.ones_like(q[:, 0], dtype=torch.bool))]
        for before, after in itertools.pairwise(u.unbind(1)):
            nodes.append((advance or self.advance)(*nodes[-1][:2], before, after))
        path, carried, converged = (torch.stack(field, 1) for field in zip(*nodes, strict=True))
        return path, carried, converged[:, 1:]


def chained(
    steps: Float[Tensor, "batch steps k k"],
    start: Float[Tensor, "batch k columns"],
    added: Float[Tensor, "batch steps k columns"] | None = None,
) -> Float[Tensor, "batch nodes k columns"]:
    """Return ``S₀``, then ``S_{k+1} = F_k S_k + G_k`` at all nodes; ``G`` is zero if left out."""
    found = [start]
    for k, step in enumerate(steps.unbind(1)):
        moved = step @ found[-1]
        found.append(moved if added is None else moved + added[:, k])
    return torch.stack(found, 1)


class ExplicitFlow(Flow):
    """A field ``v̇ = a(q, v, u)`` in an explicit Runge-Kutta method (thesis section 3.2).

    Args:
        field: The acceleration.
        integrator: Runge-Kutta method of steps.
        time_step: Time step [s].
        sensitivity: ``"direct"`` gradients are those of the step itself, ``"adjoint"`` ones those
            of the continuous problem, by torchdiffeq (section 4.2.2).
        rollout_integrator: Runge-Kutta method of rollouts; ``integrator`` if left out.
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
        instance("field", field, Field)
        for rule in (integrator, rollout_integrator or integrator):
            instance("integrator", rule, RungeKutta)
        one_of("model.sensitivity", sensitivity, ("direct", "adjoint"))
        if sensitivity == "adjoint" and integrator.name not in FIXED_STEP:
            raise ConfigError(
                f"model.sensitivity=adjoint: torchdiffeq has no single step of {integrator.name}; "
                f"choose integrator={' or '.join(FIXED_STEP)}, or leave it at direct"
            )
        if sensitivity == "adjoint" and field.space.rotations:
            raise ConfigError(
                "model.sensitivity=adjoint integrates lengths and angles only, and the system has "
                "rotations; leave it at direct"
            )
        self.field, self.integrator, self.sensitivity = field, integrator, sensitivity
        self.rollout_integrator = rollout_integrator or integrator
        self.space = field.space
        self.branch_free = sensitivity == "direct"
        _check_field(field)

    @property
    @override
    def input_matrix(self) -> Tensor:  # type: ignore[override]
        return self.field.input_matrix

    @property
    @override
    def lagrangian(self) -> Lagrangian | None:  # type: ignore[override]
        return self.field.lagrangian

    @override
    def step(self, q: Tensor, v: Tensor, u: Tensor, u_next: Tensor) -> Step:
        rule, h = self.integrator, self.time_step
        if self.sensitivity == "adjoint" and torch.is_grad_enabled():
            state = adjoint_step(self.field, q, v, u, u_next, h, method=rule.name)
        else:  # without the hooks of a module, several times a step
            state = rule.step(self.field.forward, q, v, u, u_next, h, self.space)
        converged = torch.ones(q.shape[0], dtype=torch.bool, device=q.device)
        return Step(*state, converged, torch.zeros_like(converged, dtype=torch.int64))

    @override
    def advance(self, q: Tensor, y: Tensor, u: Tensor, u_next: Tensor) -> Carried:
        rule, h = self.rollout_integrator, self.time_step
        state = rule.step(self.field.forward, q, y, u, u_next, h, self.space)
        return *state, torch.ones_like(q[:, 0], dtype=torch.bool)


class VariationalFlow(Flow):
    """The discrete Euler-Lagrange equations of a Lagrangian (thesis section 3.3).

    ``q_{k+1}`` is the root of ``p⁻(q_k, q_{k+1}) = p_k``; then ``p_{k+1} = p⁺(q_k, q_{k+1})``.
    Predictions depend on configurations only: the velocity at a node is that of the discrete
    Legendre transform, ``v_k = H(q_k)⁻¹ p⁺(q_{k−1}, q_k)``. A rollout carries ``p``.

    Args:
        lagrangian: The Lagrangian.
        integrator: Variational integrator.
        time_step: Time step [s].
        input_matrix: ``B`` (n, m) of the generalised force ``F = B u``, or what learns it.
        root: Root finder of steps.
        evaluation_root: That of the copy for evaluation; ``root`` if left out.
        rollout_root: That of rollouts; ``evaluation_root`` if left out.
    """

    reads_velocity = False
    lagrangian: Lagrangian
    given_matrix: Tensor

    def __init__(
        self,
        lagrangian: Lagrangian,
        integrator: VariationalIntegrator,
        time_step: float,
        input_matrix: Float[Tensor, "n m"] | LearnedInputs,
        *,
        root: RootFinder,
        evaluation_root: RootFinder | None = None,
        rollout_root: RootFinder | None = None,
    ) -> None:
        super().__init__(time_step)
        instance("integrator", integrator, VariationalIntegrator)
        self.lagrangian, self.space = lagrangian, lagrangian.space
        self.integrator = copy.copy(on_space(integrator, self.space))
        self.rollout_integrator = self.integrator.of_rollouts()
        self.root = copy.copy(root)
        self.evaluation_root = _accurate(evaluation_root or root)
        self.rollout_root = _accurate(rollout_root or evaluation_root or root)
        self.inputs = input_matrix if isinstance(input_matrix, LearnedInputs) else None
        if isinstance(input_matrix, Tensor):
            given = input_matrix.to(torch.get_default_dtype())
            self.register_buffer("given_matrix", given, persistent=False)

    @property
    @override
    def input_matrix(self) -> Tensor:  # type: ignore[override]
        return self.given_matrix if self.inputs is None else self.inputs.matrix.detach()

    @override
    def set_units(self, coordinates: Coordinates) -> None:
        super().set_units(coordinates)
        self.integrator.sizes = self.rollout_integrator.sizes = self.sizes
        for root in (self.root, self.evaluation_root, self.rollout_root):
            root.sizes = self.sizes
            root.tolerance *= coordinates.units.size("N m s")

    @override
    def step(self, q: Tensor, v: Tensor, u: Tensor, u_next: Tensor) -> Step:
        guess, forces = self.space.retract(q, self.time_step * v), self.forces(u, u_next)
        p = self.encode(q, v)
        return self._state(self.rollout_discrete.step(self.root, q, p, forces, guess))

    @override
    def predict(self, windows: Windows) -> Step:
        q, (p, found) = windows.q, self._before(windows)
        guess = self.space.extrapolated(windows.q_prev, q)
        forces = self.forces(windows.u, windows.u_next)
        step = self._state(self.discrete.step(self.root, q, p, forces, guess))
        return step if found is None else step._replace(converged=step.converged & found)

    @override
    def advance(self, q: Tensor, y: Tensor, u: Tensor, u_next: Tensor) -> Carried:
        guess = self.space.retract(q, self.time_step * self.decode(q, y))
        forces = self.forces(u, u_next)
        step = self.rollout_discrete.step(self.rollout_root, q, y, forces, guess)
        return step.q, step.p, step.root.converged

    @override
    @torch.no_grad()
    def advance_all(
        self, q: Tensor, y: Tensor, u: Tensor, advance: Callable[..., Carried] | None = None
    ) -> Carried:
        """Return all nodes of trajectories that solve stretches of steps, each at its own pace.

        The step at which a stretch diverges is taken alone, and the next stretch begins after it.
        """
        if advance is not None or not self.solves_stretches or u.shape[1] == 2:
            return super().advance_all(q, y, u, advance)
        count, last = len(u), u.shape[1] - 1
        path, momenta = (
            torch.cat((x.unsqueeze(1), x.new_full((count, last, x.shape[1]), torch.nan)), 1)
            for x in (q, y)
        )
        converged = torch.zeros_like(path[:, :, 0], dtype=torch.bool)
        every = torch.arange(count, device=q.device)
        at = torch.zeros_like(every)
        while True:
            finite = torch.cat((path[every, at], momenta[every, at]), 1).isfinite().all(1)
            rows = (finite & (at < last)).nonzero().squeeze(1)
            if len(rows) == 0:
                break
            steps = min(STRETCH, last - int(at[rows].min()))
            order = torch.arange(steps + 1, device=q.device)
            ahead = (at[rows].unsqueeze(1) + order).clamp(max=last)
            start, controls = (rows, at[rows]), u[rows.unsqueeze(1), ahead]
            nodes, there, solved = self.solve_stretch(path[start], momenta[start], controls)
            solved = solved.minimum(last - at[rows])
            row, step = (order[1:] <= solved.unsqueeze(1)).nonzero(as_tuple=True)
            reached = rows[row], ahead[row, step + 1]
            path[reached], momenta[reached] = nodes[row, step], there.p[row, step]
            converged[reached] = True
            at[rows] += solved
            alone = rows[(solved < steps) & (at[rows] < last)]
            if len(alone) > 0:
                start, end = (alone, at[alone]), (alone, at[alone] + 1)
                single = self.advance(path[start], momenta[start], u[start], u[end])
                path[end], momenta[end], converged[end] = single
                at[alone] += 1
        return path, momenta, converged[:, 1:]

    @override
    @torch.no_grad()
    def rollout_slopes(self, q: Tensor, v: Tensor, u: Tensor) -> tuple[Tensor, Tensor] | None:
        if not self.solves_stretches:
            return super().rollout_slopes(q, v, u)
        path = self.rollout(q, v, u).q
        (batch, n), at = v.shape, self.lagrangian.expand(q, v)
        identity = torch.eye(n).to(q).expand(batch, n, n)
        top = torch.cat((identity, torch.zeros_like(identity)), dim=2)
        slope = torch.cat((top, torch.cat((at.curvature().vq, at.mass()), dim=2)), dim=1)
        _, there, solved = self.solve_stretch(q, at.values.v, u, path[:, 1:])
        known = (solved == u.shape[1] - 1)[:, None, None]
        slopes = torch.cat((top.unsqueeze(1), there.slopes(slope)[0]), 1)
        return torch.cat((path[:, :1], path[:, 1:].where(known, torch.nan)), 1), slopes

    @property
    def solves_stretches(self) -> bool:
        """True if several steps can be solved at once."""
        root = self.rollout_root
        rows = isinstance(root, Newton) and root.stopping == "row"
        return rows and self.rollout_integrator.has_hessian

    def solve_stretch(
        self, q: Tensor, p: Tensor, u: Tensor, guess: Tensor | None = None
    ) -> tuple[Tensor, StretchPoint, Tensor]:
        """Return the nodes after the first, the equations there, and how many steps are solved.

        ``guess`` are the nodes to begin from; those of constant velocity if left out.
        """
        steps, batch = u.shape[1] - 1, len(q)
        force = self.force(u.flatten(0, 1)).unflatten(0, (batch, steps + 1))
        forces = Forces(force[:, :-1], force[:, 1:])
        problem = StretchMatching(self.rollout_discrete, q, p, forces)
        if guess is None:
            t = self.time_step * torch.arange(1, steps + 1).to(q)
            moved = t[:, None] * self.decode(q, p).unsqueeze(1)
            guess = self.space.retract(q.unsqueeze(1).expand(-1, steps, -1), moved)
        rule = StretchNewton(self.rollout_root.bounds)
        x, at, state = iterate(problem, problem.start(guess), rule, MOST_UPDATES)
        return problem.nodes(x), at, rule.solved(at, state)

    def _state(self, at: VariationalStep) -> Step:
        return Step(at.q, self.decode(at.q, at.p), at.root.converged, at.root.iterations)

    @override
    def initial_velocity(self, windows: Windows) -> Tensor:
        p, found = self._before(windows)
        v = self.decode(windows.q, p)
        return v if found is None else v.where(found.unsqueeze(1), torch.nan)

    def _before(self, windows: Windows) -> tuple[Tensor, Tensor | None]:
        """Return ``p_k``, and the rows with a motion that leads there; ``None``: all."""
        before = self.expand_before(windows) if self.integrator.iterates else None
        found = None if before is None else before.found
        return self.momentum_before(windows, before), found

    @override
    def converged(self) -> VariationalFlow:
        twin = copy.deepcopy(self)
        twin.root = self.evaluation_root
        twin.integrator = twin.rollout_integrator = self.rollout_integrator.converged()
        return twin

    @property
    def discrete(self) -> DiscreteLagrangian:
        """The discrete Lagrangian ``L_d`` of a time step."""
        return self._discretised(self.integrator)

    @property
    def rollout_discrete(self) -> DiscreteLagrangian:
        """That of rollouts, the same one unless training has another integrator."""
        return self._discretised(self.rollout_integrator)

    def _discretised(self, integrator: VariationalIntegrator) -> DiscreteLagrangian:
        lagrangian: Any = self.lagrangian
        if self.space.rotations:
            lagrangian = Controlled(lagrangian, self.input_matrix)
        return DiscreteLagrangian(integrator, lagrangian, self.time_step)

    @override
    def encode(self, q: Tensor, v: Tensor) -> Tensor:
        return self.lagrangian.momentum(q, v)

    @override
    def decode(self, q: Tensor, y: Tensor) -> Tensor:
        return self.lagrangian.velocity(q, y)

    def force(self, u: Tensor) -> Tensor:
        """Return the generalised force ``F = B u`` at a node, or ``u`` where there are rotations.

        There the force depends on the motion between nodes: see ``mechanics.geodesic``.
        """
        if self.space.rotations:
            return u
        return u @ self.given_matrix.T if self.inputs is None else self.inputs.force(u)

    def forces(self, u: Tensor, u_next: Tensor) -> Forces:
        """Return the forces at the ends of an interval."""
        return Forces(self.force(u), self.force(u_next))

    def matching(self, q: Tensor, impulse: Tensor, forces: Forces) -> MomentumMatching:
        """Return the equations of a step, given ``impulse = p_k + f⁻``.

        They are ``g(q_{k+1}) = impulse + D₁L_d(q_k, q_{k+1}) = 0``.
        """
        return MomentumMatching(self.discrete, q, impulse, forces)

    def expand_before(self, windows: Windows) -> DiscreteExpansion:
        """Expand ``L_d`` around ``(q_{k−1}, q_k)``."""
        forces = self.forces(windows.u_prev, windows.u)
        return self.discrete.expand(windows.q_prev, windows.q, forces)

    def momentum_before(self, windows: Windows, at: DiscreteExpansion | None = None) -> Tensor:
        """Return ``p_k = p⁺(q_{k−1}, q_k)``; ``at`` is the expansion of ``L_d`` there, if known."""
        forces = self.forces(windows.u_prev, windows.u)
        return self.discrete.momentum(windows.q_prev, windows.q, forces, at)


def _check_field(field: Field) -> None:
    """Refuse a field that fails, or whose accelerations have the wrong shape or precision."""
    matrix = field.input_matrix
    n, m = matrix.shape
    v, u = matrix.new_zeros(n + 2, n), matrix.new_zeros(n + 2, m)
    told = f"{type(field).__name__}.forward(q, v, u)"
    with torch.no_grad():
        found = returned(told, field.forward, field.space.of_vector(v), v, u)
    checked_tensor(told, found, tuple(v.shape), v.dtype, f"v of shape {tuple(v.shape)}")


def _accurate(root: RootFinder) -> RootFinder:
    """Return the root finder with a bound on the error of roots, which light machines need."""
    found = copy.copy(root)
    found.accuracy = ACCURACY
    return found
