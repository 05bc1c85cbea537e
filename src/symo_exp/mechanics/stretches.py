"""Several steps of a variational integrator at once.

The discrete Euler-Lagrange equations of a stretch of steps are solved together, by Newton's method
on all of its nodes. Its Jacobian couples neighbouring nodes only: a step maps changes of
``(q_k, p_k)`` to changes of ``(q_{k+1}, p_{k+1})``, one small product each. The costly part, the
evaluation of the Lagrangian, is done for all steps in one batch. The iterations are about as many
as those of the worst single step, so that a stretch takes a fraction of the time of its steps.
Changes of rotations are along ``Space.retract``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from typing_extensions import override

from symo_exp.mechanics.lagrangian import solve
from symo_exp.mechanics.roots import Bounds, RootRule, Sizes, relative, rounding
from symo_exp.mechanics.rows import Rowwise
from symo_exp.mechanics.space import Space
from symo_exp.mechanics.variational import (
    DiscreteExpansion,
    DiscreteLagrangian,
    Forces,
    block_matrix,
)

FEW = 64
"""Rows up to which it costs more to select some than to continue with all."""
FAST = 0.5
"""Length of a change over that of the one before, up to which part of a stretch converges fast."""


@dataclass(eq=False)
class StretchMatching(Rowwise):
    """The equations ``p_k + D₁L_d(q_k, q_{k+1}) + f⁻ = 0`` of all steps of a stretch.

    Unknowns are, one step after another, its end and the inner unknowns of the integrator.

    Args:
        discrete: ``L_d``.
        q: Configuration at the start of the stretch.
        p: Momentum there.
        forces: The generalised force over each step.
    """

    discrete: DiscreteLagrangian
    q: Float[Tensor, "batch N"]
    p: Float[Tensor, "batch n"]
    forces: Forces

    def start(self, path: Float[Tensor, "batch steps N"]) -> Float[Tensor, "batch unknowns"]:
        """Return the unknowns at an initial guess of the nodes."""
        before = torch.cat((self.q.unsqueeze(1), path[:, :-1]), dim=1)
        inner = self.discrete.integrator.unknowns(before.flatten(0, 1), path.flatten(0, 1))
        inner = inner[:, self.p.shape[1] :].unflatten(0, path.shape[:2])
        return torch.cat((path, inner), dim=2).flatten(1)

    def nodes(self, x: Float[Tensor, "batch unknowns"]) -> Float[Tensor, "batch steps N"]:
        """Return the configurations among the unknowns."""
        steps = self.forces.start.shape[1]
        return x.unflatten(1, (steps, -1))[:, :, : self.q.shape[1]]

    def at(self, x: Float[Tensor, "batch unknowns"]) -> StretchPoint:
        """Evaluate the equations; the steps are the outermost part of a row index."""
        batch, width = self.q.shape
        steps, space = self.forces.start.shape[1], self.discrete.integrator.space
        x = x.unflatten(1, (steps, -1)).transpose(0, 1).flatten(0, 1)
        ends, inner = x[:, :width], x[:, width:]
        q = torch.cat((self.q, ends[:-batch]))
        forces = Forces(*(f.transpose(0, 1).flatten(0, 1) for f in self.forces))
        unknowns = torch.cat((space.chart(q, ends), inner), dim=1) if space.rotations else x
        at = self.discrete.expand_at(q, unknowns, forces)
        f0, f1 = self.discrete.impulses(forces)
        p = (at.values.d2 + f1).unflatten(0, (steps, batch))
        before = torch.cat((self.p.unsqueeze(0), p[:-1]))
        mismatch = at.mismatch(before.flatten(0, 1) + f0).unflatten(0, (steps, batch))
        return StretchPoint(at, mismatch.transpose(0, 1), p.transpose(0, 1), space)


@dataclass(eq=False)
class StretchPoint(Rowwise):
    """The equations of a stretch at one batch of candidates.

    Args:
        expansion: ``L_d`` around all steps, the steps outermost.
        mismatch: The equations.
        p: Momenta at the ends of the steps.
        space: The space of configurations.
    """

    expansion: DiscreteExpansion
    mismatch: Float[Tensor, "batch steps k"]
    p: Float[Tensor, "batch steps n"]
    space: Space

    @override
    def rows(self, index: Tensor) -> StretchPoint:
        expansion = self.expansion.rows(self._steps(index))
        return StretchPoint(expansion, self.mismatch[index], self.p[index], self.space)

    @override
    def replace(self, index: Tensor, other: StretchPoint) -> StretchPoint:
        return StretchPoint(
            self.expansion.replace(self._steps(index), other.expansion),
            self.mismatch.index_copy(0, index, other.mismatch),
            self.p.index_copy(0, index, other.p),
            self.space,
        )

    def _steps(self, index: Tensor) -> Tensor:
        """Rows of the steps of some stretches."""
        batch, steps = self.p.shape[:2]
        return (torch.arange(steps, device=index.device)[:, None] * batch + index).flatten()

    def norm(
        self, bounds: Bounds, own: Float[Tensor, "batch steps k k"] | None = None
    ) -> Float[Tensor, "batch steps"]:
        """Return the largest norm up to each step, given the Jacobians in their own unknowns."""
        if own is None or bounds.accuracy is None:
            return bounds.norm(self.mismatch).cummax(-1).values
        return bounds.norm(self.mismatch, solve(own, -self.mismatch)).cummax(-1).values

    def newton_step(
        self, before: StretchPoint | None
    ) -> tuple[Float[Tensor, "batch unknowns"], Float[Tensor, "batch steps k k"]]:
        """Return the step of Newton's method, and the Jacobians of ``norm``.

        ``before`` is the previous iterate.
        """
        start = self.p.new_zeros(len(self.p), 2 * self.p.shape[2], 1)
        step, _, own = self._along(self.mismatch.unsqueeze(-1), start, before)
        return step.flatten(1), own

    def moved(
        self, x: Float[Tensor, "batch unknowns"], step: Float[Tensor, "batch changes"]
    ) -> Float[Tensor, "batch unknowns"]:
        """Return the unknowns after a step."""
        if not self.space.rotations:
            return x + step
        (_, steps, n), width = self.p.shape, self.space.stored(self.p.shape[2])
        x, step = x.unflatten(1, (steps, -1)), step.unflatten(1, (steps, -1))
        nodes = self.space.retract(x[:, :, :width], step[:, :, :n])
        return torch.cat((nodes, x[:, :, width:] + step[:, :, n:]), dim=2).flatten(1)

    def resolution(
        self, x: Float[Tensor, "batch unknowns"], sizes: Sizes
    ) -> Float[Tensor, "batch changes"]:
        """Return a bound on the effect of roundings of the unknowns on their changes."""
        if not self.space.rotations:
            return rounding(x, sizes)
        n, width = self.p.shape[2], self.space.stored(self.p.shape[2])
        x = x.unflatten(1, (self.p.shape[1], -1))
        flat = n - 3 * self.space.rotations
        change = torch.cat((x[:, :, :flat], torch.zeros_like(x[:, :, flat:n])), dim=2)
        return rounding(torch.cat((change, x[:, :, width:]), dim=2).flatten(1), sizes)

    def slopes(
        self, start: Float[Tensor, "batch 2n columns"]
    ) -> tuple[Float[Tensor, "batch steps n columns"], Float[Tensor, "batch 2n columns"]]:
        """Return the derivatives of the nodes and of the last ``(q, p)``, given the first one's."""
        n = self.p.shape[2]
        none = self.mismatch.new_zeros(*self.mismatch.shape, start.shape[2])
        moved, end, _ = self._along(none, start, None)
        return moved[:, :, :n], end

    def _along(
        self, mismatch: Tensor, start: Tensor, before: StretchPoint | None
    ) -> tuple[
        Float[Tensor, "batch steps k columns"],
        Float[Tensor, "batch 2n columns"],
        Float[Tensor, "batch steps k k"],
    ]:
        """Solve the linearised equations from node to node.

        Returns:
            The changes of the unknowns, that of the last ``(q, p)``, and the derivatives of the
            equations of each step in its own unknowns.
        """
        (batch, steps, n), k = self.p.shape, self.mismatch.shape[2]
        w = self.expansion.hessian(None if before is None else before.expansion)
        order = [-1, *range(1, len(w) - 1)]  # of a step's unknowns: its end, then inner ones
        own = block_matrix(w[:-1][:, order])
        pushed = torch.cat((torch.eye(n).to(w), w.new_zeros(k - n, n))).expand(len(own), k, n)
        given = mismatch.transpose(0, 1).flatten(0, 1)
        right = torch.cat((block_matrix(w[:-1, :1]), pushed, given), dim=2)
        found = -torch.linalg.solve_ex(own, right)[0]
        by_state, shift = found.split((2 * n, given.shape[2]), dim=2)
        last = block_matrix(w[-1:, order])  # ∂p⁺ in the unknowns of a step
        by_start = torch.nn.functional.pad(w[-1, 0], (0, n))
        carry = torch.cat((by_state[:, :n], last @ by_state + by_start), dim=1)
        push = torch.cat((shift[:, :n], last @ shift), dim=1)
        states = [start]
        for step, added in zip(
            carry.view(steps, batch, 2 * n, 2 * n), push.unflatten(0, (steps, batch)), strict=True
        ):
            states.append(torch.baddbmm(added, step, states[-1]))
        moved = torch.baddbmm(shift, by_state, torch.cat(states[:-1]))
        moved, own = (x.unflatten(0, (steps, batch)).transpose(0, 1) for x in (moved, own))
        return moved, states[-1], own


class StretchState(NamedTuple):
    """State of ``StretchNewton``."""

    roots: Bool[Tensor, "batch steps"]
    """Whether all steps up to each are roots."""
    settled: Bool[Tensor, "batch steps"]
    """Whether the changes up to each step are within the accuracy, or lost in rounding."""
    before: StretchPoint | None
    """The previous iterate."""
    length: Float[Tensor, "batch steps"]
    """Of the previous change, up to each step."""
    reach: Int[Tensor, " batch"]
    """Steps from the start of the stretch that do not diverge."""
    own: Float[Tensor, "batch steps k k"] | None
    """Derivatives of the equations of each step in its own unknowns, at the previous iterate."""


class StretchNewton(RootRule[StretchPoint, StretchState]):
    """Undamped steps of Newton's method, dry friction by chords; steps that diverge are given up.

    A stretch diverges if a change is longer than the one before (the natural monotonicity test,
    Deuflhard 2011): what it would converge to later is a root far from the motion. Its first steps
    do not depend on those after them. They are solved as far as each change is at most half as long
    as the one before. The bounds are those of each step.
    """

    def solved(self, at: StretchPoint, state: StretchState) -> Int[Tensor, " batch"]:
        """Return the number of steps, from the start of the stretch, that are solved."""
        return self._roots(at, state).sum(1).minimum(state.reach)

    def _roots(self, at: StretchPoint, state: StretchState) -> Bool[Tensor, "batch steps"]:
        """Return whether all steps up to each are roots, or as near to one as rounding allows."""
        norm = at.norm(self.bounds)
        near = norm <= self.bounds.tolerance
        if state.own is not None and near.any():
            near = at.norm(self.bounds, state.own) <= self.bounds.tolerance
        return near | (state.settled & norm.isfinite())

    @override
    def start(self, x: Tensor, at: StretchPoint) -> StretchState:
        bounds, (batch, steps, _), own = self.bounds, at.p.shape, None
        if bounds.accuracy is not None and bool((at.norm(bounds) <= bounds.tolerance).any()):
            own = at.newton_step(None)[1]
        none = torch.zeros(batch, steps, dtype=torch.bool, device=x.device)
        reach = torch.full_like(none[:, 0], steps, dtype=torch.int64)
        return StretchState(none, none, None, x.new_full((batch, steps), torch.inf), reach, own)

    @override
    def active(
        self, x: Tensor, at: StretchPoint, state: StretchState
    ) -> tuple[Tensor, StretchState]:
        reach = state.reach.minimum(at.norm(self.bounds).isfinite().sum(1))
        roots = self._roots(at, state)
        return roots.sum(1) < reach, state._replace(roots=roots, reach=reach)

    @override
    def drops(self, active: int, rows: int, batch: int) -> bool:
        return rows > FEW and 2 * active <= rows

    @override
    def trial(
        self, x: Tensor, at: StretchPoint, state: StretchState
    ) -> tuple[Tensor, StretchState]:
        sizes, steps = self.bounds.sizes, at.p.shape[1]
        change, own = at.newton_step(state.before)
        there = at.moved(x, change)
        moves = ~self.bounds.negligible(change, at.resolution(x, sizes))
        moves = moves.unflatten(1, (steps, -1)).any(-1)
        settled = ~moves.cummax(1).values
        length = relative(change, sizes).unflatten(1, (steps, -1)).square().sum(-1).cumsum(1).sqrt()
        done = settled | state.roots
        grows, slow = (~((length <= share * state.length) | done) for share in (1.0, FAST))
        whole = (state.reach == steps).unsqueeze(1)
        last = (state.reach - 1).clamp(min=0).unsqueeze(1)
        diverges = grows.where(whole, slow).gather(1, last).squeeze(1)
        reach = state.reach.where(~diverges, slow.int().argmax(1))
        return there, StretchState(state.roots, settled, at, length, reach, own)

    @override
    def judge(
        self, active: Tensor, at: StretchPoint, there: StretchPoint, state: StretchState
    ) -> tuple[None, StretchState]:
        return None, state
