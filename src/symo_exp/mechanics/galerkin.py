"""Galerkin variational integrators of any even order (Marsden and West 2001, section 2.2.6).

On an interval ``[0, h]`` the motion is a polynomial of degree ``s``: the line from ``q₀`` to ``q₁``
and ``s − 1`` bubbles, the integrals ``φⱼ`` of the Legendre polynomials ``Pⱼ``. With ``τ = t/h``

    q(τ) = (1 − τ) q₀ + τ q₁ + Σⱼ cⱼ φⱼ(τ)        v(τ) = (q₁ − q₀ + Σⱼ cⱼ Pⱼ(τ)) / h

The action is integrated by ``s`` Gauss points ``τᵢ`` with weights ``bᵢ``, ``Σ bᵢ = 1``. The
discrete Lagrangian is its stationary value in the inner coefficients,

    L_d(q₀, q₁) = ext_c  h Σᵢ bᵢ ℒ(q(τᵢ), v(τᵢ))

With forces it is d'Alembert's principle: ``∂L_d/∂cⱼ + h Σᵢ bᵢ φⱼ(τᵢ) F(τᵢ) = 0``. The order is 2s
(Ober-Blöbaum and Saake 2015); ``s = 1`` is the midpoint rule.

With ``z = (q₀, c₁, …, c_{s−1}, q₁)`` the variables of an interval and ``α_a(τ)``, ``β_a(τ)`` their
coefficients in ``q`` and ``h v``, one formula serves them all:

    D_a L_d = Σᵢ bᵢ (h α_a ℒ_q + β_a ℒ_v)
    D_b D_a L_d = Σᵢ bᵢ (h α_a α_b ℒ_qq + α_a β_b ℒ_qv + β_a α_b ℒ_vq + β_a β_b H / h)
"""

from __future__ import annotations

import copy
from abc import abstractmethod
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from typing_extensions import Self, override

from symo_exp.checks import real, whole_number
from symo_exp.mechanics.lagrangian import Curvature, Expansion, Gradients, Lagrangian, matvec, solve
from symo_exp.mechanics.roots import (
    Rule,
    Sizes,
    as_actions,
    iterate,
    newton_step,
    relative,
    rounding,
)
from symo_exp.mechanics.rows import Rowwise, take_rows
from symo_exp.mechanics.variational import (
    DiscreteExpansion,
    Forces,
    Slots,
    VariationalIntegrator,
    block_matrix,
    distinct,
)

TOLERANCE, MOST_UPDATES = 1e-12, 12
"""Of the inner coefficients, by default and in evaluation."""
SLOW = 0.1
"""Ratio of residuals after and before an update above which the update gains little."""


class Expandable(Protocol):
    """``ℒ``, or ``ℓ`` in charts of rotations."""

    def expand(self, q: Float[Tensor, "batch n"], v: Float[Tensor, "batch n"]) -> Expansion:
        """Return it around ``(q, v)``."""
        ...


class GalerkinIntegrator(VariationalIntegrator):
    """A Galerkin variational integrator with the bubbles and points of a basis.

    A step solves for ``(q₁, c)`` at once. Between two given configurations the inner coefficients
    start at zero and are improved by Newton's method with the inertia's part of the Hessian,
    ``Σᵢ bᵢ βⱼ βₗ Hᵢ / h``, which is always regular and nearly diagonal for Legendre polynomials,
    and with that of friction, until the last update is below ``tolerance`` of the displacement,
    both in the units of the coordinates (``sizes``). Each update gains two to three digits at usual
    step sizes. A row that an update would make worse keeps its coefficients (untrained networks
    have such rows). With friction it tries a part of the update, with rotations one with the whole
    Hessian: about a thin axis the other terms are larger than the inertia. They are so in fast
    motions of long chains, too; in evaluation all rows that have not converged go on with the whole
    Hessian.

    Args:
        basis: The motions over an interval.
        tolerance: Bound on the last update, relative to the displacement.
        max_iterations: Bound on the number of updates.
    """

    has_geodesic = True
    has_hessian = True
    finishes = False
    """Whether rows that do not converge go on with the whole Hessian, as all do in evaluation."""

    def __init__(
        self, basis: Basis, tolerance: float = TOLERANCE, max_iterations: int = MOST_UPDATES
    ) -> None:
        self.tolerance = real("tolerance", tolerance, above=0)
        self.max_iterations = whole_number("max_iterations", max_iterations)
        self.basis, self.order = basis, basis.order
        self.iterates = len(basis.b) > 1

    @override
    def slots(
        self, lagrangian: Lagrangian, q0: Tensor, q1: Tensor, h: float, forces: Forces | None = None
    ) -> Slots:
        # Intervals that occur twice, as those of consecutive windows do, are solved once.
        if not self.iterates:  # there is nothing to solve
            return self._each(lagrangian, q0, q1, h, forces)
        ends = (q0, q1) if forces is None else (q0, q1, *forces)
        chosen, place = distinct(torch.cat(ends, dim=1).detach())
        if 4 * len(chosen) > 3 * len(q0):
            return self._each(lagrangian, q0, q1, h, forces)
        few = take_rows(forces, chosen)
        at = self.expand(lagrangian, q0[chosen], q1[chosen], h, few)
        if not torch.is_grad_enabled():
            return Slots(*(x[place] for x in at.values))
        at.d2d1()  # its solutions are kept, and copied with the rows
        return at.rows(place).slots(q0, q1, forces)

    def _each(
        self, lagrangian: Lagrangian, q0: Tensor, q1: Tensor, h: float, forces: Forces | None
    ) -> Slots:
        at = self.expand(lagrangian, q0, q1, h, forces)
        return at.slots(q0, q1, forces) if torch.is_grad_enabled() else at.values

    @override
    @torch.no_grad()
    def expand(
        self, lagrangian: Expandable, q0: Tensor, q1: Tensor, h: float, forces: Forces | None = None
    ) -> GalerkinExpansion:
        problem = InnerEquations(self.basis, lagrangian, q0, q1, h, forces)
        start = self._still(q0)
        if not self.iterates:
            return problem.at(start).expansion
        tolerance = max(self.tolerance, 4.0 * torch.finfo(q0.dtype).eps)
        rule = InnerSteps(tolerance, self.sizes, exact=self.space.rotations > 0)
        x, at, state = iterate(problem, start, rule, self.max_iterations)
        if self.finishes:
            index = rule.left(x, at, state).nonzero().squeeze(-1)
            if len(index) > 0:
                rest, rule = problem.rows(index), InnerSteps(tolerance, self.sizes, exact=True)
                x, again, state = iterate(rest, x[index], rule, self.max_iterations)
                at = at.replace(index, again)
                found = torch.ones(len(q0), dtype=torch.bool, device=q0.device)
                at.expansion.found = found.index_copy(0, index, ~rule.left(x, again, state))
        return at.expansion

    def unknowns(self, q0: Tensor, q1: Tensor) -> Tensor:
        """Return ``(q₁, c₁, …, c_{s−1})``, the coefficients zero."""
        return torch.cat((q1, self._still(q1)), dim=1)

    @override
    @torch.no_grad()
    def expand_at(
        self, lagrangian: Expandable, q0: Tensor, x: Tensor, h: float, forces: Forces | None = None
    ) -> GalerkinExpansion:
        q1, c = x[:, : q0.shape[1]], _blocks(x[:, q0.shape[1] :], *q0.shape)
        return GalerkinExpansion.of(self.basis, lagrangian, q0, q1, c, h, forces)

    def _still(self, q: Tensor) -> Tensor:
        """Return inner coefficients that are zero."""
        return q.new_zeros(q.shape[0], (len(self.basis.b) - 1) * q.shape[1])

    @override
    def converged(self) -> Self:
        found = copy.copy(self)
        found.tolerance, found.max_iterations, found.finishes = TOLERANCE, MOST_UPDATES, True
        return found

    def impulses(self, force0: Tensor, force1: Tensor, h: float) -> tuple[Tensor, Tensor]:
        """Return ``h Σᵢ bᵢ (1 − τᵢ) F(τᵢ)`` and ``h Σᵢ bᵢ τᵢ F(τᵢ)``, exact for ``s ≥ 2``."""
        first, *_, last = self.basis.impulses(Forces(force0, force1), h).unbind(0)
        return first, last


class Galerkin(GalerkinIntegrator):
    """The Galerkin variational integrator with ``stages`` = s Gauss points, order 2s.

    Args:
        stages: Number of Gauss points.
        tolerance: Bound on the last update, relative to the displacement.
        max_iterations: Bound on the number of updates.
    """

    def __init__(
        self, *, stages: int, tolerance: float = TOLERANCE, max_iterations: int = MOST_UPDATES
    ) -> None:
        super().__init__(legendre(whole_number("stages", stages)), tolerance, max_iterations)


@dataclass(eq=False)
class InnerEquations(Rowwise):
    """The equations ``∂L_d/∂cⱼ + h Σᵢ bᵢ φⱼ F = 0`` of the inner coefficients ``c``.

    Args:
        basis: The polynomials.
        lagrangian: ``ℒ``.
        q0: Configuration at the start of the interval.
        q1: Configuration at its end.
        h: Time step [s].
        forces: The generalised force over the interval.
    """

    basis: Basis
    lagrangian: Expandable
    q0: Tensor
    q1: Tensor
    h: float
    forces: Forces | None

    def at(self, x: Float[Tensor, "batch inner*n"]) -> InnerPoint:
        """Evaluate the equations."""
        c = _blocks(x, *self.q0.shape).contiguous()
        expansion = GalerkinExpansion.of(
            self.basis, self.lagrangian, self.q0, self.q1, c, self.h, self.forces
        )
        return InnerPoint(expansion, self.q1 - self.q0)


@dataclass(eq=False)
class InnerPoint(Rowwise):
    """The equations of the inner coefficients at one batch of them."""

    expansion: GalerkinExpansion
    displacement: Tensor

    @property
    def residual(self) -> Tensor:
        """``∂L_d/∂cⱼ + h Σᵢ bᵢ φⱼ F``, (batch, inner · n)."""
        return _row(self.expansion.stationarity)

    def jacobian(self) -> Tensor:
        """Return the part of the inertia in ``W_cc`` and that of friction.

        Friction is the larger one where a motion comes to rest.
        """
        at, basis = self.expansion.at, self.expansion.basis
        w = basis.inertia(at.mass(), self.expansion.h)
        if at.dissipates:
            w = w + basis.damping(at.damping())
        return block_matrix(w[1:-1, 1:-1])

    def exact_step(self) -> Float[Tensor, "batch inner*n"]:
        """Return the step of Newton's method with all of ``W_cc``."""
        whole = block_matrix(self.expansion.hessian()[1:-1, 1:-1])
        return solve(whole, -self.residual)

    def reach(self, sizes: Sizes) -> Float[Tensor, " batch"]:
        """Return the size of the motion over the interval, in the units of the coordinates."""
        inner = relative(self.expansion.inner, sizes).abs().amax((0, -1))
        return relative(self.displacement, sizes).abs().amax(-1) + inner


class Inner(NamedTuple):
    """State of ``InnerSteps``."""

    step: Float[Tensor, "batch inner*n"]
    share: Float[Tensor, "batch 1"]
    """Part of the step that is tried; 0 in rows that are given up."""
    exact: Bool[Tensor, " batch"]
    """Rows whose steps have all of ``W_cc``."""


class InnerSteps(Rule[InnerPoint, Inner]):
    """Newton steps of the inner coefficients; rows are done when their next step is small.

    Args:
        tolerance: Bound on a step, relative to the motion over the interval.
        sizes: Units of the coordinates, in which lengths and angles are compared.
        exact: Whether rows that refuse a step, or gain little by it, try the exact one.
    """

    def __init__(self, tolerance: float, sizes: Sizes = None, *, exact: bool = False) -> None:
        self._tolerance, self._sizes, self._exact = tolerance, sizes, exact

    @override
    def start(self, x: Tensor, at: InnerPoint) -> Inner:
        exact = torch.zeros(len(x), dtype=torch.bool, device=x.device)
        return Inner(torch.zeros_like(x), torch.ones_like(x[:, :1]), exact)

    @override
    def active(self, x: Tensor, at: InnerPoint, state: Inner) -> tuple[Tensor, Inner]:
        step = newton_step(at)
        if state.exact.any():
            step = torch.where(state.exact.unsqueeze(-1), at.exact_step(), step)
        largest = relative(step, self._sizes).abs().amax(-1)
        active = ~(largest <= self._tolerance * at.reach(self._sizes))
        return active & (state.share > 0.0).squeeze(-1), state._replace(step=step)

    def left(self, x: Tensor, at: InnerPoint, state: Inner) -> Bool[Tensor, " batch"]:
        """Return the rows that are not done and whose next step is more than rounding."""
        tried = state._replace(share=torch.ones_like(state.share))  # also those given up
        active, state = self.active(x, at, tried)
        return active & ~(state.step.abs() <= rounding(x, self._sizes)).all(-1)

    @override
    def drops(self, active: int, rows: int, batch: int) -> bool:
        return 4 * active <= 3 * rows

    @override
    def trial(self, x: Tensor, at: InnerPoint, state: Inner) -> tuple[Tensor, Inner]:
        return x + state.share * state.step, state

    @override
    def judge(
        self, active: Tensor, at: InnerPoint, there: InnerPoint, state: Inner
    ) -> tuple[Tensor, Inner]:
        after, before = (
            as_actions(x.expansion.stationarity, self._sizes).abs().amax((0, -1))
            for x in (there, at)
        )
        better = after <= before
        accepted = better & (better & active).any()
        if self.retries(at):
            # friction varies within a step, so that updates may go too far
            less = (0.25 if at.expansion.at.dissipates else 0.0) * state.share
            if self._exact:  # first the exact step, then less of both
                less = torch.where(state.exact.unsqueeze(-1), less, state.share)
                slow = active & ~(after <= SLOW * before)
                exact = torch.where(better, state.exact | slow, state.exact ^ active)
                state = state._replace(exact=exact)
            state = state._replace(share=torch.where(better.unsqueeze(-1), 1.0, less))
        return accepted, state

    @override
    def retries(self, at: InnerPoint) -> bool:
        return at.expansion.at.dissipates or self._exact


class Basis:
    """Bubbles that vanish at both ends of an interval, and the points of a quadrature rule.

    The variables of an interval are the values at its ends and the coefficients of the bubbles
    between them.

    Args:
        tau: Points ``τᵢ`` in [0, 1].
        b: Weights ``bᵢ``.
        bubbles: ``φⱼ(τᵢ)``.
        slopes: Their derivatives in ``τ``.
        order: Of the integrator.
    """

    def __init__(
        self,
        tau: Float[Tensor, " points"],
        b: Float[Tensor, " points"],
        bubbles: Float[Tensor, "inner points"],
        slopes: Float[Tensor, "inner points"],
        order: int,
    ) -> None:
        self.order = order
        self.b, one = b, torch.ones_like(tau).unsqueeze(0)
        self.alpha = torch.cat((one - tau, bubbles, tau.unsqueeze(0)))
        self.beta = torch.cat((-one, slopes, one))
        ba, bb = self.b * self.alpha, self.b * self.beta
        self._ba, self._bb = ba, bb
        # Σᵢ bᵢ x_a y_b for the four products of the Hessian, flattened over a and b.
        self._products = tuple(
            (x.unsqueeze(1) * y.unsqueeze(0)).flatten(0, 1)
            for x, y in ((ba, self.alpha), (ba, self.beta), (bb, self.alpha), (bb, self.beta))
        )
        # The impulse of a force linear in time on each variable.
        self._hold = ba @ torch.stack((1.0 - tau, tau), dim=1)

    def path(self, q0: Tensor, q1: Tensor, c: Tensor, h: float) -> tuple[Tensor, Tensor]:
        """Return ``q`` and ``v`` at the Gauss points, ``(s B, n)`` with the points outermost."""
        alpha, beta = self.alpha.to(q0), self.beta.to(q0)
        middle, slope = 0.5 * (q0 + q1), q1 - q0  # as sums of small differences, for rounding
        shape = (-1, 1, 1)
        q = middle + (alpha[-1] - 0.5).view(shape) * slope
        v = slope.expand_as(q)
        if len(c) > 0:
            q = q + torch.tensordot(alpha[1:-1].T, c, 1)
            v = v + torch.tensordot(beta[1:-1].T, c, 1)
        return q.flatten(0, 1), (v / h).flatten(0, 1)

    def slopes(self, gradients: Gradients, h: float) -> Float[Tensor, "variables batch n"]:
        """Return ``D_a L_d``."""
        dq, p = (x.unflatten(0, (len(self.b), -1)) for x in (gradients.q, gradients.v))
        return torch.tensordot(h * self._ba.to(dq), dq, 1) + torch.tensordot(self._bb.to(p), p, 1)

    def total(self, x: Float[Tensor, "points*batch n"], h: float) -> Float[Tensor, "batch n"]:
        """Return ``h Σᵢ bᵢ xᵢ``."""
        return torch.tensordot(h * self.b.to(x), x.unflatten(0, (len(self.b), -1)), 1)

    def impulses(self, forces: Forces, h: float) -> Float[Tensor, "variables batch n"]:
        """Return ``h Σᵢ bᵢ α_a(τᵢ) F(τᵢ)``."""
        hold = h * self._hold.to(forces.start)
        return torch.tensordot(hold, torch.stack((forces.start, forces.end)), 1)

    def hessian(
        self, curvature: Curvature, mass: Tensor, h: float
    ) -> Float[Tensor, "variables variables batch n n"]:
        """Return ``D_b D_a L_d``."""
        aa, ab, ba, _ = (product.to(mass) for product in self._products)
        qq, vq, qv = (x.unflatten(0, (len(self.b), -1)) for x in curvature)
        sums = h * torch.tensordot(aa, qq, 1)
        sums += torch.tensordot(ab, qv, 1) + torch.tensordot(ba, vq, 1)
        return self._square(sums) + self.inertia(mass, h)

    def inertia(self, mass: Tensor, h: float) -> Float[Tensor, "variables variables batch n n"]:
        """Return the inertia's part of the Hessian, ``Σᵢ bᵢ β_a β_b Hᵢ / h``."""
        bb = self._products[3].to(mass) / h
        return self._square(torch.tensordot(bb, mass.unflatten(0, (len(self.b), -1)), 1))

    def damping(self, rate: Tensor) -> Float[Tensor, "variables variables batch n n"]:
        """Return the part of a force with derivative ``∂F/∂v``, ``Σᵢ bᵢ α_a β_b (∂F/∂v)ᵢ``."""
        ab = self._products[1].to(rate)
        return self._square(torch.tensordot(ab, rate.unflatten(0, (len(self.b), -1)), 1))

    def _square(self, x: Tensor) -> Tensor:
        return x.unflatten(0, (len(self.alpha), len(self.alpha)))


class CondensedExpansion(DiscreteExpansion):
    """A discrete Lagrangian around ``(q₀, q₁)`` with inner coefficients ``c``.

    At stationary ``c`` the slot derivatives are the partial ones (envelope theorem). Their own
    derivatives include the motion of ``c``: with ``W`` the derivatives of ``D₁``, the equations of
    ``c`` and ``D₂`` in all variables, and ``e`` the ends,

        d(D_e L_d) = ∂(D_e L_d) − W_ec W_cc⁻¹ ∂(D_c L_d)

    which gives ``D₂D₁L_d = W_01 − W_0c W_cc⁻¹ W_c1``, exact, and with ``W`` held fixed the
    derivatives in parameters, configurations and forces.
    """

    stationarity: Float[Tensor, "inner batch n"]
    """``∂L_d/∂cⱼ + h Σᵢ bᵢ φⱼ F``, zero at the solution."""
    _condensed: tuple[Tensor, Tensor] | None = None

    @abstractmethod
    def by_unknowns(self) -> Float[Tensor, "variables unknowns batch n n"]:
        """Return the columns of ``W`` for ``c`` and ``q₁``, the unknowns of a step."""

    @override
    def d2d1(self) -> Tensor:
        return self._condense()[0]

    @override
    def mismatch(self, impulse: Tensor) -> Tensor:
        return torch.cat((impulse + self.values.d1, _row(self.stationarity)), dim=1)

    @override
    def mismatch_jacobian(self) -> Tensor:
        w = self.by_unknowns()[:-1]
        return block_matrix(torch.cat((w[:, -1:], w[:, :-1]), dim=1))

    def followed(self, slots: Slots, stationarity: Float[Tensor, "inner batch n"]) -> Slots:
        """Return slot derivatives that include the motion of ``c``, given its equations."""
        if len(stationarity) == 0:
            return slots
        moved = matvec(self._condense()[1], _row(stationarity - stationarity.detach()))
        n = slots.d1.shape[-1]
        return Slots(slots.d1 - moved[:, :n], slots.d2 - moved[:, n:])

    @torch.no_grad()
    def _condense(self) -> tuple[Tensor, Tensor]:
        """Return ``D₂D₁L_d`` and ``W_ec W_cc⁻¹``."""
        if self._condensed is None:
            w = self.by_unknowns()
            ends, inner, n = w[[0, -1]], w[1:-1], w.shape[-1]
            transfer = torch.linalg.solve_ex(
                block_matrix(inner[:, :-1]), block_matrix(ends[:, :-1]), left=False
            )[0]
            d2d1 = w[0, -1] - transfer[:, :n] @ block_matrix(inner[:, -1:])
            self._condensed = d2d1, transfer
        return self._condensed


class GalerkinExpansion(CondensedExpansion):
    """The discrete Lagrangian of lengths and angles; ``W`` is its Hessian.

    Args:
        basis: The polynomials.
        at: ``ℒ`` around the Gauss points.
        inner: ``c``.
        pull: Impulse of the force on the inner coefficients.
        h: Time step [s].
    """

    def __init__(
        self,
        basis: Basis,
        at: Expansion,
        inner: Float[Tensor, "inner batch n"],
        pull: Float[Tensor, "inner batch n"],
        h: float,
    ) -> None:
        self.basis, self.at, self.h = basis, at, h
        self.inner, self._pull = inner, pull
        slopes = basis.slopes(at.values, h)
        self.values = Slots(slopes[0], slopes[-1])
        self.stationarity = slopes[1:-1] + pull

    @staticmethod
    def of(
        basis: Basis,
        lagrangian: Expandable,
        q0: Tensor,
        q1: Tensor,
        c: Tensor,
        h: float,
        forces: Forces | None,
    ) -> GalerkinExpansion:
        """Return the discrete Lagrangian of an interval at inner coefficients ``c``."""
        pull = torch.zeros_like(c) if forces is None else basis.impulses(forces, h)[1:-1]
        return GalerkinExpansion(basis, lagrangian.expand(*basis.path(q0, q1, c, h)), c, pull, h)

    @override
    def by_unknowns(self) -> Tensor:
        return self.hessian()[:, 1:]

    @override
    def slots(self, q0: Tensor, q1: Tensor, forces: Forces | None = None) -> Slots:
        basis, h = self.basis, self.h
        slopes = basis.slopes(self.at.gradients(*basis.path(q0, q1, self.inner, h)), h)
        inner = slopes[1:-1]
        if forces is not None and len(inner) > 0:
            inner = inner + basis.impulses(forces, h)[1:-1]
        return self.followed(Slots(slopes[0], slopes[-1]), inner)

    # Gauss points are rows of ``at``, and blocks come before rows in the coefficients.

    @override
    def rows(self, index: Tensor) -> GalerkinExpansion:
        at = self.at.rows(self._points(index))
        rows = GalerkinExpansion(self.basis, at, self.inner[:, index], self._pull[:, index], self.h)
        rows._condensed = take_rows(self._condensed, index)
        return rows

    @override
    def replace(self, index: Tensor, other: GalerkinExpansion) -> GalerkinExpansion:
        return GalerkinExpansion(
            self.basis,
            self.at.replace(self._points(index), other.at),
            self.inner.index_copy(1, index, other.inner),
            self._pull.index_copy(1, index, other._pull),
            self.h,
        )

    def _points(self, index: Tensor) -> Tensor:
        """Rows of the Gauss points of some intervals."""
        points = torch.arange(len(self.basis.b), device=index.device) * len(self.values.d1)
        return (points.unsqueeze(-1) + index).flatten()

    @override
    def hessian(self, before: DiscreteExpansion | None = None) -> Tensor:
        assert before is None or isinstance(before, GalerkinExpansion)
        curvature = self.at.curvature(None if before is None else before.at)
        return self.basis.hessian(curvature, self.at.mass(), self.h)


def _row(blocks: Float[Tensor, "a batch n"]) -> Float[Tensor, "batch a*n"]:
    return blocks.transpose(0, 1).flatten(1)


def _blocks(row: Float[Tensor, "batch a*n"], batch: int, n: int) -> Float[Tensor, "a batch n"]:
    return row.reshape(batch, row.shape[1] // n, n).transpose(0, 1)


def legendre(stages: int) -> Basis:
    """Return the integrals of Legendre polynomials as bubbles, at Gauss points."""
    tau, b = _gauss(stages)
    x = 2.0 * tau - 1.0
    rows = [torch.ones_like(x), x]
    for j in range(1, stages):
        rows.append(((2 * j + 1) * x * rows[j] - j * rows[j - 1]) / (j + 1))
    found, degrees = torch.stack(rows), torch.arange(1, stages).unsqueeze(-1)
    bubbles = (found[2:] - found[:-2]) / (2 * (2 * degrees + 1))
    return Basis(tau, b, bubbles, found[1:stages], order=2 * stages)


def _gauss(stages: int) -> tuple[Tensor, Tensor]:
    """Gauss points and weights on [0, 1] (Golub and Welsch 1969)."""
    j = torch.arange(1, stages, dtype=torch.float64)
    off = j / (4.0 * j * j - 1.0).sqrt()
    x, vectors = torch.linalg.eigh(torch.diag(off, 1) + torch.diag(off, -1))
    return 0.5 * (x + 1.0), vectors[0].square()
