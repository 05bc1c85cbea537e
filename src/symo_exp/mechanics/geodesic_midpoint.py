"""The midpoint rule on rotations, in closed form (see ``mechanics.geodesic``)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from typing_extensions import override

from symo_exp.mechanics.chart import Chart, Controlled, Ends, control_slope
from symo_exp.mechanics.lagrangian import Curvature, Expansion, matvec, vecmat
from symo_exp.mechanics.space import Space, cross
from symo_exp.mechanics.variational import DiscreteExpansion, Forces, Slots, VariationalIntegrator


class GeodesicMidpoint(VariationalIntegrator):
    """The midpoint rule, ``L_d = h ℒ(q₀ ⊕ δ/2, δ/h)``, order 2: ``Geodesic`` with one stage.

    Along the geodesic the body rates are constant. With ``p = ℒ_v`` and ``M``, the torques of
    ``Geodesic``, at the middle, and ``y = h/2 J(δ/2)ᵀ M + p``

        D₂ = J(δ)⁻ᵀ y        D₁ = h exp(δ/2) M − J(δ)⁻¹ y

    Args:
        space: The space.
    """

    order, iterates, has_hessian = 2, True, True

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
        at = lagrangian.lagrangian.expand(middle.q, middle.v)
        controls = forces and forces.detached()
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
        ends = Ends.around(space, chart.map, x.shape[1])
        return _Middle(h, chart, ends, q, (x - origin) / h)

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


@dataclass(eq=False)
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

    controlled: Controlled
    space: Space
    q0: Tensor
    x: Tensor
    h: float
    controls: Forces | None
    at: Expansion
    moment: Tensor
    values: Slots

    @cached_property
    def middle(self) -> _Middle:
        """The middle of the intervals."""
        return _Middle.of(self.space, self.q0, self.x, self.h)

    @override
    def slots(self, q0: Tensor, q1: Tensor, forces: Forces | None = None) -> Slots:
        known = not (q0.requires_grad or q1.requires_grad)
        return self.slots_at(q0, self.x if known else self.space.chart(q0, q1), forces)

    @override
    def slots_at(self, q0: Tensor, x: Tensor, forces: Forces | None) -> Slots:
        known = not (q0.requires_grad or x.requires_grad)
        middle = self.middle if known else _Middle.of(self.space, q0, x, self.h)
        return middle.slots(self.controlled, forces, self.at)

    @override
    def d2d1(self) -> Tensor:
        return self._by_end(self._slopes(None))[0]

    @override
    @torch.no_grad()
    def hessian(self, before: DiscreteExpansion | None = None) -> Tensor:
        assert before is None or isinstance(before, GeodesicMidpointExpansion)
        middle, slopes = self.middle, self._slopes(None if before is None else before.at)
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
        curvature = self.at.curvature(before)
        by_q = curvature.qq
        if self.controls is not None:
            start, end = self.controls
            by_q = by_q + control_slope(
                self.controlled, self.space, self.middle.q, 0.5 * (start + end)
            )
        return curvature, self.at.mass(), by_q

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
        moment = torch.baddbmm(qv * rate, by_q, moved)
        turned = moment
        last = torch.baddbmm(mass * rate, vq, moved)
        last = torch.baddbmm(last, chart.jacobian.mT, moment, alpha=0.5 * middle.h)
        if bend:
            last = torch.add(last, chart.momentum_slope(self.moment), alpha=0.25 * middle.h)
            blocks = space.blocks(cross(space.vectors(self.moment)), n, 0.0)
            turned = torch.baddbmm(turned, blocks, moved, alpha=-1.0)
        return last, middle.h * (chart.turn @ turned)

    def _by_end(self, slopes: tuple[Curvature, Tensor, Tensor]) -> tuple[Tensor, Tensor]:
        """Return ``∂D₁/∂δ`` and ``∂D₂/∂δ``."""
        middle, ends = self.middle, self.middle.ends
        last, turned = self._along(slopes, 0.5 * middle.chart.jacobian, 1.0 / middle.h, bend=True)
        start_slope, end_slope = ends.slopes(middle.last(self.moment, self.at.values.v))
        first = torch.baddbmm(turned - start_slope, ends.inverse, last, alpha=-1.0)
        return first, torch.baddbmm(end_slope, ends.inverse.mT, last)
