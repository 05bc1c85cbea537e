"""Variational integrators: the discrete Euler-Lagrange equations (thesis sections 3.3 and 5.1).

Everything is said in the two momenta of an interval ``[t_k, t_{k+1}]``, the forced discrete
Legendre transforms (3.41), (3.42), here with their corrected indices:

    p⁻(q_k, q_{k+1}) = −D₁L_d(q_k, q_{k+1}) − f⁻        p⁺(q_k, q_{k+1}) = D₂L_d(q_k, q_{k+1}) + f⁺

The discrete Euler-Lagrange equations (3.43) match them at a node:

    g(q_{k+1}) = p⁺(q_{k−1}, q_k) − p⁻(q_k, q_{k+1}) = 0
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from symo_exp.mechanics.implicit import attach_root
from symo_exp.mechanics.lagrangian import Expansion, Lagrangian
from symo_exp.mechanics.roots import Root, RootFinder


class Forces(NamedTuple):
    """The generalised force at both ends of an interval, linear in time between them [N or N m]."""

    start: Float[Tensor, "batch n"]
    end: Float[Tensor, "batch n"]

    def rows(self, index: Tensor) -> Forces:
        """The same for some rows of the batch."""
        return Forces(self.start[index], self.end[index])


class Slots(NamedTuple):
    """The slot derivatives of a discrete Lagrangian ``L_d(q₀, q₁)``."""

    d1: Float[Tensor, "batch n"]
    """``D₁L_d = ∂L_d/∂q₀``."""
    d2: Float[Tensor, "batch n"]
    """``D₂L_d = ∂L_d/∂q₁``."""


class DiscreteExpansion(ABC):
    """``L_d`` around a batch of pairs ``(q₀, q₁)``; see ``lagrangian.Expansion``."""

    values: Slots

    @abstractmethod
    def d2d1(self) -> Float[Tensor, "batch n n"]:
        """``∂²L_d/∂q₀ᵢ∂q₁ⱼ``, the Jacobian of the discrete Euler-Lagrange equations."""

    def mismatch(self, impulse: Float[Tensor, "batch n"]) -> Float[Tensor, "batch k"]:
        """What a step makes vanish, ``impulse + D₁L_d``, and what else it solves alongside."""
        return impulse + self.values.d1

    def mismatch_jacobian(self) -> Float[Tensor, "batch k k"]:
        """The derivative of ``mismatch`` in ``q₁`` and the other unknowns of a step."""
        return self.d2d1()

    @abstractmethod
    def slots(self, q0: Tensor, q1: Tensor, forces: Forces | None = None) -> Slots:
        """The slot derivatives, differentiable; the arguments hold the values of the point."""

    @abstractmethod
    def rows(self, index: Tensor) -> DiscreteExpansion:
        """The same for some rows of the batch."""

    @abstractmethod
    def replace(self, index: Tensor, other: DiscreteExpansion) -> DiscreteExpansion:
        """This expansion with the given rows taken from ``other``."""


class VariationalIntegrator(ABC):
    """A discrete Lagrangian made from a continuous one, with the forces that go with it.

    ``forces`` of ``slots`` and ``expand`` bend the motion between two configurations, which an
    integrator that resolves it must know (left out, there are none); their impulses on the
    configurations themselves come from ``impulses``.
    """

    name: str
    order: int
    iterates = False
    """Whether it solves for the motion between two configurations."""

    @abstractmethod
    def slots(
        self,
        lagrangian: Lagrangian,
        q0: Float[Tensor, "batch n"],
        q1: Float[Tensor, "batch n"],
        h: float,
        forces: Forces | None = None,
    ) -> Slots:
        """``D₁L_d``, ``D₂L_d``, differentiable in configurations, forces and parameters."""

    @abstractmethod
    def expand(
        self,
        lagrangian: Lagrangian,
        q0: Float[Tensor, "batch n"],
        q1: Float[Tensor, "batch n"],
        h: float,
        forces: Forces | None = None,
    ) -> DiscreteExpansion:
        """``L_d`` around ``(q₀, q₁)``, as root finding needs it."""

    def unknowns(self, q1: Float[Tensor, "batch n"]) -> Float[Tensor, "batch k"]:
        """What a step solves for, ``q₁`` first, before anything but ``q₁`` is known."""
        return q1

    def expand_at(
        self,
        lagrangian: Lagrangian,
        q0: Float[Tensor, "batch n"],
        x: Float[Tensor, "batch k"],
        h: float,
        forces: Forces | None = None,
    ) -> DiscreteExpansion:
        """``L_d`` around ``q₀`` and the unknowns ``x`` of a step."""
        return self.expand(lagrangian, q0, x, h, forces)

    @abstractmethod
    def impulses(
        self, force0: Float[Tensor, "batch n"], force1: Float[Tensor, "batch n"], h: float
    ) -> tuple[Float[Tensor, "batch n"], Float[Tensor, "batch n"]]:
        """Discrete forces ``f⁻`` (on ``q₀``) and ``f⁺`` (on ``q₁``) of a linear force [N s]."""

    def converged(self) -> VariationalIntegrator:
        """The same integrator with whatever it iterates carried to convergence."""
        return self


class VariationalMidpoint(VariationalIntegrator):
    """The midpoint rule, ``L_d(q₀, q₁) = h ℒ((q₀+q₁)/2, (q₁−q₀)/h)`` (thesis (5.4)), order 2.

    With ``q̄ = (q₀+q₁)/2`` and ``v̄ = (q₁−q₀)/h``

        D₁L_d = h/2 ℒ_q(q̄, v̄) − H(q̄) v̄        D₂L_d = h/2 ℒ_q(q̄, v̄) + H(q̄) v̄

    and ``f⁻ = f⁺ = h/4 (F₀ + F₁)`` (thesis (5.15), (5.16)).
    """

    name = "midpoint"
    order = 2

    def slots(
        self, lagrangian: Lagrangian, q0: Tensor, q1: Tensor, h: float, forces: Forces | None = None
    ) -> Slots:
        gradients = lagrangian.gradients(0.5 * (q0 + q1), (q1 - q0) / h)
        return _midpoint_slots(gradients.q, gradients.v, h)

    def expand(
        self, lagrangian: Lagrangian, q0: Tensor, q1: Tensor, h: float, forces: Forces | None = None
    ) -> MidpointExpansion:
        return MidpointExpansion(lagrangian.expand(0.5 * (q0 + q1), (q1 - q0) / h), h)

    def impulses(self, force0: Tensor, force1: Tensor, h: float) -> tuple[Tensor, Tensor]:
        half = (h / 4) * (force0 + force1)
        return half, half


class MidpointExpansion(DiscreteExpansion):
    """The midpoint discrete Lagrangian around ``(q₀, q₁)``."""

    def __init__(self, at: Expansion, h: float) -> None:
        self._at, self._h = at, h
        self.values = _midpoint_slots(at.values.q, at.values.v, h)

    def d2d1(self) -> Tensor:
        """``h/4 ℒ_qq + ½ ℒ_qv − ½ ℒ_vq − H/h`` at the midpoint."""
        curvature = self._at.curvature()
        skew = 0.5 * (curvature.qv - curvature.vq)
        return (self._h / 4) * curvature.qq + skew - self._at.mass() / self._h

    def slots(self, q0: Tensor, q1: Tensor, forces: Forces | None = None) -> Slots:
        gradients = self._at.gradients(0.5 * (q0 + q1), (q1 - q0) / self._h)
        return _midpoint_slots(gradients.q, gradients.v, self._h)

    def rows(self, index: Tensor) -> MidpointExpansion:
        return MidpointExpansion(self._at.rows(index), self._h)

    def replace(self, index: Tensor, other: DiscreteExpansion) -> MidpointExpansion:
        assert isinstance(other, MidpointExpansion)
        return MidpointExpansion(self._at.replace(index, other._at), self._h)


def _midpoint_slots(dq: Tensor, p: Tensor, h: float) -> Slots:
    impulse = (0.5 * h) * dq
    return Slots(impulse - p, impulse + p)


class MomentumMatching:
    """``g(q₁) = p + D₁L_d(q₀, q₁) + f⁻ = 0``: the ``q₁`` for a momentum ``p`` at ``q₀``.

    An integrator that resolves the motion between them has its unknowns found alongside.
    """

    def __init__(
        self,
        integrator: VariationalIntegrator,
        lagrangian: Lagrangian,
        q0: Float[Tensor, "batch n"],
        impulse: Float[Tensor, "batch n"],
        h: float,
        forces: Forces | None = None,
    ) -> None:
        """``impulse = p + f⁻`` is what does not depend on ``q₁``: computed once a step."""
        self._integrator, self._lagrangian = integrator, lagrangian
        self._q0, self._impulse, self._h = q0.detach(), impulse.detach(), h
        self._forces = forces and Forces(forces.start.detach(), forces.end.detach())

    def start(self, guess: Float[Tensor, "batch n"]) -> Float[Tensor, "batch k"]:
        """The unknowns with which the search for ``q₁`` starts."""
        return self._integrator.unknowns(guess.detach())

    def at(self, x: Tensor, index: Tensor | None = None) -> MomentumMismatch:
        q0, impulse, forces = self._q0, self._impulse, self._forces
        if index is not None:
            q0, impulse, forces = q0[index], impulse[index], forces and forces.rows(index)
        expansion = self._integrator.expand_at(self._lagrangian, q0, x, self._h, forces)
        return MomentumMismatch(expansion, impulse)


class MomentumMismatch:
    """The discrete Euler-Lagrange residual at one candidate."""

    def __init__(self, expansion: DiscreteExpansion, impulse: Tensor) -> None:
        self.expansion, self._impulse = expansion, impulse
        self.residual = expansion.mismatch(impulse)

    def jacobian(self) -> Tensor:
        return self.expansion.mismatch_jacobian()

    def rows(self, index: Tensor) -> MomentumMismatch:
        return MomentumMismatch(self.expansion.rows(index), self._impulse[index])

    def replace(self, index: Tensor, other: MomentumMismatch) -> MomentumMismatch:
        impulse = self._impulse.index_copy(0, index, other._impulse)
        return MomentumMismatch(self.expansion.replace(index, other.expansion), impulse)


class VariationalStep(NamedTuple):
    """One step of a variational integrator in position-momentum form."""

    q: Float[Tensor, "batch n"]
    p: Float[Tensor, "batch n"]
    root: Root[MomentumMismatch]


def next_configuration(
    integrator: VariationalIntegrator,
    lagrangian: Lagrangian,
    root_finder: RootFinder,
    q: Float[Tensor, "batch n"],
    impulse: Float[Tensor, "batch n"],
    h: float,
    guess: Float[Tensor, "batch n"],
    *,
    forces: Forces | None = None,
) -> tuple[Float[Tensor, "batch n"], Root[MomentumMismatch]]:
    """``q_{k+1}`` with ``p⁻(q_k, q_{k+1}) = p_k``, given ``impulse = p_k + f⁻``.

    Differentiable in ``q``, ``impulse``, ``forces`` and the parameters by the implicit function
    theorem, where gradients are enabled. Rows without a root keep their last iterate: see
    ``Root.converged``.
    """
    problem = MomentumMatching(integrator, lagrangian, q, impulse, h, forces)
    root = root_finder.solve(problem, problem.start(guess))
    x, at = root.x[:, : q.shape[1]], root.evaluation.expansion
    if not torch.is_grad_enabled():
        return x, root
    return differentiable_root(x, at, at.d2d1(), q, impulse, forces), root


def differentiable_root(
    x: Float[Tensor, "batch n"],
    at: DiscreteExpansion,
    jacobian: Float[Tensor, "batch n n"],
    q: Float[Tensor, "batch n"],
    impulse: Float[Tensor, "batch n"],
    forces: Forces | None = None,
) -> Float[Tensor, "batch n"]:
    """The root ``x``, around which ``L_d`` was expanded, with its implicit derivatives."""
    return attach_root(x, impulse + at.slots(q, x, forces).d1, jacobian)


def variational_step(
    integrator: VariationalIntegrator,
    lagrangian: Lagrangian,
    root_finder: RootFinder,
    q: Float[Tensor, "batch n"],
    p: Float[Tensor, "batch n"],
    force: Float[Tensor, "batch n"],
    force_next: Float[Tensor, "batch n"],
    h: float,
    guess: Float[Tensor, "batch n"],
) -> VariationalStep:
    """``(q_k, p_k) → (q_{k+1}, p_{k+1})``: solve ``p⁻(q_k, q_{k+1}) = p_k``, then ``p⁺``.

    The same map as ``(q_{k−1}, q_k) → (q_k, q_{k+1})`` with the momentum carried along (Marsden
    and West 2001, section 1.5). Differentiable like ``next_configuration``.
    """
    f0, f1 = integrator.impulses(force, force_next, h)
    forces = Forces(force, force_next)
    q_next, root = next_configuration(
        integrator, lagrangian, root_finder, q, p + f0, h, guess, forces=forces
    )
    at = root.evaluation.expansion
    d2 = (at.slots(q, q_next, forces) if torch.is_grad_enabled() else at.values).d2
    return VariationalStep(q_next, d2 + f1, root)


def momentum_before(
    integrator: VariationalIntegrator,
    lagrangian: Lagrangian,
    q_prev: Float[Tensor, "batch n"],
    q: Float[Tensor, "batch n"],
    force_prev: Float[Tensor, "batch n"],
    force: Float[Tensor, "batch n"],
    h: float,
    at: DiscreteExpansion | None = None,
) -> Float[Tensor, "batch n"]:
    """``p_k = p⁺(q_{k−1}, q_k)``, the discrete Legendre transform of two configurations (3.41).

    ``at``: ``L_d`` around them, where it is known already.
    """
    _, f1 = integrator.impulses(force_prev, force, h)
    forces = Forces(force_prev, force)
    if at is not None:
        return at.slots(q_prev, q, forces).d2 + f1
    return integrator.slots(lagrangian, q_prev, q, h, forces).d2 + f1


def del_residual(
    integrator: VariationalIntegrator,
    lagrangian: Lagrangian,
    q_prev: Float[Tensor, "batch n"],
    q: Float[Tensor, "batch n"],
    q_next: Float[Tensor, "batch n"],
    force_prev: Float[Tensor, "batch n"],
    force: Float[Tensor, "batch n"],
    force_next: Float[Tensor, "batch n"],
    h: float,
) -> Float[Tensor, "batch n"]:
    """``g = D₂L_d(q_{k−1}, q_k) + D₁L_d(q_k, q_{k+1}) + f⁺ + f⁻`` [N s] (thesis (5.1)).

    Both intervals are evaluated as one batch. Differentiable in the configurations, the forces and
    the parameters of the Lagrangian.
    """
    forces = Forces(torch.cat((force_prev, force)), torch.cat((force, force_next)))
    slots = integrator.slots(lagrangian, torch.cat((q_prev, q)), torch.cat((q, q_next)), h, forces)
    f_minus = integrator.impulses(force, force_next, h)[0]
    f_plus = integrator.impulses(force_prev, force, h)[1]
    return slots.d2[: len(q)] + slots.d1[len(q) :] + f_plus + f_minus


def distinct(rows: Float[Tensor, "batch k"]) -> tuple[Tensor, Tensor]:
    """``chosen`` and ``place`` with ``rows[chosen]`` all different and ``rows[chosen][place]`` the
    given ones.

    By sorting column after column: ``torch.unique`` compares whole rows, three times as slowly.
    """
    order = torch.arange(len(rows), device=rows.device)
    for column in rows.T.flip(0):
        order = order[torch.argsort(column[order], stable=True)]
    new = torch.ones(len(rows), dtype=torch.bool, device=rows.device)
    new[1:] = (rows[order[1:]] != rows[order[:-1]]).any(1)
    place = torch.empty_like(order)
    place[order] = new.cumsum(0) - 1
    return order[new], place
