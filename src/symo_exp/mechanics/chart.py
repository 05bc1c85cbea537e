"""A Lagrangian in the charts of rotations at the configurations where intervals start.

The chart at ``q₀`` gives a rotation by its rotation vector ``φ``, ``R = R₀ exp φ``. There the
Lagrangian is

    ℓ(φ, φ̇) = ℒ(q₀ ⊕ φ, J(φ) φ̇)        J the right Jacobian of exp

On flat coordinates ``J`` and ``exp`` are the identity.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from typing_extensions import override

from symo_exp.mechanics.galerkin import Basis
from symo_exp.mechanics.lagrangian import (
    Curvature,
    Expansion,
    Gradients,
    Lagrangian,
    jacobian,
    matvec,
    vecmat,
)
from symo_exp.mechanics.rows import Rowwise
from symo_exp.mechanics.space import ExponentialMap, Space, cross
from symo_exp.mechanics.variational import Forces, Slots


@dataclass(frozen=True)
class Controlled:
    """A Lagrangian with the forces of its controls.

    Args:
        lagrangian: ``ℒ``.
        input_matrix: ``B``.
    """

    lagrangian: Lagrangian
    input_matrix: Float[Tensor, "n m"]

    def force(self, q: Float[Tensor, "batch N"], u: Float[Tensor, "batch m"]) -> Tensor:
        """Return the generalised force of the controls."""
        return self.lagrangian.input_force(self.input_matrix, q, u)


def control_slope(
    controlled: Controlled, space: Space, point: Float[Tensor, "batch N"], u: Tensor
) -> Float[Tensor, "batch n n"]:
    """Return the derivative of the force of controls along ``retract``."""
    with torch.enable_grad():
        q = point.detach().requires_grad_()
        force = controlled.force(q, u)
        if not force.requires_grad:  # torques in body axes
            return force.new_zeros(*force.shape, force.shape[1])
        return space.pull(point.unsqueeze(1), jacobian(force, q).detach())


def at_points(basis: Basis, q0: Tensor, controls: Forces | None) -> tuple[Tensor, Tensor | None]:
    """Return ``q₀`` and the controls for each Gauss point, the points outermost."""
    base = q0.repeat(len(basis.b), 1)
    if controls is None:
        return base, None
    tau = basis.alpha[-1].to(base).view(-1, 1, 1)
    start, end = controls
    return base, ((1.0 - tau) * start + tau * end).flatten(0, 1)


class Chart(NamedTuple):
    """The exponential map at rows of coordinates."""

    space: Space
    map: ExponentialMap
    """At the rotation vectors, a row each."""
    jacobian: Float[Tensor, "rows n n"]
    """``J``."""
    turn: Float[Tensor, "rows n n"]
    """``exp φ``."""
    rotations: Float[Tensor, "rows r 3 3"]
    """Its blocks."""

    @staticmethod
    def of(space: Space, x: Float[Tensor, "rows n"]) -> Chart:
        """Evaluate the map."""
        found, n = ExponentialMap.of(space.vectors(x)), x.shape[1]
        turn = found.turn()
        whole = space.blocks(found.jacobian(), n, 1.0), space.blocks(turn, n, 1.0)
        return Chart(space, found, *whole, turn.view(-1, space.rotations, 3, 3))

    def rate_slope(self, x: Float[Tensor, "rows n"]) -> Float[Tensor, "rows n n"]:
        """Return ``∂(J x)/∂φ``."""
        found = self.map.jacobian_slope(self.space.vectors(x))
        return self.space.blocks(found, x.shape[1], 0.0)

    def momentum_slope(self, p: Float[Tensor, "rows n"]) -> Float[Tensor, "rows n n"]:
        """Return ``∂(Jᵀ p)/∂φ``."""
        found = self.map.transposed_slope(self.space.vectors(p))
        return self.space.blocks(found, p.shape[1], 0.0)

    def bend(
        self, p: Float[Tensor, "rows n"], x: Float[Tensor, "rows n"]
    ) -> Float[Tensor, "rows n n"]:
        """Return ``∂²(p · J x)/∂φ²``."""
        found = self.map.jacobian_bend(self.space.vectors(p), self.space.vectors(x))
        return self.space.blocks(found, p.shape[1], 0.0)


class Ends(NamedTuple):
    """``J(δ)⁻¹`` between the ends of intervals."""

    space: Space
    half: ExponentialMap
    """At ``δ/2``."""
    inverse: Float[Tensor, "batch n n"]
    """``J(δ)⁻¹``."""

    @staticmethod
    def of(space: Space, x: Float[Tensor, "batch n"]) -> Ends:
        """Evaluate it."""
        return Ends.around(space, ExponentialMap.of(0.5 * space.vectors(x)), x.shape[1])

    @staticmethod
    def around(space: Space, half: ExponentialMap, n: int) -> Ends:
        """Evaluate it, given the map at ``δ/2``."""
        return Ends(space, half, space.blocks(half.inverse_of_twice(), n, 1.0))

    def slots(self, last: Float[Tensor, "batch n"], turned: Float[Tensor, "batch n"]) -> Slots:
        """Return ``D₁`` and ``D₂``, given ``D₂ℓ_d`` and ``h Σᵢ bᵢ exp(φᵢ) Mᵢ``."""
        return Slots(turned - matvec(self.inverse, last), vecmat(last, self.inverse))

    def slopes(self, last: Float[Tensor, "batch n"]) -> tuple[Tensor, Tensor]:
        """Return ``∂(J⁻¹ y)/∂δ`` and ``∂(J⁻ᵀ y)/∂δ`` at a fixed ``y``, (batch, n, n).

        ``J⁻ᵀ = J⁻¹ − [δ]``, so that the second is the first plus ``[y]``.
        """
        y, n = self.space.vectors(last), last.shape[1]
        start = 0.5 * self.half.inverse_of_twice_slope(y)
        return self.space.blocks(start, n, 0.0), self.space.blocks(start + cross(y), n, 0.0)


class Torques(NamedTuple):
    """First derivatives in the chart."""

    gradients: Gradients
    """``ℓ_φ`` and ``ℓ_φ̇``."""
    turned: Float[Tensor, "rows n"]
    """``exp(φ) M``, in the axes at the start of the interval."""


class ChartDerivatives(NamedTuple):
    """Derivatives at Gauss points."""

    curvature: Curvature
    """Those of ``ℓ``."""
    turned_q: Float[Tensor, "rows n n"]
    """Those of ``exp(φ) M`` in ``φ``."""
    turned_v: Float[Tensor, "rows n n"]
    """Those of ``exp(φ) M`` in ``φ̇``."""
    moment_q: Float[Tensor, "rows n n"]
    """Those of ``M`` along ``retract`` of the configuration."""
    momentum_q: Float[Tensor, "rows n n"]
    """Those of ``ℒ_v`` along it."""
    rate_q: Float[Tensor, "rows n n"]
    """``∂(J φ̇)/∂φ``."""


@dataclass(eq=False)
class ChartLagrangian(Rowwise):
    """``ℓ(φ, φ̇)`` at the Gauss points of intervals that start at ``q₀``.

    Args:
        controlled: ``ℒ`` and its controls.
        space: The space.
        basis: The Gauss points.
        q0: Configurations at which the intervals start.
        controls: Controls at both ends.
    """

    _controlled: Controlled
    _space: Space
    _basis: Basis
    _q0: Float[Tensor, "batch N"]
    _controls: Forces | None

    def expand(self, q: Float[Tensor, "rows n"], v: Float[Tensor, "rows n"]) -> ChartExpansion:
        """Return ``ℓ`` around ``(φ, φ̇)``."""
        base, u = at_points(self._basis, self._q0, self._controls)
        return ChartExpansion.of(self._controlled, self._space, base, u, q, v)


@dataclass(eq=False)
class ChartExpansion(Expansion):
    """``ℓ`` around rows of Gauss points.

    Args:
        controlled: ``ℒ`` and its controls.
        space: The space.
        base: Configuration at which the interval of each row starts.
        u: Controls there.
        q: ``φ``.
        v: ``φ̇``.
        at: ``ℒ`` around ``(q₀ ⊕ φ, J φ̇)``.
        values: ``ℓ_φ`` and ``ℓ_φ̇``.
        turned: ``exp(φ) M``.
    """

    controlled: Controlled
    space: Space
    base: Tensor
    u: Tensor | None
    q: Tensor
    v: Tensor
    at: Expansion
    values: Gradients
    turned: Tensor

    @cached_property
    def chart(self) -> Chart:
        """The exponential map at the rows."""
        return Chart.of(self.space, self.q)

    @staticmethod
    @torch.no_grad()
    def of(
        controlled: Controlled, space: Space, base: Tensor, u: Tensor | None, q: Tensor, v: Tensor
    ) -> ChartExpansion:
        """Expand around ``(φ, φ̇)``."""
        chart = Chart.of(space, q)
        point = space.turned(base, q, chart.rotations)
        at = controlled.lagrangian.expand(point, matvec(chart.jacobian, v))
        found = _torques(controlled, chart, point, u, v, at.values)
        expansion = ChartExpansion(controlled, space, base, u, q, v, at, *found)
        expansion.chart = chart
        return expansion

    @property
    def dissipates(self) -> bool:  # type: ignore[override]
        """True if there is a dissipative force."""
        return self.at.dissipates

    @override
    def mass(self) -> Tensor:
        return self.chart.jacobian.mT @ self.at.mass() @ self.chart.jacobian

    @override
    def damping(self) -> Tensor:
        return self.chart.jacobian.mT @ self.at.damping() @ self.chart.jacobian

    @override
    def curvature(self, before: Expansion | None = None) -> Curvature:
        assert before is None or isinstance(before, ChartExpansion)
        return self.derivatives(before).curvature

    def derivatives(self, before: ChartExpansion | None = None) -> ChartDerivatives:
        """Return the derivatives of ``ℓ_φ``, ``ℓ_φ̇`` and ``exp(φ) M``."""
        chart, p = self.chart, self.at.values.v
        turning, rate = chart.jacobian, chart.rate_slope(self.v)
        along = self.at.curvature(None if before is None else before.at)
        moment, moment_q = self._moment(along.qq)
        mass = self.at.mass()
        by_q = moment_q @ turning + along.qv @ rate  # of M
        p_by_q = along.vq @ turning + mass @ rate
        p_by_v = mass @ turning
        m_by_v = along.qv @ turning
        lean = chart.momentum_slope(p)
        qq = turning.mT @ by_q + rate.mT @ p_by_q
        qq = qq + chart.momentum_slope(moment) + chart.bend(p, self.v)
        curvature = Curvature(
            qq, turning.mT @ p_by_q + lean, turning.mT @ m_by_v + rate.mT @ p_by_v + lean.mT
        )
        blocks = self.space.blocks(cross(self.space.vectors(moment)), moment.shape[1], 0.0)
        by_q = chart.turn @ (by_q - blocks @ turning)
        return ChartDerivatives(curvature, by_q, chart.turn @ m_by_v, moment_q, along.vq, rate)

    def by_turn(self, found: ChartDerivatives) -> Torques:
        """Return the derivatives of ``torques`` in turns of ``q₀``, (rows, n, n)."""
        chart, turning = self.chart, self.chart.jacobian
        turns = chart.turn.mT * self.space.turns(self.v)  # in the axes at the points
        moment_q, p_q = found.moment_q @ turns, found.momentum_q @ turns
        by_q = turning.mT @ moment_q + found.rate_q.mT @ p_q
        return Torques(Gradients(by_q, turning.mT @ p_q), chart.turn @ moment_q)

    def _moment(self, by_q: Tensor) -> tuple[Tensor, Tensor]:
        """Return ``M`` with the controls, and its derivative along the configuration."""
        moment = self.at.values.q
        if self.u is None:
            return moment, by_q
        point = self.space.turned(self.base, self.q, self.chart.rotations)
        slope = control_slope(self.controlled, self.space, point, self.u)
        return moment + self.controlled.force(point, self.u).detach(), by_q + slope

    @override
    def gradients(self, q: Tensor, v: Tensor) -> Gradients:
        return self.torques(self.base, self.u, q, v).gradients

    def torques(self, base: Tensor, u: Tensor | None, q: Tensor, v: Tensor) -> Torques:
        """Return the first derivatives, differentiable in all arguments and the parameters."""
        chart = Chart.of(self.space, q) if q.requires_grad else self.chart
        point = self.space.turned(base, q, chart.rotations)
        gradients = self.at.gradients(point, matvec(chart.jacobian, v))
        return _torques(self.controlled, chart, point, u, v, gradients)


def _torques(
    controlled: Controlled, chart: Chart, point: Tensor, u: Tensor | None, v: Tensor, at: Gradients
) -> Torques:
    """Return ``Jᵀ M + (∂(J φ̇)/∂φ)ᵀ p``, ``Jᵀ p`` and ``exp(φ) M``."""
    moment, p = at
    if u is not None:
        moment = moment + controlled.force(point, u)
    by_q = vecmat(moment, chart.jacobian) + vecmat(p, chart.rate_slope(v))
    return Torques(Gradients(by_q, vecmat(p, chart.jacobian)), matvec(chart.turn, moment))
