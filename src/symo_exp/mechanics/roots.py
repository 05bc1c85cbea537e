"""Masked iterations for a batch of small independent problems, and root finding with them.

``iterate`` is the one loop: it evaluates a problem, lets a ``Rule`` propose and judge steps row by
row, and drops rows that are done. Newton's method, Broyden's method, the inner equations of the
Galerkin integrators and fitted initial states are rules. Compiled and exported code cannot branch
on values; its counterpart is ``compile.newton.iterate_branch_free``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, Generic, Literal, NamedTuple, Protocol, TypeVar

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from typing_extensions import Self, override

from symo_exp.checks import one_of, real, whole_number
from symo_exp.mechanics.lagrangian import matvec, solve
from symo_exp.mechanics.rows import put_rows, take_rows


class Point(Protocol):
    """A problem evaluated at one batch of points."""

    def rows(self, index: Tensor) -> Self:
        """Return the given rows."""
        ...

    def replace(self, index: Tensor, other: Self) -> Self:
        """Return this point with the given rows taken from ``other``."""
        ...


class RootPoint(Point, Protocol):
    """The equations ``g(x) = 0`` evaluated at one batch of points."""

    @property
    def residual(self) -> Tensor:
        """``g``, (batch, n)."""
        ...

    def jacobian(self) -> Tensor:
        """Return ``∂g/∂x``, (batch, n, n), or an approximation of it."""
        ...


STALLED = 1e4
"""Multiple of the accuracy within which a row that no step improves is a root: where inertias
differ by many orders, rounding leaves no more."""
SECANT = 10.0
"""Bound on Newton's step over that of rounding where the step by secants is lost in it."""
Sizes = tuple[float, ...] | None
"""Units of coordinates [m; 1 of angles], which numbers near zero are relative to; ``None``: 1."""
P = TypeVar("P", bound=Point)
R = TypeVar("R", bound=RootPoint)
S = TypeVar("S", bound=tuple[Any, ...])
P_co = TypeVar("P_co", bound=Point, covariant=True)


class RowProblem(Protocol[P_co]):
    """A problem whose rows are independent of each other."""

    def at(self, x: Tensor) -> P_co:
        """Evaluate the problem at ``x``, (batch, n)."""
        ...

    def rows(self, index: Tensor) -> Self:
        """Return the given rows of the problem."""
        ...


class Rule(ABC, Generic[P, S]):
    """Steps of ``iterate`` and the condition under which its rows are done.

    The state ``S`` is a named tuple of tensors with one row for each sample.
    """

    @abstractmethod
    def start(self, x: Tensor, at: P) -> S:
        """Return the state at the initial guess."""

    @abstractmethod
    def active(self, x: Tensor, at: P, state: S) -> tuple[Bool[Tensor, " batch"], S]:
        """Return the rows that are not done, and the state."""

    @abstractmethod
    def trial(self, x: Tensor, at: P, state: S) -> tuple[Tensor, S]:
        """Return the next ``x`` to try, and the state."""

    @abstractmethod
    def judge(
        self, active: Tensor, at: P, there: P, state: S
    ) -> tuple[Bool[Tensor, " batch"] | None, S]:
        """Return which rows accept the trial evaluated in ``there`` (``None``: all of them)."""

    def drops(self, active: int, rows: int, batch: int) -> bool:
        """Return whether to continue with the ``active`` of ``rows`` rows alone.

        Selecting rows costs time. ``batch`` is the number of rows at the start.
        """
        return False

    def retries(self, at: P) -> bool:
        """Return whether rows that refused a trial propose another one."""
        return True


class Bounds(NamedTuple):
    """The bounds within which a row is a root.

    Attributes:
        tolerance: Bound on ``‖g‖₂ / √n``.
        sizes: Units of the unknowns.
        accuracy: Bound on the root mean square of the step that a root still asks for, in units of
            the unknowns; ``None``: any step.
    """

    tolerance: float
    sizes: Sizes = None
    accuracy: float | None = None

    def norm(
        self, residual: Float[Tensor, "*batch n"], step: Float[Tensor, "*batch n"] | None = None
    ) -> Float[Tensor, " *batch"]:
        """Return ``‖g‖₂ / √n``, or more if the step is longer in relation to its bound."""
        norm = row_norm(residual, self.sizes)
        if self.accuracy is None or step is None:
            return norm
        length = relative(step, self.sizes).square().mean(-1).sqrt()
        return norm.maximum(length * (self.tolerance / self.accuracy))

    def settled(
        self, x: Float[Tensor, "batch n"], step: Float[Tensor, "batch n"]
    ) -> Bool[Tensor, " batch"]:
        """Return the rows whose step is lost in rounding."""
        return (step.abs() <= rounding(x, self.sizes)).all(-1)

    def negligible(
        self, step: Float[Tensor, "*batch k"], resolution: Float[Tensor, "*batch k"]
    ) -> Bool[Tensor, "*batch k"]:
        """Return which parts of a step of Newton's method are within the accuracy, or lost.

        A step of which all parts are leads to a root, even where rounding errors of the equations
        exceed the tolerance, as those of heavy machines do. ``resolution`` is the effect of
        roundings on ``step``.
        """
        if self.accuracy is not None:
            bound = absolute(torch.full_like(step, self.accuracy), self.sizes)
            resolution = resolution.maximum(bound)
        return step.abs() <= resolution


class RootRule(Rule[P, S]):
    """Steps towards roots of ``g``.

    Args:
        bounds: Those of a root.
    """

    def __init__(self, bounds: Bounds) -> None:
        self.bounds = bounds


@torch.no_grad()
def iterate(problem: RowProblem[P], x: Tensor, rule: Rule[P, S], most: int) -> tuple[Tensor, P, S]:
    """Iterate from ``x`` until all rows are done, at most ``most`` times.

    Returns:
        The last accepted ``x``, the problem evaluated there, and the state of the rule.
    """
    at = problem.at(x)
    return _iterate(problem, x, at, rule.start(x, at), rule, most, len(x))


def _iterate(
    problem: RowProblem[P], x: Tensor, at: P, state: S, rule: Rule[P, S], most: int, batch: int
) -> tuple[Tensor, P, S]:
    for left in range(most, 0, -1):
        active, state = rule.active(x, at, state)
        count = int(active.sum())
        if count == 0:
            break
        if count < len(x) and rule.drops(count, len(x), batch):
            index = active.nonzero().squeeze(-1)
            here = problem.rows(index), x[index], at.rows(index), take_rows(state, index)
            x_some, at_some, state_some = _iterate(*here, rule, left, batch)
            x, state = put_rows((x, state), index, (x_some, state_some))
            return x, at.replace(index, at_some), state
        trial, state = rule.trial(x, at, state)
        there = problem.at(trial)
        accepted, state = rule.judge(active, at, there, state)
        if accepted is None or bool(accepted.all()):
            x, at = trial, there
            continue
        index = accepted.nonzero().squeeze(-1)
        if len(index) > 0:
            x, at = x.index_copy(0, index, trial[index]), at.replace(index, there.rows(index))
        elif not rule.retries(at):
            break
    return x, at, state


class Root(NamedTuple, Generic[R]):
    """The solution with its status; the caller decides what an unconverged row means."""

    x: Float[Tensor, "batch n"]
    converged: Bool[Tensor, " batch"]
    iterations: Int[Tensor, " batch"]
    """Evaluations of ``g`` after the one at the start."""
    evaluation: R
    """The problem at ``x``."""


class RootFinder(ABC):
    """Solves ``g(x) = 0`` for each row of a batch.

    Args:
        tolerance: Bound on ``‖g‖₂ / √n`` of a row.
        max_iterations: Bound on the evaluations of ``g`` after the first.
    """

    sizes: Sizes = None
    """Units of the unknowns ``x``; the norm is that of ``g`` times these, energy times time."""
    accuracy: float | None = None
    """Bound on the step that a root still asks for, in these units; ``None``: any step.

    The residual of a light machine is small even far from its root."""

    def __init__(self, *, tolerance: float, max_iterations: int) -> None:
        self.tolerance = real("tolerance", tolerance, above=0)
        self.max_iterations = whole_number("max_iterations", max_iterations)

    @property
    def bounds(self) -> Bounds:
        """The bounds within which a row is a root."""
        return Bounds(self.tolerance, self.sizes, self.accuracy)

    @abstractmethod
    def solve(self, problem: RowProblem[R], x: Float[Tensor, "batch n"]) -> Root[R]:
        """Solve from the initial guess ``x``. Never raises on failure: see ``Root.converged``."""


class Newton(RootFinder):
    """Newton's method ``x⁺ = x − α J⁻¹ g`` with a safeguard for each row (thesis algorithm 3).

    With ``stopping="row"`` every row has its own status. Once most rows have converged only the
    others continue, and the step of a row is halved (``α``) until ``‖g‖`` decreases, so that one
    bad row costs one row. A row whose step is within the accuracy, or lost in the rounding of
    ``x``, has also converged: its ``‖g‖`` is as small as the precision allows. ``stopping="batch"``
    is the rule of the thesis: undamped steps of all rows until ``‖g‖_F ≤ tolerance √(B n)``.

    Args:
        tolerance: Bound on ``‖g‖₂ / √n`` of a row, or of the batch.
        max_iterations: Bound on the evaluations of ``g`` after the first.
        stopping: "row" or "batch".
    """

    def __init__(
        self,
        *,
        tolerance: float = 1e-5,
        max_iterations: int = 10,
        stopping: Literal["row", "batch"] = "row",
    ) -> None:
        super().__init__(tolerance=tolerance, max_iterations=max_iterations)
        self.stopping = one_of("stopping", stopping, ("row", "batch"))

    @override
    def solve(self, problem: RowProblem[R], x: Tensor) -> Root[R]:
        if self.stopping == "batch":
            joint: JointNewton[R] = JointNewton(self.bounds)
            x, at, common = iterate(problem, x, joint, self.max_iterations)
            near = row_norm(at.residual, self.sizes) <= self.tolerance
            converged = near | (common.norm <= self.tolerance)
            return Root(x, converged, common.iterations, at)
        damped: DampedNewton[R] = DampedNewton(self.bounds)
        x, at, state = iterate(problem, x, damped, self.max_iterations)
        near = row_norm(at.residual, self.sizes) <= self.tolerance
        near &= state.norm <= STALLED * self.tolerance
        converged = near | state.settled
        return Root(x, converged, state.iterations, at)


class Damped(NamedTuple):
    """State of ``DampedNewton``."""

    norm: Float[Tensor, " batch"]
    """``‖g‖``, or more where the step that it asks for is longer than the accuracy."""
    jacobian: Float[Tensor, "batch n n"] | None
    damping: Float[Tensor, " batch"]
    """``α``."""
    settled: Bool[Tensor, " batch"]
    """Rows whose step is within the accuracy, or lost in rounding."""
    iterations: Int[Tensor, " batch"]


class DampedNewton(RootRule[R, Damped]):
    """Newton's method with damping, convergence and failure of each row."""

    smallest_damping = 1 / 16
    """A row that asks for a smaller ``α`` is given up: it is near a singular Jacobian."""

    @override
    def start(self, x: Tensor, at: R) -> Damped:
        norm = self.bounds.norm(at.residual)
        if self.bounds.accuracy is not None and bool((norm <= self.bounds.tolerance).any()):
            norm = self.bounds.norm(at.residual, newton_step(at))
        return Damped(
            norm,
            None,
            torch.ones(len(x), dtype=x.dtype, device=x.device),
            torch.zeros(len(x), dtype=torch.bool, device=x.device),
            torch.zeros(len(x), dtype=torch.int64, device=x.device),
        )

    @override
    def active(self, x: Tensor, at: R, state: Damped) -> tuple[Tensor, Damped]:
        # The first condition is written so that NaN stays active until it is given up.
        active = ~(state.norm <= self.bounds.tolerance) & (state.damping >= self.smallest_damping)
        active &= ~state.settled
        return active, state

    @override
    def drops(self, active: int, rows: int, batch: int) -> bool:
        return 2 * active <= batch

    @override
    def trial(self, x: Tensor, at: R, state: Damped) -> tuple[Tensor, Damped]:
        jacobian = at.jacobian()
        step = solve(jacobian, -at.residual)
        settled = self.bounds.negligible(step, rounding(x, self.bounds.sizes)).all(-1)
        state = state._replace(settled=settled)
        if self.bounds.accuracy is not None:
            state = state._replace(norm=self.bounds.norm(at.residual, step), jacobian=jacobian)
        return x + state.damping.unsqueeze(-1) * step, state

    @override
    def judge(self, active: Tensor, at: R, there: R, state: Damped) -> tuple[Tensor | None, Damped]:
        further = None if state.jacobian is None else solve(state.jacobian, -there.residual)
        norm, alpha = self.bounds.norm(there.residual, further), state.damping
        bound = torch.clamp((1.0 - 1e-4 * alpha) * state.norm, min=self.bounds.tolerance)
        accepted = norm <= bound
        alpha = torch.where(accepted, (2.0 * alpha).clamp(max=1.0), 0.5 * alpha)
        norm = torch.where(accepted, norm, state.norm)
        found = Damped(norm, None, alpha, state.settled, state.iterations + active)
        return accepted, found


class JointState(NamedTuple):
    """State of ``JointNewton``."""

    norm: Float[Tensor, " batch"]
    """``‖g‖_F / √(B n)``, the same in every row."""
    iterations: Int[Tensor, " batch"]


class JointNewton(RootRule[R, JointState]):
    """Undamped Newton steps of all rows until ``‖g‖_F / √(B n)`` is within the tolerance."""

    @override
    def start(self, x: Tensor, at: R) -> JointState:
        """Return an infinite norm: the first step is always taken, as in the thesis."""
        counts = torch.zeros(len(x), dtype=torch.int64, device=x.device)
        return JointState(x.new_full((len(x),), torch.inf), counts)

    @override
    def active(self, x: Tensor, at: R, state: JointState) -> tuple[Tensor, JointState]:
        return ~(state.norm <= self.bounds.tolerance), state

    @override
    def trial(self, x: Tensor, at: R, state: JointState) -> tuple[Tensor, JointState]:
        return x + newton_step(at), state

    @override
    def judge(self, active: Tensor, at: R, there: R, state: JointState) -> tuple[None, JointState]:
        norm = joint_norm(there.residual, self.bounds.sizes).expand(len(active))
        return None, JointState(norm, state.iterations + active)


class Broyden(RootFinder):
    """Broyden's method: Newton's Jacobian at the start, then rank-one secant updates.

    ``J⁺ = J + (Δg − J Δx) Δxᵀ / ‖Δx‖²`` (Broyden 1965). It converges superlinearly and evaluates
    one Jacobian in all. A row whose step is lost in rounding has also converged if Newton's step
    there is about as small: far from a root secants may be steep.

    Args:
        tolerance: Bound on ``‖g‖₂ / √n`` of a row.
        max_iterations: Bound on the evaluations of ``g`` after the first.
    """

    def __init__(self, *, tolerance: float = 1e-5, max_iterations: int = 30) -> None:
        super().__init__(tolerance=tolerance, max_iterations=max_iterations)

    @override
    def solve(self, problem: RowProblem[R], x: Tensor) -> Root[R]:
        rule: SecantSteps[R] = SecantSteps(self.bounds)
        x, at, state = iterate(problem, x, rule, self.max_iterations)
        converged = state.norm <= self.tolerance
        index = (state.settled & ~converged).nonzero().squeeze(-1)
        if len(index) > 0:
            step = newton_step(at.rows(index))
            converged[index] = self.bounds.settled(x[index], step / SECANT)
        return Root(x, converged, state.iterations, at)


class Secant(NamedTuple):
    """State of ``SecantSteps``."""

    norm: Float[Tensor, " batch"]
    jacobian: Float[Tensor, "batch n n"]
    step: Float[Tensor, "batch n"]
    settled: Bool[Tensor, " batch"]
    """Rows whose step is lost in rounding."""
    iterations: Int[Tensor, " batch"]


class SecantSteps(RootRule[R, Secant]):
    """Broyden's steps; rows that have converged are dropped at once."""

    @override
    def start(self, x: Tensor, at: R) -> Secant:
        counts = torch.zeros(len(x), dtype=torch.int64, device=x.device)
        jacobian, none = at.jacobian(), torch.zeros_like(counts, dtype=torch.bool)
        return Secant(self._norm(at, jacobian), jacobian, torch.zeros_like(x), none, counts)

    @override
    def active(self, x: Tensor, at: R, state: Secant) -> tuple[Tensor, Secant]:
        return ~(state.norm <= self.bounds.tolerance) & ~state.settled, state

    @override
    def drops(self, active: int, rows: int, batch: int) -> bool:
        return True

    @override
    def trial(self, x: Tensor, at: R, state: Secant) -> tuple[Tensor, Secant]:
        step = solve(state.jacobian, -at.residual)
        settled = self.bounds.settled(x, step)
        return x + step, state._replace(step=step, settled=settled)

    @override
    def judge(self, active: Tensor, at: R, there: R, state: Secant) -> tuple[None, Secant]:
        _, secant, step, settled, iterations = state
        mismatch = there.residual - at.residual - matvec(secant, step)
        scale = step.square().sum(-1, keepdim=True).clamp(min=torch.finfo(step.dtype).tiny)
        secant = secant + mismatch.unsqueeze(-1) * (step / scale).unsqueeze(-2)
        norm = self._norm(there, secant)
        return None, Secant(norm, secant, step, settled, iterations + active)

    def _norm(self, at: R, secant: Float[Tensor, "batch n n"]) -> Float[Tensor, " batch"]:
        further = None if self.bounds.accuracy is None else solve(secant, -at.residual)
        return self.bounds.norm(at.residual, further)


def newton_step(at: RootPoint) -> Float[Tensor, "batch n"]:
    """Return ``−J⁻¹ g``."""
    return solve(at.jacobian(), -at.residual)


def attach_root(
    x: Float[Tensor, "batch n"],
    residual: Float[Tensor, "batch n"],
    jacobian: Float[Tensor, "batch n n"],
) -> Float[Tensor, "batch n"]:
    """Return the root ``x`` of ``g(x; θ) = 0`` as a differentiable function of ``θ``.

    By the implicit function theorem (thesis theorem 5.2.1). ``x`` and ``jacobian = ∂g/∂x`` are
    numbers; ``residual`` is ``g(x; θ)`` with a graph in ``θ``, ``x`` itself held fixed. The result,
    ``x − J⁻¹ g(x; θ)``, has the value of the root (one Newton correction further) and the
    derivative ``∂x/∂θ = −J⁻¹ ∂g/∂θ``; its backward pass solves with ``Jᵀ``, the corrected (5.24).
    """
    return x.detach() - solve(jacobian.detach(), residual)


def rounding(x: Float[Tensor, "*batch k"], sizes: Sizes) -> Float[Tensor, "*batch k"]:
    """Return a bound on the effect of a few roundings of ``x``, in numbers of its order or one."""
    size = x.abs().clamp(min=1.0) if sizes is None else x.abs().maximum(column_sizes(sizes, x))
    return 16.0 * torch.finfo(x.dtype).eps * size


def column_sizes(sizes: tuple[float, ...], like: Float[Tensor, "*batch k"]) -> Float[Tensor, " k"]:
    """Return the units of the columns of a tensor, in which those of all coordinates repeat."""
    return like.new_tensor(sizes).repeat(like.shape[-1] // len(sizes))


def row_norm(residual: Float[Tensor, "*batch n"], sizes: Sizes) -> Float[Tensor, " *batch"]:
    """Return ``‖g‖₂ / √n`` of each row."""
    return as_actions(residual, sizes).square().mean(-1).sqrt()


def joint_norm(residual: Float[Tensor, "batch n"], sizes: Sizes) -> Float[Tensor, ""]:
    """Return ``‖g‖_F / √(B n)`` of all rows together."""
    return as_actions(residual, sizes).square().mean().sqrt()


def relative(x: Float[Tensor, "*batch k"], sizes: Sizes) -> Float[Tensor, "*batch k"]:
    """Return changes of coordinates, given in SI units, in the units of the coordinates."""
    return x if sizes is None else x / column_sizes(sizes, x)


def absolute(x: Float[Tensor, "*batch k"], sizes: Sizes) -> Float[Tensor, "*batch k"]:
    """Return changes of coordinates, given in the units of the coordinates, in SI units."""
    return x if sizes is None else x * column_sizes(sizes, x)


def as_actions(momenta: Float[Tensor, "*batch k"], sizes: Sizes) -> Float[Tensor, "*batch k"]:
    """Return momenta times the units of their coordinates: all have the unit energy times time."""
    return momenta if sizes is None else momenta * column_sizes(sizes, momenta)
