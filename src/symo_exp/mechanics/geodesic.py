"""Variational integrators on rotations (Lee, Leok and McClamroch 2007; Hall and Leok 2017).

The motion over an interval is that of ``mechanics.galerkin``, a polynomial, in the chart at the
configuration ``q₀`` where the interval starts: ``R(t) = R₀ exp φ(t)`` from ``φ = 0`` to
``δ = log R₀ᵀR₁``. There the Lagrangian is

    ℓ(φ, φ̇) = ℒ(q₀ ⊕ φ, J(φ) φ̇)        J the right Jacobian of exp

and its slot derivative in ``δ`` gives that in ``q₁``. The one in ``q₀``, with which the chart
moves, follows from a turn of the whole motion: it changes the action by the torques ``M`` in body
axes, of ``∂ℒ/∂q``, dissipation and controls, at the Gauss points.

    D₂ = J(δ)⁻ᵀ D₂ℓ_d        D₁ = −J(δ)⁻¹ D₂ℓ_d + h Σᵢ bᵢ exp(φᵢ) Mᵢ

The motion is a geodesic where nothing acts and the inertia is that of a ball. On flat coordinates
``J`` and ``exp`` are the identity, and these are the formulas of ``mechanics.galerkin``. Controls
are linear in time and act at the Gauss points.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from typing_extensions import override

from symo_exp.errors import ConfigError
from symo_exp.mechanics.galerkin import Basis, Galerkin, GalerkinExpansion
from symo_exp.mechanics.lagrangian import (
    Curvature,
    Expansion,
    Gradients,
    Lagrangian,
    jacobian,
    matvec,
    vecmat,
)
from symo_exp.mechanics.rows import Rowwise, take_rows
from symo_exp.mechanics.space import ExponentialSeries, Space, cross, polynomial, polynomial_slope
from symo_exp.mechanics.variational import (
    DiscreteExpansion,
    Forces,
    Slots,
    VariationalIntegrator,
    block_matrix,
)


def on_space(integrator: VariationalIntegrator, space: Space) -> VariationalIntegrator:
    """Return the integrator, or its extension to a space with rotations.

    Raises:
        ConfigError: If it has none.
    """
    if not space.rotations:
        return integrator
    if integrator.stages is None:
        raise ConfigError(
            f"integrator={integrator.name} moves lengths and angles only, and the system has "
            "rotations; choose midpoint, galerkin4 or galerkin6"
        )
    if integrator.stages == 1:
        return GeodesicMidpoint(space)
    return Geodesic(space=space, stages=integrator.stages)


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


class Geodesic(Galerkin):
    """The Galerkin integrator in the chart at the start of an interval, order ``2 stages``.

    Its ``forces`` are the controls at both ends of an interval.

    Args:
        space: The space.
        stages: Number of Gauss points.
        tolerance: Bound on the last update of inner coefficients, relative to the displacement.
        max_iterations: Bound on the number of updates.
    """

    def __init__(
        self, *, space: Space, stages: int, tolerance: float = 1e-12, max_iterations: int = 12
    ) -> None:
        super().__init__(stages=stages, tolerance=tolerance, max_iterations=max_iterations)
        self.space, self.name, self.iterates = space, f"geodesic{self.order}", True

    @override
    @torch.no_grad()
    def expand(  # type: ignore[override]
        self, lagrangian: Controlled, q0: Tensor, q1: Tensor, h: float, forces: Forces | None = None
    ) -> GeodesicExpansion:
        chart, x = self._chart(lagrangian, q0, forces), self.space.chart(q0, q1)
        at = super().expand(chart, self.space.origin(q0), x, h)
        return GeodesicExpansion(self.space, at, x)

    @override
    @torch.no_grad()
    def expand_at(  # type: ignore[override]
        self, lagrangian: Controlled, q0: Tensor, x: Tensor, h: float, forces: Forces | None = None
    ) -> GeodesicExpansion:
        chart, origin = self._chart(lagrangian, q0, forces), self.space.origin(q0)
        at = super().expand_at(chart, origin, x, h)
        return GeodesicExpansion(self.space, at, x[:, : origin.shape[1]])

    @override
    def unknowns(self, q0: Tensor, q1: Tensor) -> Tensor:
        return super().unknowns(q0, self.space.chart(q0, q1))

    @override
    def converged(self) -> Geodesic:
        return Geodesic(space=self.space, stages=self.stages)

    @override
    def impulses(self, force0: Tensor, force1: Tensor, h: float) -> tuple[Tensor, Tensor]:
        """Return zeros: controls act between the configurations."""
        zero = force0.new_zeros(())
        return zero, zero

    def _chart(self, lagrangian: Controlled, q0: Tensor, forces: Forces | None) -> ChartLagrangian:
        return ChartLagrangian(lagrangian, self.space, self._basis, q0.detach(), detached(forces))


def detached(forces: Forces | None) -> Forces | None:
    """Return forces without a graph."""
    return forces and Forces(forces.start.detach(), forces.end.detach())


class ChartLagrangian(Rowwise, Lagrangian):
    """``ℓ(φ, φ̇)`` at the Gauss points of intervals that start at ``q₀``.

    Args:
        controlled: ``ℒ`` and its controls.
        space: The space.
        basis: The Gauss points.
        q0: Configurations at which the intervals start.
        controls: Controls at both ends.
    """

    parts = ("_controlled", "_space", "_basis", "_q0", "_controls")

    def __init__(
        self,
        controlled: Controlled,
        space: Space,
        basis: Basis,
        q0: Float[Tensor, "batch N"],
        controls: Forces | None,
    ) -> None:
        self._controlled, self._space, self._basis = controlled, space, basis
        self._q0, self._controls = q0, controls

    @override
    def expand(self, q: Float[Tensor, "rows n"], v: Float[Tensor, "rows n"]) -> ChartExpansion:
        base, u = at_points(self._basis, self._q0, self._controls)
        return ChartExpansion.of(self._controlled, self._space, base, u, q, v)

    @override
    def mass_matrix(self, q: Float[Tensor, "rows n"]) -> Float[Tensor, "rows n n"]:
        jacobian = Chart.of(self._space, q).jacobian
        return jacobian.mT @ self._controlled.lagrangian.mass_matrix(self._point(q)) @ jacobian

    @override
    def potential(self, q: Float[Tensor, "rows n"]) -> Float[Tensor, " rows"]:
        return self._controlled.lagrangian.potential(self._point(q))

    def _point(self, q: Tensor) -> Tensor:
        return self._space.point(at_points(self._basis, self._q0, None)[0], q)


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
    phi: Float[Tensor, "rows*r 3"]
    """Rotation vectors, a row each."""
    series: ExponentialSeries
    jacobian: Float[Tensor, "rows n n"]
    """``J``."""
    turn: Float[Tensor, "rows n n"]
    """``exp φ``."""
    rotations: Float[Tensor, "rows r 3 3"]
    """Its blocks."""

    @staticmethod
    def of(space: Space, x: Float[Tensor, "rows n"]) -> Chart:
        """Evaluate the map."""
        phi = space.vectors(x)
        series, n = ExponentialSeries.of(phi), x.shape[1]
        jacobian = polynomial(phi, series.s, -series.a, series.b)
        turn = polynomial(phi, series.s, series.sinc, series.a)
        whole = space.blocks(jacobian, n, 1.0), space.blocks(turn, n, 1.0)
        return Chart(space, phi, series, *whole, turn.unflatten(0, (-1, space.rotations)))

    def rate_slope(self, x: Float[Tensor, "rows n"]) -> Float[Tensor, "rows n n"]:
        """Return ``∂(J x)/∂φ``."""
        c = self.series
        found = polynomial_slope(self.phi, self.space.vectors(x), c.s, (-c.a, -c.a1), (c.b, c.b1))
        return self.space.blocks(found, x.shape[1], 0.0)

    def momentum_slope(self, p: Float[Tensor, "rows n"]) -> Float[Tensor, "rows n n"]:
        """Return ``∂(Jᵀ p)/∂φ``."""
        c = self.series
        found = polynomial_slope(self.phi, self.space.vectors(p), c.s, (c.a, c.a1), (c.b, c.b1))
        return self.space.blocks(found, p.shape[1], 0.0)

    def bend(
        self, p: Float[Tensor, "rows n"], x: Float[Tensor, "rows n"]
    ) -> Float[Tensor, "rows n n"]:
        """Return ``∂²(p · J x)/∂φ²``.

        ``p · J x = p·x − a φ·c + b G`` with ``c = x × p``, ``G = (p·φ)(x·φ) − s p·x``.
        """
        phi, n = self.phi, p.shape[1]
        s, _, _, a1, a2, b, b1, b2, *_ = (y[:, None, None] for y in self.series)
        p, x = self.space.vectors(p), self.space.vectors(x)
        c = torch.linalg.cross(x, p)
        along, by_p, by_x, inner = (
            (u * w).sum(-1)[:, None, None] for u, w in ((phi, c), (p, phi), (x, phi), (p, x))
        )
        slope = by_x.squeeze(-1) * p + by_p.squeeze(-1) * x - 2.0 * inner.squeeze(-1) * phi
        g = by_p * by_x - s * inner

        def outer(u: Tensor, w: Tensor) -> Tensor:
            return u.unsqueeze(-1) * w.unsqueeze(-2)

        mixed = outer(2.0 * (b1.squeeze(-1) * slope - a1.squeeze(-1) * c), phi)
        found = mixed + mixed.mT + 4.0 * (b2 * g - a2 * along) * outer(phi, phi)
        pair = outer(p, x)
        found = found + b * (pair + pair.mT)
        one = torch.eye(3, dtype=phi.dtype, device=phi.device)
        found = found + 2.0 * (b1 * g - a1 * along - b * inner) * one
        return self.space.blocks(found, n, 0.0)


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

    parts = ("_controlled", "_space", "_base", "_u", "_q", "_v", "_at", "values", "turned")

    def __init__(
        self,
        controlled: Controlled,
        space: Space,
        base: Tensor,
        u: Tensor | None,
        q: Tensor,
        v: Tensor,
        at: Expansion,
        values: Gradients,
        turned: Tensor,
    ) -> None:
        self._controlled, self._space, self._base, self._u = controlled, space, base, u
        self._q, self._v, self._at = q, v, at
        self.values, self.turned = values, turned
        self._chart: Chart | None = None

    @property
    def chart(self) -> Chart:
        """The exponential map at the rows."""
        if self._chart is None:
            self._chart = Chart.of(self._space, self._q)
        return self._chart

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
        expansion._chart = chart
        return expansion

    @property
    def dissipates(self) -> bool:  # type: ignore[override]
        """True if there is a dissipative force."""
        return self._at.dissipates

    @override
    def mass(self) -> Tensor:
        return self.chart.jacobian.mT @ self._at.mass() @ self.chart.jacobian

    @override
    def damping(self) -> Tensor:
        return self.chart.jacobian.mT @ self._at.damping() @ self.chart.jacobian

    @override
    def curvature(self, before: Expansion | None = None) -> Curvature:
        assert before is None or isinstance(before, ChartExpansion)
        return self.derivatives(before).curvature

    def derivatives(self, before: ChartExpansion | None = None) -> ChartDerivatives:
        """Return the derivatives of ``ℓ_φ``, ``ℓ_φ̇`` and ``exp(φ) M``."""
        chart, p = self.chart, self._at.values.v
        turning, rate = chart.jacobian, chart.rate_slope(self._v)
        along = self._at.curvature(None if before is None else before._at)
        moment, moment_q = self._moment(along.qq)
        mass = self._at.mass()
        by_q = moment_q @ turning + along.qv @ rate  # of M
        p_by_q = along.vq @ turning + mass @ rate
        p_by_v = mass @ turning
        m_by_v = along.qv @ turning
        lean = chart.momentum_slope(p)
        qq = turning.mT @ by_q + rate.mT @ p_by_q
        qq = qq + chart.momentum_slope(moment) + chart.bend(p, self._v)
        curvature = Curvature(
            qq, turning.mT @ p_by_q + lean, turning.mT @ m_by_v + rate.mT @ p_by_v + lean.mT
        )
        blocks = self._space.blocks(cross(self._space.vectors(moment)), moment.shape[1], 0.0)
        by_q = chart.turn @ (by_q - blocks @ turning)
        return ChartDerivatives(curvature, by_q, chart.turn @ m_by_v, moment_q, along.vq, rate)

    def by_turn(self, found: ChartDerivatives) -> Torques:
        """Return the derivatives of ``torques`` in turns of ``q₀``, (rows, n, n)."""
        chart, turning = self.chart, self.chart.jacobian
        turns = chart.turn.mT * self._space.turns(self._v)  # in the axes at the points
        moment_q, p_q = found.moment_q @ turns, found.momentum_q @ turns
        by_q = turning.mT @ moment_q + found.rate_q.mT @ p_q
        return Torques(Gradients(by_q, turning.mT @ p_q), chart.turn @ moment_q)

    def _moment(self, by_q: Tensor) -> tuple[Tensor, Tensor]:
        """Return ``M`` with the controls, and its derivative along the configuration."""
        moment = self._at.values.q
        if self._u is None:
            return moment, by_q
        point = self._space.turned(self._base, self._q, self.chart.rotations)
        slope = control_slope(self._controlled, self._space, point, self._u)
        return moment + self._controlled.force(point, self._u).detach(), by_q + slope

    @override
    def gradients(self, q: Tensor, v: Tensor) -> Gradients:
        return self.torques(self._base, self._u, q, v).gradients

    def torques(self, base: Tensor, u: Tensor | None, q: Tensor, v: Tensor) -> Torques:
        """Return the first derivatives, differentiable in all arguments and the parameters."""
        return torques(self._controlled, self._space, base, u, q, v, self._at)


def torques(
    controlled: Controlled,
    space: Space,
    base: Tensor,
    u: Tensor | None,
    q: Tensor,
    v: Tensor,
    at: Expansion | None = None,
) -> Torques:
    """Return the first derivatives in the charts at ``base``, differentiable in all arguments.

    Args:
        controlled: ``ℒ`` and its controls.
        space: The space.
        base: Configurations at which the intervals start.
        u: Controls.
        q: ``φ``.
        v: ``φ̇``.
        at: ``ℒ`` around these points, if known.
    """
    chart = Chart.of(space, q)
    point = space.turned(base, q, chart.rotations)
    gradients = (at or controlled.lagrangian).gradients(point, matvec(chart.jacobian, v))
    return _torques(controlled, chart, point, u, v, gradients)


def _torques(
    controlled: Controlled, chart: Chart, point: Tensor, u: Tensor | None, v: Tensor, at: Gradients
) -> Torques:
    """Return ``Jᵀ M + (∂(J φ̇)/∂φ)ᵀ p``, ``Jᵀ p`` and ``exp(φ) M``."""
    moment, p = at
    if u is not None:
        moment = moment + controlled.force(point, u)
    by_q = vecmat(moment, chart.jacobian) + vecmat(p, chart.rate_slope(v))
    return Torques(Gradients(by_q, vecmat(p, chart.jacobian)), matvec(chart.turn, moment))


class GeodesicExpansion(DiscreteExpansion):
    """The discrete Lagrangian around ``(q₀, q₁)``, in body axes of these.

    Args:
        space: The space.
        at: The discrete Lagrangian of ``ℓ``.
        x: ``q₁`` in the chart at ``q₀``.
    """

    def __init__(self, space: Space, at: GalerkinExpansion, x: Float[Tensor, "batch n"]) -> None:
        self._space, self._at, self._x = space, at, x
        assert isinstance(at.at, ChartExpansion)
        self._points = at.at
        last = at.values.d2
        self._ends = Ends.of(space, x)
        self.values = self._ends.slots(last, at.basis.total(self._points.turned, at.h))
        self._condensed: tuple[Tensor, Tensor] | None = None

    @override
    def d2d1(self) -> Tensor:
        return self._condense()[0]

    @override
    def mismatch(self, impulse: Tensor) -> Tensor:
        inner = self._at.stationarity.transpose(0, 1).flatten(1)
        return torch.cat((impulse + self.values.d1, inner), dim=1)

    @override
    def mismatch_jacobian(self) -> Tensor:
        derivatives = self._derivatives()[:-1]
        return block_matrix(torch.cat((derivatives[:, -1:], derivatives[:, :-1]), dim=1))

    @override
    def slots(self, q0: Tensor, q1: Tensor, forces: Forces | None = None) -> Slots:
        at, space = self._at, self._space
        basis, inner = at.basis, at.inner
        x = space.chart(q0, q1)
        path = basis.path(space.origin(q0), x, inner, at.h)
        torques = self._points.torques(*at_points(basis, q0, forces), *path)
        slopes = basis.slopes(torques.gradients, at.h)
        found = Ends.of(space, x).slots(slopes[-1], basis.total(torques.turned, at.h))
        stationarity = slopes[1:-1]
        if len(stationarity) == 0:
            return found
        change = (stationarity - stationarity.detach()).transpose(0, 1).flatten(1)
        moved, n = matvec(self._condense()[1], change), x.shape[1]
        return Slots(found.d1 - moved[:, :n], found.d2 - moved[:, n:])

    @override
    def rows(self, index: Tensor) -> GeodesicExpansion:
        rows = GeodesicExpansion(self._space, self._at.rows(index), self._x[index])
        rows._condensed = take_rows(self._condensed, index)
        return rows

    @override
    def replace(self, index: Tensor, other: GeodesicExpansion) -> GeodesicExpansion:
        at = self._at.replace(index, other._at)
        return GeodesicExpansion(self._space, at, self._x.index_copy(0, index, other._x))

    def condensed(self) -> GeodesicExpansion:
        """Return this expansion with ``d2d1`` computed, which its rows then share."""
        self._condense()
        return self

    @override
    def hessian(self, before: DiscreteExpansion | None = None) -> Tensor:
        assert before is None or isinstance(before, GeodesicExpansion)
        ends, at = self._ends, self._at
        found = self._points.derivatives(None if before is None else before._points)
        turned = self._points.by_turn(found)
        slopes, total = at.basis.slopes(turned.gradients, at.h), at.basis.total(turned.turned, at.h)
        first, final = total - ends.inverse @ slopes[-1], ends.inverse.mT @ slopes[-1]
        by_turn = torch.cat((first.unsqueeze(0), slopes[1:-1], final.unsqueeze(0))).unsqueeze(1)
        w, turns = self._in_chart(found), self._space.turns(self._x)
        # at a fixed end a turn of the start moves the end's coordinates, too
        start = w[:, :1] * ~turns + by_turn - w[:, -1:] @ (ends.inverse.mT * turns)
        return torch.cat((start, w[:, 1:-1], w[:, -1:] @ ends.inverse), dim=1)

    def _derivatives(self) -> Float[Tensor, "variables variables batch n n"]:
        """Return the derivatives of ``D₁``, the inner equations and ``D₂`` in ``(c, x)``."""
        return self._in_chart(self._points.derivatives())[:, 1:]

    def _in_chart(self, found: ChartDerivatives) -> Float[Tensor, "variables variables batch n n"]:
        """Return the derivatives of ``D₁``, the inner equations and ``D₂`` in ``(φ₀, c, x)``."""
        at, ends = self._at, self._ends
        w = at.basis.hessian(found.curvature, self._points.mass(), at.h)[1:]
        total = at.basis.total_slopes(found.turned_q, found.turned_v, at.h)
        first, final = total - ends.inverse @ w[-1], ends.inverse.mT @ w[-1]
        start_slope, end_slope = ends.slopes(at.values.d2)
        first = torch.cat((first[:-1], first[-1:] - start_slope))
        final = torch.cat((final[:-1], final[-1:] + end_slope))
        return torch.cat((first.unsqueeze(0), w[:-1], final.unsqueeze(0)))

    @torch.no_grad()
    def _condense(self) -> tuple[Tensor, Tensor]:
        """Return ``D₂D₁L_d`` and the derivatives of both slots in the inner equations."""
        if self._condensed is None:
            derivatives = self._derivatives()
            ends, inner = derivatives[[0, -1]], derivatives[1:-1]
            transfer = torch.linalg.solve_ex(
                block_matrix(inner[:, :-1]), block_matrix(ends[:, :-1]), left=False
            )[0]
            n = derivatives.shape[-1]
            d2d1 = derivatives[0, -1] - transfer[:, :n] @ block_matrix(inner[:, -1:])
            self._condensed = d2d1, transfer
        return self._condensed


class GeodesicMidpoint(VariationalIntegrator):
    """The midpoint rule, ``L_d = h ℒ(q₀ ⊕ δ/2, δ/h)``, order 2: ``Geodesic`` with one stage.

    Along the geodesic the body rates are constant. With ``p = ℒ_v`` and ``M``, the torques of
    ``Geodesic``, at the middle, and ``y = h/2 J(δ/2)ᵀ M + p``

        D₂ = J(δ)⁻ᵀ y        D₁ = h exp(δ/2) M − J(δ)⁻¹ y

    Args:
        space: The space.
    """

    name, order, stages, iterates, has_hessian = "geodesic2", 2, 1, True, True

    def __init__(self, space: Space) -> None:
        self.space = space

    @override
    def slots(  # type: ignore[override]
        self, lagrangian: Controlled, q0: Tensor, q1: Tensor, h: float, forces: Forces | None = None
    ) -> Slots:
        return _Middle.of(self.space, q0, self.space.chart(q0, q1), h).slots(lagrangian, forces)

    @override
    def expand(  # type: ignore[override]
        self, lagrangian: Controlled, q0: Tensor, q1: Tensor, h: float, forces: Forces | None = None
    ) -> GeodesicMidpointExpansion:
        return self.expand_at(lagrangian, q0, self.space.chart(q0, q1), h, forces)

    @override
    @torch.no_grad()
    def expand_at(  # type: ignore[override]
        self, lagrangian: Controlled, q0: Tensor, x: Tensor, h: float, forces: Forces | None = None
    ) -> GeodesicMidpointExpansion:
        middle = _Middle.of(self.space, q0.detach(), x, h)
        at, controls = lagrangian.lagrangian.expand(middle.q, middle.v), detached(forces)
        moment = middle.moment(lagrangian, controls, at.values.q)
        values = middle.slots_of(moment, at.values.v)
        found = GeodesicMidpointExpansion(
            lagrangian, self.space, q0.detach(), x, h, controls, at, moment, values
        )
        found.middle = middle
        return found

    @override
    def unknowns(self, q0: Tensor, q1: Tensor) -> Tensor:
        return self.space.chart(q0, q1)

    @override
    def impulses(self, force0: Tensor, force1: Tensor, h: float) -> tuple[Tensor, Tensor]:
        """Return zeros: controls act between the configurations."""
        zero = force0.new_zeros(())
        return zero, zero


class _Middle(NamedTuple):
    """The middle of intervals."""

    h: float
    chart: Chart
    """At ``δ/2``."""
    ends: Ends
    q: Float[Tensor, "batch N"]
    v: Float[Tensor, "batch n"]

    @staticmethod
    def of(space: Space, q0: Tensor, x: Float[Tensor, "batch n"], h: float) -> _Middle:
        """Return the middle of intervals that end at ``x`` in the charts at ``q₀``."""
        origin = space.origin(q0)
        half = 0.5 * (origin + x)
        chart = Chart.of(space, half)
        q = space.turned(q0, half, chart.rotations)
        return _Middle(h, chart, Ends.of(space, x), q, (x - origin) / h)

    def slots(
        self, controlled: Controlled, forces: Forces | None, at: Expansion | None = None
    ) -> Slots:
        """Return the slot derivatives; ``at`` is ``ℒ`` around the middle, if known."""
        by_q, p = (at or controlled.lagrangian).gradients(self.q, self.v)
        return self.slots_of(self.moment(controlled, forces, by_q), p)

    def moment(self, controlled: Controlled, forces: Forces | None, by_q: Tensor) -> Tensor:
        """Return ``M``, given the torques without controls."""
        if forces is None:
            return by_q
        return by_q + controlled.force(self.q, 0.5 * (forces.start + forces.end))

    def slots_of(self, moment: Tensor, p: Tensor) -> Slots:
        """Return the slot derivatives, given ``M`` and ``p``."""
        turned = self.h * matvec(self.chart.turn, moment)
        return self.ends.slots(self.last(moment, p), turned)

    def last(self, moment: Tensor, p: Tensor) -> Tensor:
        """Return ``y``."""
        return (0.5 * self.h) * vecmat(moment, self.chart.jacobian) + p


class GeodesicMidpointExpansion(DiscreteExpansion):
    """The midpoint rule around ``(q₀, q₁)``, in body axes of these.

    Args:
        controlled: ``ℒ`` and its controls.
        space: The space.
        q0: Configurations at the start.
        x: ``q₁`` in the charts there.
        h: Time step [s].
        controls: Controls at both ends.
        at: ``ℒ`` around the middle.
        moment: ``M``.
        values: The slot derivatives.
    """

    parts = (
        "_controlled", "_space", "_q0", "_x", "_h", "_controls", "_at", "_moment", "values",
    )  # fmt: skip

    def __init__(
        self,
        controlled: Controlled,
        space: Space,
        q0: Tensor,
        x: Tensor,
        h: float,
        controls: Forces | None,
        at: Expansion,
        moment: Tensor,
        values: Slots,
    ) -> None:
        self._controlled, self._space, self._q0, self._x, self._h = controlled, space, q0, x, h
        self._controls, self._at, self._moment, self.values = controls, at, moment, values

    @cached_property
    def middle(self) -> _Middle:
        """The middle of the intervals."""
        return _Middle.of(self._space, self._q0, self._x, self._h)

    @override
    def slots(self, q0: Tensor, q1: Tensor, forces: Forces | None = None) -> Slots:
        middle = _Middle.of(self._space, q0, self._space.chart(q0, q1), self._h)
        return middle.slots(self._controlled, forces, self._at)

    @override
    def d2d1(self) -> Tensor:
        return self._by_end(self._slopes(None))[0]

    @override
    @torch.no_grad()
    def hessian(self, before: DiscreteExpansion | None = None) -> Tensor:
        assert before is None or isinstance(before, GeodesicMidpointExpansion)
        middle, slopes = self.middle, self._slopes(None if before is None else before._at)
        chart, inverse = middle.chart, middle.ends.inverse
        end = torch.stack(self._by_end(slopes))
        turns = chart.space.turns(middle.v)
        # lengths and angles at the start, and turns of it in the axes at the middle
        moved = torch.where(turns, chart.turn.mT, 0.5 * chart.jacobian)
        by_start = self._along(slopes, moved, (~turns / -middle.h).to(moved), bend=False)
        start = torch.stack((by_start[1] - inverse @ by_start[0], inverse.mT @ by_start[0]))
        # at a fixed end a turn of the start moves the end's coordinates, too
        start = start - end @ (inverse.mT * turns)
        return torch.stack((start, end @ inverse), dim=1)

    def _slopes(self, before: Expansion | None) -> tuple[Curvature, Tensor, Tensor]:
        """Return the second derivatives of ``ℒ``, the inertia, and ``∂M/∂q``."""
        curvature = self._at.curvature(before)
        by_q = curvature.qq
        if self._controls is not None:
            start, end = self._controls
            by_q = by_q + control_slope(
                self._controlled, self._space, self.middle.q, 0.5 * (start + end)
            )
        return curvature, self._at.mass(), by_q

    def _along(
        self,
        slopes: tuple[Curvature, Tensor, Tensor],
        moved: Tensor,
        rate: Tensor | float,
        *,
        bend: bool,
    ) -> tuple[Tensor, Tensor]:
        """Return the derivatives of ``y`` and ``h exp(δ/2) M``.

        Args:
            slopes: Result of ``_slopes``.
            moved: Changes of the middle along ``retract``.
            rate: Changes of the velocity, multiples of the unit vectors.
            bend: Whether ``δ`` changes, with half of ``J(δ/2)`` for ``moved``.
        """
        (_, vq, qv), mass, by_q = slopes
        middle, chart = self.middle, self.middle.chart
        space, n = chart.space, middle.v.shape[1]
        moment = by_q @ moved + qv * rate
        turned = moment
        last = (0.5 * middle.h) * (chart.jacobian.mT @ moment) + vq @ moved + mass * rate
        if bend:
            last = last + (0.25 * middle.h) * chart.momentum_slope(self._moment)
            blocks = space.blocks(cross(space.vectors(self._moment)), n, 0.0)
            turned = turned - blocks @ moved
        return last, middle.h * (chart.turn @ turned)

    def _by_end(self, slopes: tuple[Curvature, Tensor, Tensor]) -> tuple[Tensor, Tensor]:
        """Return ``∂D₁/∂δ`` and ``∂D₂/∂δ``."""
        middle, ends = self.middle, self.middle.ends
        last, turned = self._along(slopes, 0.5 * middle.chart.jacobian, 1.0 / middle.h, bend=True)
        start_slope, end_slope = ends.slopes(middle.last(self._moment, self._at.values.v))
        return turned - ends.inverse @ last - start_slope, ends.inverse.mT @ last + end_slope


class Ends(NamedTuple):
    """``J(δ)⁻¹`` between the ends of intervals."""

    space: Space
    phi: Float[Tensor, "batch*r 3"]
    series: ExponentialSeries
    inverse: Float[Tensor, "batch n n"]
    """``J(δ)⁻¹ = I + ½ [δ] + γ [δ]²``."""

    @staticmethod
    def of(space: Space, x: Float[Tensor, "batch n"]) -> Ends:
        """Evaluate it."""
        phi = space.vectors(x)
        series = ExponentialSeries.of(phi)
        inverse = polynomial(phi, series.s, 0.5, series.gamma)
        return Ends(space, phi, series, space.blocks(inverse, x.shape[1], 1.0))

    def slots(self, last: Float[Tensor, "batch n"], turned: Float[Tensor, "batch n"]) -> Slots:
        """Return ``D₁`` and ``D₂``, given ``D₂ℓ_d`` and ``h Σᵢ bᵢ exp(φᵢ) Mᵢ``."""
        return Slots(turned - matvec(self.inverse, last), vecmat(last, self.inverse))

    def slopes(self, last: Float[Tensor, "batch n"]) -> tuple[Tensor, Tensor]:
        """Return ``∂(J⁻¹ y)/∂δ`` and ``∂(J⁻ᵀ y)/∂δ`` at a fixed ``y``, (batch, n, n).

        ``J⁻ᵀ = J⁻¹ − [δ]``, so that the second is the first plus ``[y]``.
        """
        c, y = self.series, self.space.vectors(last)
        start = polynomial_slope(self.phi, y, c.s, (0.5, 0.0), (c.gamma, c.gamma1))
        n = last.shape[1]
        return self.space.blocks(start, n, 0.0), self.space.blocks(start + cross(y), n, 0.0)
