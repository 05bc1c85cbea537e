"""Root finding for a batch of small independent systems, each row with its own status.

What is solved is a :class:`RootProblem`; how, a :class:`RootFinder`; how the root is
differentiated is the business of ``implicit``. None knows the others.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Generic, Literal, NamedTuple, Protocol, TypeVar

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from symo_exp.mechanics.lagrangian import matvec, solve


class Evaluation(Protocol):
    """A problem evaluated at one batch of points."""

    residual: Tensor

    def jacobian(self) -> Tensor: ...

    def rows(self: E, index: Tensor) -> E: ...

    def replace(self: E, index: Tensor, other: E) -> E: ...


E = TypeVar("E", bound=Evaluation)
E_co = TypeVar("E_co", bound=Evaluation, covariant=True)


class RootProblem(Protocol[E_co]):
    """``g(x) = 0`` row by row."""

    def at(self, x: Tensor, index: Tensor | None = None) -> E_co:
        """``g`` at ``x``; with ``index``, ``x`` holds only those rows of the batch."""
        ...


class Root(NamedTuple, Generic[E]):
    """The solution with its status; the caller decides what an unconverged row means."""

    x: Float[Tensor, "batch n"]
    converged: Bool[Tensor, " batch"]
    iterations: Int[Tensor, " batch"]
    """Evaluations of ``g`` after the one at the start."""
    evaluation: E
    """The problem at ``x``."""


class RootFinder(ABC):
    """``tolerance`` bounds ``‖g‖₂ / √n`` of a row."""

    def __init__(self, *, tolerance: float, max_iterations: int) -> None:
        if not tolerance > 0.0:
            raise ValueError(f"tolerance must be positive, got {tolerance}")
        if max_iterations < 1:
            raise ValueError(f"max_iterations must be at least 1, got {max_iterations}")
        self.tolerance, self.max_iterations = tolerance, max_iterations

    @abstractmethod
    def solve(self, problem: RootProblem[E], x: Float[Tensor, "batch n"]) -> Root[E]:
        """Solve from the initial guess ``x``. Never raises on failure: see ``Root.converged``."""


class Newton(RootFinder):
    """Newton's method ``x⁺ = x − α J⁻¹ g`` with a safeguard for each row (thesis algorithm 3).

    ``stopping="row"``: once most rows have converged only the others go on, and the step of a row
    is halved (``α``) until ``‖g‖`` decreases, so that one bad row costs one row. A row whose step
    is lost in the rounding of ``x`` has converged, too: its ``‖g‖`` is as small as the precision
    lets it be. ``stopping="batch"`` is the rule of the thesis: undamped steps of all rows until
    ``‖g‖_F ≤ tolerance √(B n)``.
    """

    smallest_damping = 1 / 16
    """A row that wants a smaller ``α`` is given up: near a singular Jacobian no root is at hand."""

    def __init__(
        self,
        *,
        tolerance: float = 1e-5,
        max_iterations: int = 10,
        stopping: Literal["row", "batch"] = "row",
    ) -> None:
        super().__init__(tolerance=tolerance, max_iterations=max_iterations)
        if stopping not in ("row", "batch"):
            raise ValueError(f"stopping must be row or batch, got {stopping}")
        self.stopping = stopping

    @torch.no_grad()
    def solve(self, problem: RootProblem[E], x: Tensor) -> Root[E]:
        return self._by_row(problem, x) if self.stopping == "row" else self._by_batch(problem, x)

    def _by_row(self, problem: RootProblem[E], x: Tensor) -> Root[E]:
        at = problem.at(x)
        norm = row_norm(at.residual)
        iterations = torch.zeros(len(x), dtype=torch.int64, device=x.device)
        damping = torch.ones(len(x), dtype=x.dtype, device=x.device)
        settled = torch.zeros(len(x), dtype=torch.bool, device=x.device)
        for _ in range(self.max_iterations):
            # The first condition is written so that NaN stays active, until it is given up.
            active = ~(norm <= self.tolerance) & (damping >= self.smallest_damping)
            active &= ~settled
            count = int(active.sum())
            if count == 0:
                break
            if 2 * count > len(x):  # picking rows would cost more than it saves
                index, here, alpha = None, at, damping
            else:
                index = active.nonzero().squeeze(-1)
                here, alpha = at.rows(index), damping[index]
            before = x if index is None else x[index]
            direction = solve(here.jacobian(), -here.residual)
            still = direction.abs() <= rounding(before)
            settled = _put(settled, index, still.all(-1))
            trial = before + alpha.unsqueeze(-1) * direction
            there = problem.at(trial, index)
            there_norm = row_norm(there.residual)
            old = norm if index is None else norm[index]
            accepted = there_norm <= torch.clamp((1.0 - 1e-4 * alpha) * old, min=self.tolerance)
            alpha = torch.where(accepted, (2.0 * alpha).clamp(max=1.0), 0.5 * alpha)
            iterations += active
            if index is None and bool(accepted.all()):
                x, at, norm, damping = trial, there, there_norm, alpha
                continue
            if index is None:
                index = torch.arange(len(x), device=x.device)
            damping = damping.index_copy(0, index, alpha)
            moved = accepted.nonzero().squeeze(-1)
            to, there = index[moved], there.rows(moved)
            x = x.index_copy(0, to, trial[moved])
            norm = norm.index_copy(0, to, there_norm[moved])
            at = at.replace(to, there)
        return Root(x, (norm <= self.tolerance) | settled, iterations, at)

    def _by_batch(self, problem: RootProblem[E], x: Tensor) -> Root[E]:
        at = problem.at(x)
        iterations = 0
        while iterations < self.max_iterations:
            x = x + solve(at.jacobian(), -at.residual)
            at = problem.at(x)
            iterations += 1
            if bool(joint_norm(at.residual) <= self.tolerance):
                break
        converged = row_norm(at.residual) <= self.tolerance
        converged |= joint_norm(at.residual) <= self.tolerance
        count = torch.full((len(x),), iterations, dtype=torch.int64, device=x.device)
        return Root(x, converged, count, at)


class Broyden(RootFinder):
    """Broyden's method: Newton's Jacobian at the start, then rank-one secant updates.

    ``J⁺ = J + (Δg − J Δx) Δxᵀ / ‖Δx‖²`` (Broyden 1965). Superlinear; one Jacobian in all.
    """

    def __init__(self, *, tolerance: float = 1e-5, max_iterations: int = 30) -> None:
        super().__init__(tolerance=tolerance, max_iterations=max_iterations)

    @torch.no_grad()
    def solve(self, problem: RootProblem[E], x: Tensor) -> Root[E]:
        at = problem.at(x)
        jacobian = at.jacobian()
        norm = row_norm(at.residual)
        iterations = torch.zeros(len(x), dtype=torch.int64, device=x.device)
        for _ in range(self.max_iterations):
            index = (~(norm <= self.tolerance)).nonzero().squeeze(-1)
            if len(index) == 0:
                break
            here, secant = at.residual[index], jacobian[index]
            dx = solve(secant, -here)
            trial = x[index] + dx
            there = problem.at(trial, index)
            mismatch = there.residual - here - matvec(secant, dx)
            scale = dx.square().sum(-1, keepdim=True).clamp(min=torch.finfo(x.dtype).tiny)
            update = mismatch.unsqueeze(-1) * (dx / scale).unsqueeze(-2)
            jacobian = jacobian.index_copy(0, index, secant + update)
            iterations[index] += 1
            x = x.index_copy(0, index, trial)
            norm = norm.index_copy(0, index, row_norm(there.residual))
            at = at.replace(index, there)
        return Root(x, norm <= self.tolerance, iterations, at)


def rounding(x: Tensor) -> Tensor:
    """What a few roundings of ``x`` come to."""
    return 16.0 * torch.finfo(x.dtype).eps * x.abs().clamp(min=1.0)


def _put(x: Tensor, index: Tensor | None, rows: Tensor) -> Tensor:
    """``x`` with the given rows replaced, all of them without an index."""
    return rows if index is None else x.index_copy(0, index, rows)


def row_norm(residual: Tensor) -> Tensor:
    """``‖g‖₂ / √n`` of each row."""
    return residual.square().mean(-1).sqrt()


def joint_norm(residual: Tensor) -> Tensor:
    """``‖g‖_F / √(B n)`` of all rows together."""
    return residual.square().mean().sqrt()
