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

import torch
from jaxtyping import Float
from torch import Tensor
from typing_extensions import override

from symo_exp.errors import ConfigError
from symo_exp.mechanics.chart import (
    ChartDerivatives,
    ChartExpansion,
    ChartLagrangian,
    Controlled,
    Ends,
    at_points,
)
from symo_exp.mechanics.galerkin import (
    Basis,
    CondensedExpansion,
    GalerkinExpansion,
    GalerkinIntegrator,
)
from symo_exp.mechanics.geodesic_midpoint import GeodesicMidpoint
from symo_exp.mechanics.lagrangian import Gradients
from symo_exp.mechanics.rows import take_rows
from symo_exp.mechanics.space import Space
from symo_exp.mechanics.variational import (
    DiscreteExpansion,
    Forces,
    Slots,
    VariationalIntegrator,
)


def on_space(integrator: VariationalIntegrator, space: Space) -> VariationalIntegrator:
    """Return the integrator, or its extension to a space with rotations.

    Raises:
        ConfigError: If it has none.
    """
    if not space.rotations:
        return integrator
    if not integrator.has_geodesic:
        raise ConfigError(
            f"{type(integrator).__name__} moves lengths and angles only, and the system has "
            "rotations; choose integrator=midpoint, galerkin4, galerkin6 or galerkin10"
        )
    if not (isinstance(integrator, GalerkinIntegrator) and integrator.iterates):
        return GeodesicMidpoint(space)
    found = Geodesic(space, integrator.basis)
    found.sizes = integrator.sizes
    return found


class Geodesic(GalerkinIntegrator):
    """A Galerkin integrator in the chart at the start of an interval.

    Its ``forces`` are the controls at both ends of an interval.

    Args:
        space: The space.
        basis: The motions over an interval.
    """

    def __init__(self, space: Space, basis: Basis) -> None:
        super().__init__(basis)
        self.space, self.iterates = space, True

    @override
    @torch.no_grad()
    def expand(  # type: ignore[override]
        self, lagrangian: Controlled, q0: Tensor, q1: Tensor, h: float, forces: Forces | None = None
    ) -> GeodesicExpansion:
        chart, x = self._chart(lagrangian, q0, forces), self.space.chart(q0, q1)
        at = super().expand(chart, self.space.origin(q0), x, h)
        return GeodesicExpansion(at, x)

    @override
    @torch.no_grad()
    def expand_at(  # type: ignore[override]
        self, lagrangian: Controlled, q0: Tensor, x: Tensor, h: float, forces: Forces | None = None
    ) -> GeodesicExpansion:
        chart, origin = self._chart(lagrangian, q0, forces), self.space.origin(q0)
        at = super().expand_at(chart, origin, x, h)
        return GeodesicExpansion(at, x[:, : origin.shape[1]])

    @override
    def unknowns(self, q0: Tensor, q1: Tensor) -> Tensor:
        return super().unknowns(q0, self.space.chart(q0, q1))

    @override
    def impulses(self, force0: Tensor, force1: Tensor, h: float) -> tuple[Tensor, Tensor]:
        """Return zeros: controls act between the configurations."""
        zero = force0.new_zeros(())
        return zero, zero

    def _chart(self, lagrangian: Controlled, q0: Tensor, forces: Forces | None) -> ChartLagrangian:
        controls = forces and forces.detached()
        return ChartLagrangian(lagrangian, self.space, self.basis, q0.detach(), controls)


class GeodesicExpansion(CondensedExpansion):
    """The discrete Lagrangian around ``(q₀, q₁)``, in body axes of these.

    Args:
        at: The discrete Lagrangian of ``ℓ``.
        x: ``q₁`` in the chart at ``q₀``.
    """

    def __init__(self, at: GalerkinExpansion, x: Float[Tensor, "batch n"]) -> None:
        assert isinstance(at.at, ChartExpansion)
        self._at, self._points, self._x = at, at.at, x
        self._ends = Ends.of(self._points.space, x)
        self.values = self._ends.slots(at.values.d2, at.basis.total(self._points.turned, at.h))
        self.stationarity, self.found = at.stationarity, at.found

    @override
    def by_unknowns(self) -> Tensor:
        return self._in_chart(self._points.derivatives())[:, 1:]

    @override
    def slots(self, q0: Tensor, q1: Tensor, forces: Forces | None = None) -> Slots:
        known = not (q0.requires_grad or q1.requires_grad)
        return self.slots_at(q0, self._x if known else self._points.space.chart(q0, q1), forces)

    @override
    def slots_at(self, q0: Tensor, x: Tensor, forces: Forces | None) -> Slots:
        at, space = self._at, self._points.space
        basis, inner = at.basis, at.inner
        path = basis.path(space.origin(q0), x, inner, at.h)
        torques = self._points.torques(*at_points(basis, q0, forces), *path)
        slopes = basis.slopes(torques.gradients, at.h)
        ends = Ends.of(space, x) if x.requires_grad else self._ends
        found = ends.slots(slopes[-1], basis.total(torques.turned, at.h))
        return self.followed(found, slopes[1:-1])

    @override
    def rows(self, index: Tensor) -> GeodesicExpansion:
        rows = GeodesicExpansion(self._at.rows(index), self._x[index])
        rows._condensed = take_rows(self._condensed, index)
        return rows

    @override
    def replace(self, index: Tensor, other: GeodesicExpansion) -> GeodesicExpansion:
        at = self._at.replace(index, other._at)
        return GeodesicExpansion(at, self._x.index_copy(0, index, other._x))

    @override
    def hessian(self, before: DiscreteExpansion | None = None) -> Tensor:
        assert before is None or isinstance(before, GeodesicExpansion)
        ends, at = self._ends, self._at
        found = self._points.derivatives(None if before is None else before._points)
        turned = self._points.by_turn(found)
        slopes, total = at.basis.slopes(turned.gradients, at.h), at.basis.total(turned.turned, at.h)
        first, final = total - ends.inverse @ slopes[-1], ends.inverse.mT @ slopes[-1]
        by_turn = torch.cat((first.unsqueeze(0), slopes[1:-1], final.unsqueeze(0))).unsqueeze(1)
        w, turns = self._in_chart(found), ends.space.turns(self._x)
        # at a fixed end a turn of the start moves the end's coordinates, too
        start = w[:, :1] * ~turns + by_turn - w[:, -1:] @ (ends.inverse.mT * turns)
        return torch.cat((start, w[:, 1:-1], w[:, -1:] @ ends.inverse), dim=1)

    def _in_chart(self, found: ChartDerivatives) -> Float[Tensor, "variables variables batch n n"]:
        """Return the derivatives of ``D₁``, the inner equations and ``D₂`` in ``(φ₀, c, x)``."""
        at, ends = self._at, self._ends
        w = at.basis.hessian(found.curvature, self._points.mass(), at.h)[1:]
        total = at.basis.slopes(Gradients(found.turned_q, found.turned_v), at.h)
        first, final = total - ends.inverse @ w[-1], ends.inverse.mT @ w[-1]
        start_slope, end_slope = ends.slopes(at.values.d2)
        first = torch.cat((first[:-1], first[-1:] - start_slope))
        final = torch.cat((final[:-1], final[-1:] + end_slope))
        return torch.cat((first.unsqueeze(0), w[:-1], final.unsqueeze(0)))
