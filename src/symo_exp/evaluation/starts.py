"""The start that makes a model's own motion fit measured configurations."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import torch
from jaxtyping import Float
from torch import Tensor

ITERATIONS = 12
DIFFERENCE = 1e-5
"""Of a start, in the differences of rollouts [rad, rad/s; m, m/s]."""
GAIN, TINY = 1e-6, 1e-24
"""A row is done when a step promises to lessen its cost by no more than this share, or number."""
SMALLEST = 1e-12
"""Of a diagonal that damping scales with."""


class Path(Protocol):
    """A rollout, start included."""

    @property
    def q(self) -> Float[Tensor, "batch nodes n"]: ...
    @property
    def v(self) -> Float[Tensor, "batch nodes n"]: ...


class RollsOut(Protocol):
    """Whatever moves from a state under the controls at the nodes."""

    def rollout(self, q0: Tensor, v0: Tensor, u: Tensor) -> Path: ...


class State(NamedTuple):
    q: Float[Tensor, "batch n"]
    v: Float[Tensor, "batch n"]


def fitted_start(
    model: RollsOut,
    q: Float[Tensor, "batch nodes n"],
    u: Float[Tensor, "batch nodes m"],
    time_step: float,
) -> State:
    """The states at node 0 of ``min_{q₀, v₀} Σ_k |q̂_k(q₀, v₀) − q_k|²``, for a batch of motions.

    Levenberg-Marquardt from a parabola through the configurations, all rows at once and each with
    a damping of its own; derivatives are central differences of rollouts, so that any model will
    do. A trial that diverges is refused like one that is worse: the start stays where it was.
    """
    n, x = q.shape[2], _parabola(q, time_step)
    damping = x.new_full((len(x),), 1e-3)
    residual, slopes = _expand(model, x, q, u)
    rows = torch.arange(len(x), device=x.device)  # those that still move
    for _ in range(ITERATIONS):
        step, gain = _step(residual[rows], slopes[rows], damping[rows])
        rows, step = (part[gain > GAIN * _cost(residual[rows]) + TINY] for part in (rows, step))
        if not len(rows):
            break
        trial = x[rows] + step
        moved, moved_slopes = _expand(model, trial, q[rows], u[rows])
        better = _cost(moved) < _cost(residual[rows])
        taken = rows[better]
        x[taken], residual[taken] = trial[better], moved[better]
        slopes[taken] = moved_slopes[better]
        damping[rows] *= torch.where(better, 0.1, 10.0)
    return State(x[:, :n], x[:, n:])


def _step(residual: Tensor, slopes: Tensor, damping: Tensor) -> tuple[Tensor, Tensor]:
    """The damped Gauss-Newton step, and by how much it lessens the cost of the linear model.

    No step where the residuals or the equations are not finite.
    """
    gradient = (slopes.mT @ residual.unsqueeze(-1)).nan_to_num(0.0, 0.0, 0.0)
    normal = slopes.mT @ slopes
    scale = normal.diagonal(dim1=1, dim2=2).clamp_min(SMALLEST)
    matrix = normal + torch.diag_embed(damping[:, None] * scale)
    step = -torch.linalg.solve_ex(matrix, gradient)[0].nan_to_num(0.0, 0.0, 0.0)
    gain = -(step.mT @ (2.0 * gradient + normal @ step)).flatten()
    return step.squeeze(-1), gain


def _parabola(q: Tensor, h: float) -> Tensor:
    """Configuration and velocity at node 0 of the least-squares parabola through the nodes."""
    t = h * torch.arange(q.shape[1]).to(q)
    powers = t[:, None] ** torch.arange(min(3, len(t))).to(q)
    fit = torch.linalg.pinv(powers) @ q
    return torch.cat((fit[:, 0], fit[:, 1]), dim=1)


def _expand(model: RollsOut, x: Tensor, q: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
    """Residuals ``q̂ − q`` (batch, r) of the starts ``x`` and their derivatives (batch, r, 2n).

    One rollout of all starts and of those beside them. Where a start diverges the residuals are
    not finite; derivatives that are not are zero.
    """
    batch, unknowns = x.shape
    beside = DIFFERENCE * torch.eye(unknowns).to(x)
    shifts = torch.cat((torch.zeros_like(beside[:1]), beside, -beside))
    starts = (x + shifts[:, None]).flatten(0, 1)
    q0, v0 = starts.chunk(2, dim=1)
    path = model.rollout(q0, v0, u.repeat(len(shifts), 1, 1)).q
    moved = path.to(q).unflatten(0, (len(shifts), batch)).flatten(2)
    at, plus, minus = moved.split((1, unknowns, unknowns))
    slopes = ((plus - minus) / (2.0 * DIFFERENCE)).permute(1, 2, 0)
    return at[0] - q.flatten(1), slopes.nan_to_num(0.0, 0.0, 0.0)


def _cost(residual: Tensor) -> Tensor:
    return residual.square().sum(1).nan_to_num(nan=torch.inf)
