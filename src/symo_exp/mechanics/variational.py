"""Variational integrators: the discrete Euler-Lagrange equations (thesis sections 3.3 and 5.1).

Everything is expressed by the two momenta of an interval ``[t_k, t_{k+1}]``, the forced discrete
Legendre transforms (3.41), (3.42), here with their indices corrected:

    p⁻(q_k, q_{k+1}) = −D₁L_d(q_k, q_{k+1}) − f⁻        p⁺(q_k, q_{k+1}) = D₂L_d(q_k, q_{k+1}) + f⁺

The discrete Euler-Lagrange equations (3.43) match them at a node:

    g(q_{k+1}) = p⁺(q_{k−1}, q_k) − p⁻(q_k, q_{k+1}) = 0

Where configurations have rotations, slot derivatives, momenta and ``g`` are in the body axes of
their node, and ``mechanics.geodesic`` gives the integrators.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from typing_extensions import override

from symo_exp.mechanics.lagrangian import Expansion, Lagrangian
from symo_exp.mechanics.roots import Root, RootFinder, Sizes, attach_root
from symo_exp.mechanics.rows import Rowwise
from symo_exp.mechanics.space import FLAT, Space


class Forces(NamedTuple):
    """The generalised force at both ends of an interval, linear in time between them [N or N m]."""

    start: Float[Tensor, "batch n"]
    end: Float[Tensor, "batch n"]

    def detached(self) -> Forces:
        """Return the forces without a graph."""
        return Forces(self.start.detach(), self.end.detach())


class Slots(NamedTuple):
    """The slot derivatives of a discrete Lagrangian ``L_d(q₀, q₁)``."""

    d1: Float[Tensor, "batch n"]
    """``D₁L_d = ∂L_d/∂q₀``."""
    d2: Float[Tensor, "batch n"]
    """``D₂L_d = ∂L_d/∂q₁``."""


class DiscreteExpansion(Rowwise, ABC):
    """``L_d`` around a batch of pairs ``(q₀, q₁)``; see ``lagrangian.Expansion``."""

    values: Slots
    found: Bool[Tensor, " batch"] | None = None
    """Rows in which the motion between the configurations was found; ``None``: all."""

    @abstractmethod
    def d2d1(self) -> Float[Tensor, "batch n n"]:
        """Return ``∂²L_d/∂q₀ᵢ∂q₁ⱼ``, the Jacobian of the discrete Euler-Lagrange equations."""

    def mismatch(self, impulse: Float[Tensor, "batch n"]) -> Float[Tensor, "batch k"]:
        """Return the residual of a step: ``impulse + D₁L_d`` and the equations solved with it."""
        return impulse + self.values.d1

    def mismatch_jacobian(self) -> Float[Tensor, "batch k k"]:
        """Return the derivative of ``mismatch`` in ``q₁`` and the other unknowns of a step."""
        return self.d2d1()

    def hessian(
        self, before: DiscreteExpansion | None = None
    ) -> Float[Tensor, "variables variables batch n n"]:
        """Return ``∂(D_a L_d)/∂x_b`` in ``q₀``, the inner unknowns and ``q₁``, in this order.

        ``before`` is the previous iterate of a root finder: see ``Expansion.curvature``.
        """
        raise TypeError(f"{type(self).__name__} has no Hessian")

    @abstractmethod
    def slots(self, q0: Tensor, q1: Tensor, forces: Forces | None = None) -> Slots:
        """Return the slot derivatives, differentiable; arguments hold the values of the point."""

    def slots_at(
        self,
        q0: Float[Tensor, "batch N"],
        x: Float[Tensor, "batch n"],
        forces: Forces | None,
    ) -> Slots:
        """Return ``slots`` given ``q₁`` in the chart at ``q₀``."""
        return self.slots(q0, x, forces)


class VariationalIntegrator(ABC):
    """A rule that turns a Lagrangian and forces into discrete ones.

    Integrators that resolve the motion between two configurations need the ``forces`` there (none
    if left out); impulses on the configurations themselves come from ``impulses``.
    """

    order: int
    iterates = False
    """True if it solves for the motion between two configurations."""
    space: Space = FLAT
    """The space of the configurations that it takes."""
    sizes: Sizes = None
    """Units of the coordinates."""
    has_geodesic = False
    """True if it has an extension to rotations (``mechanics.geodesic``)."""
    has_hessian = False
    """True if its expansions have a ``hessian``; several steps are then solved at once."""

    @abstractmethod
    def slots(
        self,
        lagrangian: Lagrangian,
        q0: Float[Tensor, "batch n"],
        q1: Float[Tensor, "batch n"],
        h: float,
        forces: Forces | None = None,
    ) -> Slots:
        """Return ``D₁L_d``, ``D₂L_d``, differentiable in configurations, forces and parameters."""

    @abstractmethod
    def expand(
        self,
        lagrangian: Lagrangian,
        q0: Float[Tensor, "batch n"],
        q1: Float[Tensor, "batch n"],
        h: float,
        forces: Forces | None = None,
    ) -> DiscreteExpansion:
        """Return ``L_d`` around ``(q₀, q₁)``, as root finding needs it."""

    def unknowns(
        self, q0: Float[Tensor, "batch N"], q1: Float[Tensor, "batch N"]
    ) -> Float[Tensor, "batch k"]:
        """Return the initial unknowns of a step, first ``q₁`` in the chart at ``q₀``."""
        return q1

    def expand_at(
        self,
        lagrangian: Lagrangian,
        q0: Float[Tensor, "batch n"],
        x: Float[Tensor, "batch k"],
        h: float,
        forces: Forces | None = None,
    ) -> DiscreteExpansion:
        """Return ``L_d`` around ``q₀`` and the unknowns ``x`` of a step."""
        return self.expand(lagrangian, q0, x, h, forces)

    @abstractmethod
    def impulses(
        self, force0: Float[Tensor, "batch n"], force1: Float[Tensor, "batch n"], h: float
    ) -> tuple[Float[Tensor, "batch n"], Float[Tensor, "batch n"]]:
        """Return the discrete forces ``f⁻`` (on ``q₀``) and ``f⁺`` (on ``q₁``) [N s, N m s].

        Args:
            force0: Generalised force at the start of the interval.
            force1: Generalised force at its end; linear in time between them.
            h: Time step [s].
        """

    def converged(self) -> VariationalIntegrator:
        """Return the same integrator with inner iterations carried to convergence."""
        return self

    def of_rollouts(self) -> VariationalIntegrator:
        """Return the integrator of rollouts, the same one unless training has another."""
        return self


class VariationalMidpoint(VariationalIntegrator):
    """The midpoint rule, ``L_d(q₀, q₁) = h ℒ((q₀+q₁)/2, (q₁−q₀)/h)`` (thesis (5.4)), order 2.

    With ``q̄ = (q₀+q₁)/2`` and ``v̄ = (q₁−q₀)/h``

        D₁L_d = h/2 ℒ_q(q̄, v̄) − H(q̄) v̄        D₂L_d = h/2 ℒ_q(q̄, v̄) + H(q̄) v̄

    and ``f⁻ = f⁺ = h/4 (F₀ + F₁)`` (thesis (5.15), (5.16)).
    """

    order = 2
    has_geodesic = True
    has_hessian = True

    @override
    def slots(
        self, lagrangian: Lagrangian, q0: Tensor, q1: Tensor, h: float, forces: Forces | None = None
    ) -> Slots:
        gradients = lagrangian.gradients(0.5 * (q0 + q1), (q1 - q0) / h)
        return _midpoint_slots(gradients.q, gradients.v, h)

    @override
    def expand(
        self, lagrangian: Lagrangian, q0: Tensor, q1: Tensor, h: float, forces: Forces | None = None
    ) -> MidpointExpansion:
        return MidpointExpansion(lagrangian.expand(0.5 * (q0 + q1), (q1 - q0) / h), h)

    @override
    def impulses(self, force0: Tensor, force1: Tensor, h: float) -> tuple[Tensor, Tensor]:
        half = (h / 4) * (force0 + force1)
        return half, half


class MidpointExpansion(DiscreteExpansion):
    """The midpoint discrete Lagrangian around ``(q₀, q₁)``.

    Args:
        at: ``ℒ`` around the midpoint.
        h: Time step [s].
    """

    parts = ("_at", "_h", "values")

    def __init__(self, at: Expansion, h: float) -> None:
        self._at, self._h = at, h
        self.values = _midpoint_slots(at.values.q, at.values.v, h)

    @override
    def d2d1(self) -> Tensor:
        # h/4 ℒ_qq + ½ ℒ_qv − ½ ℒ_vq − H/h at the midpoint
        curvature = self._at.curvature()
        skew = 0.5 * (curvature.qv - curvature.vq)
        return (self._h / 4) * curvature.qq + skew - self._at.mass() / self._h

    @override
    def hessian(self, before: DiscreteExpansion | None = None) -> Tensor:
        assert before is None or isinstance(before, MidpointExpansion)
        qq, vq, qv = self._at.curvature(None if before is None else before._at)
        bend, own = (self._h / 4) * qq, self._at.mass() / self._h
        skew, even = 0.5 * (qv - vq), 0.5 * (qv + vq)
        rows = (bend - even + own, bend + skew - own), (bend - skew - own, bend + even + own)
        return torch.stack([torch.stack(row) for row in rows])

    @override
    def slots(self, q0: Tensor, q1: Tensor, forces: Forces | None = None) -> Slots:
        gradients = self._at.gradients(0.5 * (q0 + q1), (q1 - q0) / self._h)
        return _midpoint_slots(gradients.q, gradients.v, self._h)


def _midpoint_slots(dq: Tensor, p: Tensor, h: float) -> Slots:
    impulse = (0.5 * h) * dq
    return Slots(impulse - p, impulse + p)


@dataclass(frozen=True)
class DiscreteLagrangian:
    """A Lagrangian in a variational integrator with its discrete equations of motion.

    Everything is differentiable in configurations, forces and the parameters of the Lagrangian
    where gradients are enabled; roots by the implicit function theorem.

    Args:
        integrator: Makes ``L_d`` of ``ℒ``.
        lagrangian: ``ℒ``.
        h: Time step [s].
    """

    integrator: VariationalIntegrator
    lagrangian: Lagrangian
    h: float

    def slots(self, q0: Tensor, q1: Tensor, forces: Forces) -> Slots:
        """Return ``D₁L_d`` and ``D₂L_d`` at ``(q₀, q₁)``, (batch, n) each."""
        return self.integrator.slots(self.lagrangian, q0, q1, self.h, forces)

    def expand(self, q0: Tensor, q1: Tensor, forces: Forces) -> DiscreteExpansion:
        """Return ``L_d`` around ``(q₀, q₁)``."""
        return self.integrator.expand(self.lagrangian, q0, q1, self.h, forces)

    def expand_at(self, q0: Tensor, x: Tensor, forces: Forces) -> DiscreteExpansion:
        """Return ``L_d`` around ``q₀`` and the unknowns ``x`` of a step."""
        return self.integrator.expand_at(self.lagrangian, q0, x, self.h, forces)

    def impulses(self, forces: Forces) -> tuple[Tensor, Tensor]:
        """Return the discrete forces ``f⁻`` and ``f⁺`` of an interval."""
        return self.integrator.impulses(forces.start, forces.end, self.h)

    def momentum(
        self, q_prev: Tensor, q: Tensor, forces: Forces, at: DiscreteExpansion | None = None
    ) -> Float[Tensor, "batch n"]:
        """Return ``p_k = p⁺(q_{k−1}, q_k)``, the discrete Legendre transform (3.41).

        Args:
            q_prev: ``q_{k−1}``.
            q: ``q_k``.
            forces: The generalised force between them.
            at: ``L_d`` around them, if it is known already.
        """
        _, f1 = self.impulses(forces)
        if at is None:
            return self.slots(q_prev, q, forces).d2 + f1
        slots = at.slots(q_prev, q, forces) if torch.is_grad_enabled() else at.values
        return slots.d2 + f1

    def residual(
        self, q_prev: Tensor, q: Tensor, q_next: Tensor, before: Forces, after: Forces
    ) -> Float[Tensor, "batch n"]:
        """Return ``g = D₂L_d(q_{k−1}, q_k) + D₁L_d(q_k, q_{k+1}) + f⁺ + f⁻`` [N s, N m s].

        That is (5.1) of the thesis. Both intervals are evaluated as one batch.

        Args:
            q_prev: ``q_{k−1}``, (batch, n).
            q: ``q_k``.
            q_next: ``q_{k+1}``.
            before: The generalised force between ``q_{k−1}`` and ``q_k``.
            after: The generalised force between ``q_k`` and ``q_{k+1}``.
        """
        forces = Forces(*(torch.cat(pair) for pair in zip(before, after, strict=True)))
        slots = self.slots(torch.cat((q_prev, q)), torch.cat((q, q_next)), forces)
        f_minus, f_plus = self.impulses(after)[0], self.impulses(before)[1]
        return slots.d2[: q.shape[0]] + slots.d1[q.shape[0] :] + f_plus + f_minus

    def next_configuration(
        self,
        root_finder: RootFinder,
        q: Tensor,
        impulse: Tensor,
        guess: Tensor,
        forces: Forces,
    ) -> tuple[Float[Tensor, "batch n"], Root[MomentumMismatch]]:
        """Solve ``p⁻(q_k, q_{k+1}) = p_k`` for ``q_{k+1}``.

        Rows without a root keep their last iterate: see ``Root.converged``.

        Args:
            root_finder: Solver of the equations.
            q: ``q_k``, (batch, n).
            impulse: ``p_k + f⁻``, (batch, n).
            guess: Initial guess of ``q_{k+1}``, (batch, n).
            forces: The generalised force over the step.
        """
        problem, space = MomentumMatching(self, q, impulse, forces), self.integrator.space
        root = root_finder.solve(problem, problem.start(guess))
        x, at = root.x[:, : impulse.shape[1]], root.evaluation.expansion
        if not torch.is_grad_enabled():
            return space.point(q, x), root
        return differentiable_root(x, at, at.d2d1(), q, impulse, space, forces), root

    def step(
        self, root_finder: RootFinder, q: Tensor, p: Tensor, forces: Forces, guess: Tensor
    ) -> VariationalStep:
        """Map ``(q_k, p_k)`` to ``(q_{k+1}, p_{k+1})``.

        Solves ``p⁻(q_k, q_{k+1}) = p_k`` and evaluates ``p⁺``: the same map as
        ``(q_{k−1}, q_k) → (q_k, q_{k+1})`` with the momentum carried along (Marsden and West 2001,
        section 1.5). Arguments as in ``next_configuration``.
        """
        f0, f1 = self.impulses(forces)
        q_next, root = self.next_configuration(root_finder, q, p + f0, guess, forces)
        at = root.evaluation.expansion
        d2 = (at.slots(q, q_next, forces) if torch.is_grad_enabled() else at.values).d2
        return VariationalStep(q_next, d2 + f1, root)


class MomentumMatching(Rowwise):
    """The equations ``g(q₁) = p + D₁L_d(q₀, q₁) + f⁻ = 0`` of a step, as a root problem.

    The unknowns of an integrator that resolves the motion between them are solved for as well.

    Args:
        discrete: ``L_d``.
        q0: The configuration at the start of the step.
        impulse: ``p + f⁻``, which does not depend on ``q₁``: computed once a step.
        forces: The generalised force over the step.
    """

    parts = ("_discrete", "_forces", "_q0", "_impulse")

    def __init__(
        self,
        discrete: DiscreteLagrangian,
        q0: Float[Tensor, "batch n"],
        impulse: Float[Tensor, "batch n"],
        forces: Forces,
    ) -> None:
        self._discrete, self._forces = discrete, forces.detached()
        self._q0, self._impulse = q0.detach(), impulse.detach()

    def start(self, guess: Float[Tensor, "batch n"]) -> Float[Tensor, "batch k"]:
        """Return the unknowns at an initial guess of ``q₁``."""
        return self._discrete.integrator.unknowns(self._q0, guess.detach())

    def at(self, x: Float[Tensor, "batch k"]) -> MomentumMismatch:
        """Evaluate the equations."""
        expansion = self._discrete.expand_at(self._q0, x, self._forces)
        return MomentumMismatch(expansion, self._impulse)


class MomentumMismatch(Rowwise):
    """The discrete Euler-Lagrange residual at one batch of candidates."""

    parts = ("expansion", "residual")

    def __init__(self, expansion: DiscreteExpansion, impulse: Tensor) -> None:
        self.expansion = expansion
        self.residual = expansion.mismatch(impulse)

    def jacobian(self) -> Tensor:
        """Return the derivative of the residual in the unknowns."""
        return self.expansion.mismatch_jacobian()


class VariationalStep(NamedTuple):
    """One step of a variational integrator in position-momentum form."""

    q: Float[Tensor, "batch n"]
    p: Float[Tensor, "batch n"]
    root: Root[MomentumMismatch]


def differentiable_root(
    x: Float[Tensor, "batch n"],
    at: DiscreteExpansion,
    jacobian: Float[Tensor, "batch n n"],
    q: Float[Tensor, "batch N"],
    impulse: Float[Tensor, "batch n"],
    space: Space,
    forces: Forces,
) -> Float[Tensor, "batch N"]:
    """Return ``q_{k+1}`` at the root ``x``, in the chart at ``q_k``, with its implicit derivatives.

    ``L_d`` was expanded around ``q_k`` and the root.
    """
    residual = impulse + at.slots_at(q, x, forces).d1
    return space.point(q, attach_root(x, residual, jacobian))


def distinct(rows: Float[Tensor, "batch k"]) -> tuple[Tensor, Tensor]:
    """Return the indices of distinct rows, and the place of each row among them.

    ``rows[chosen]`` are all different, and ``rows[chosen][place]`` are the given rows. Sorts column
    after column: ``torch.unique`` compares whole rows and takes three times as long.
    """
    order = torch.arange(len(rows), device=rows.device)
    for column in rows.T.flip(0):
        order = order[torch.argsort(column[order], stable=True)]
    new = torch.ones(len(rows), dtype=torch.bool, device=rows.device)
    new[1:] = (rows[order[1:]] != rows[order[:-1]]).any(1)
    place = torch.empty_like(order)
    place[order] = new.cumsum(0) - 1
    return order[new], place


def block_matrix(blocks: Float[Tensor, "a b batch n n"]) -> Float[Tensor, "batch a*n b*n"]:
    """Return the matrix of these blocks for each sample."""
    return blocks.permute(2, 0, 3, 1, 4).flatten(3).flatten(1, 2)
