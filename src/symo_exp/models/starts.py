"""The initial state from which a model's own motion fits measured configurations best."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor
from typing_extensions import override

from symo_exp.mechanics.chart import Ends
from symo_exp.mechanics.roots import Rule, Sizes, absolute, iterate, relative
from symo_exp.mechanics.rows import Rowwise
from symo_exp.mechanics.space import FLAT, Space

ITERATIONS = 12
DIFFERENCE = 1e-5
"""Distance of initial states for differences of rollouts [unit of the coordinate, this per s]."""
GAIN, TINY = 1e-6, 1e-24
"""A row is done if a step is predicted to lower its cost by at most this share, or this number."""
SMALLEST = 1e-12
"""Lower bound on the diagonal that damping scales with."""


class StateSequence(Protocol):
    """A rollout, initial state included."""

    @property
    def q(self) -> Float[Tensor, "batch nodes n"]:
        """Configurations."""
        ...

    @property
    def v(self) -> Float[Tensor, "batch nodes n"]:
        """Velocities."""
        ...


class RollsOut(Protocol):
    """A model that moves from a state under the controls at the nodes."""

    @property
    def time_step(self) -> float:
        """Time between nodes [s]."""
        ...

    def rollout(self, q0: Tensor, v0: Tensor, u: Tensor) -> StateSequence:
        """Roll out from an initial state."""
        ...


@runtime_checkable
class KnowsSlopes(Protocol):
    """A model that may know the derivatives of its rollouts in their initial states."""

    def rollout_slopes(
        self, q: Tensor, v: Tensor, u: Tensor
    ) -> tuple[Float[Tensor, "batch nodes n"], Float[Tensor, "batch nodes n 2n"]] | None:
        """Return configurations and derivatives, NaN in rows and ``None`` if not known."""
        ...


class State(NamedTuple):
    """Configuration and velocity."""

    q: Float[Tensor, "batch n"]
    v: Float[Tensor, "batch n"]


def fitted_start(
    model: RollsOut,
    q: Float[Tensor, "batch nodes n"],
    u: Float[Tensor, "batch nodes m"],
    iterations: int = ITERATIONS,
    weight: Float[Tensor, "batch nodes n"] | None = None,
    start: Float[Tensor, "batch unknowns"] | None = None,
    space: Space = FLAT,
    sizes: Sizes = None,
) -> State:
    """Return the states at node 0 that minimise ``Σ_k w_k |q̂_k(q₀, v₀) − q_k|²`` for each motion.

    Errors are in the units of the coordinates.

    Levenberg-Marquardt for all rows at once, each with its own damping. Derivatives are central
    differences of rollouts where a model does not know them, so that any model can be used. A trial
    that diverges is refused like one that is worse.

    Args:
        model: The model.
        q: Measured configurations [rad, m].
        u: Controls.
        iterations: Trials at most. Most motions need four; those that stick need more.
        weight: ``w``, one if left out.
        start: ``(q₀, v₀)`` to begin from, ``q₀`` in the charts at the first nodes; that of a
            parabola through all nodes if left out.
        space: The space of configurations.
        sizes: Units of the coordinates.
    """
    plain = space.unrolled(q)
    fit = Fit(model, q, u, torch.ones_like(plain) if weight is None else weight, space, sizes)
    begin = parabola(plain, model.time_step) if start is None else start
    x, _, _ = iterate(fit, begin, FitSteps(), iterations)
    return fit.state(x)


def closest_start(
    model: RollsOut,
    q: Float[Tensor, "batch nodes n"],
    u: Float[Tensor, "batch nodes m"],
    space: Space = FLAT,
    sizes: Sizes = None,
) -> Float[Tensor, "batch unknowns"]:
    """Return states ``(q₀, v₀)`` to begin a fit from, for motions of many steps.

    Of parabolas through the first 3, 5, 9, … nodes each motion takes that with the least squares,
    in the units of the coordinates; configurations are in the charts at the first nodes.
    """
    counts = [2**k + 1 for k in range(1, q.shape[1].bit_length()) if 2**k < q.shape[1]]
    plain, repeats = space.unrolled(q), (len(counts), 1, 1)
    starts = torch.stack([parabola(plain[:, :count], model.time_step) for count in counts])
    place, v0 = starts.flatten(0, 1).chunk(2, dim=1)
    q0 = space.point(q[:, 0].repeat(len(counts), 1), place)
    path = model.rollout(q0, v0, u.repeat(repeats)).q
    error = relative(space.difference(q.repeat(repeats), path), sizes)
    cost = error.square().flatten(1).sum(1).nan_to_num(torch.inf, torch.inf)
    chosen = cost.view(len(counts), -1).argmin(0)
    return starts[chosen, torch.arange(len(q), device=q.device)]


@dataclass(eq=False)
class Fit(Rowwise):
    """Least squares of rollouts over their initial states, in the charts at the first nodes.

    Errors are in the units of the coordinates.
    """

    model: RollsOut
    q: Tensor
    u: Tensor
    weight: Tensor
    space: Space = FLAT
    sizes: Sizes = None

    def state(self, x: Float[Tensor, "batch unknowns"]) -> State:
        """Return the initial states."""
        place, v = x.chunk(2, dim=1)
        base = self.q[:, 0].repeat(len(x) // len(self.q), 1)
        return State(self.space.point(base, place), v)

    def at(self, x: Float[Tensor, "batch unknowns"]) -> FitPoint:
        """Evaluate residuals and derivatives: closed forms, elsewhere differences of rollouts."""
        known = None
        if isinstance(self.model, KnowsSlopes):
            known = self.model.rollout_slopes(*self.state(x), self.u)
        if known is None:
            return self._by_differences(x)
        path, slopes = (y.to(self.q) for y in known)
        root, error = self._root(), self.space.difference(self.q, path)
        slopes = self._in_charts(slopes, x, error).flatten(1, 2)
        found = FitPoint(root * error.flatten(1), root.unsqueeze(-1) * slopes)
        lost = (~path.isfinite().flatten(1).all(1)).nonzero().squeeze(1)
        if len(lost) == 0:
            return found
        return found.replace(lost, self.rows(lost)._by_differences(x[lost]))

    def _by_differences(self, x: Float[Tensor, "batch unknowns"]) -> FitPoint:
        """Evaluate residuals and their derivatives by central differences of rollouts."""
        batch, unknowns = x.shape
        root, true = self._root(), self.space.origin(self.q)
        beside = absolute(DIFFERENCE * torch.eye(unknowns).to(x), self.sizes)
        shifts = torch.cat((torch.zeros_like(beside[:1]), beside, -beside))
        starts = (x + shifts[:, None]).flatten(0, 1)
        path = self.model.rollout(*self.state(starts), self.u.repeat(len(shifts), 1, 1)).q
        path = path.to(self.q).unflatten(0, (len(shifts), batch))
        moved = self.space.chart(self.q.expand_as(path), path).flatten(2)
        at, plus, minus = moved.split((1, unknowns, unknowns))
        slopes = ((plus - minus) / (2.0 * DIFFERENCE)).permute(1, 2, 0)
        slopes = relative(slopes, self.sizes)
        error = (at[0].view_as(true) - true).flatten(1)
        return FitPoint(root * error, root.unsqueeze(-1) * slopes.nan_to_num(0.0, 0.0, 0.0))

    def _root(self) -> Float[Tensor, "batch errors"]:
        """Return the factors of errors, ``√w`` over the units of the coordinates."""
        return relative(self.weight.sqrt(), self.sizes).flatten(1)

    def _in_charts(
        self, slopes: Float[Tensor, "batch nodes n 2n"], x: Tensor, error: Tensor
    ) -> Float[Tensor, "batch nodes n 2n"]:
        """Return derivatives along steps of rotations as those of ``error`` in ``x``."""
        if not self.space.rotations:
            return slopes
        by_error = Ends.of(self.space, error.flatten(0, 1)).inverse
        by_start = torch.linalg.inv(Ends.of(self.space, x.chunk(2, dim=1)[0]).inverse)
        place, v = slopes.chunk(2, dim=3)
        slopes = torch.cat((place @ by_start.unsqueeze(1), v), dim=3)
        return by_error.unflatten(0, error.shape[:2]) @ slopes


@dataclass(eq=False)
class FitPoint(Rowwise):
    """Residuals ``√w (q̂ − q) / ℓ`` (batch, r) and their derivatives (batch, r, 2n).

    ``ℓ`` are the units of the coordinates. Residuals of rollouts that diverge are not finite; their
    derivatives are zero.
    """

    residual: Tensor
    slopes: Tensor

    def cost(self) -> Float[Tensor, " batch"]:
        """Return the sum of squares, infinite if it is not a number."""
        return self.residual.square().sum(1).nan_to_num(nan=torch.inf)

    def step(self, damping: Float[Tensor, " batch"]) -> tuple[Tensor, Tensor]:
        """Return the damped Gauss-Newton step and the predicted decrease of the cost.

        The step is zero if the residuals or the equations are not finite.
        """
        gradient = (self.slopes.mT @ self.residual.unsqueeze(-1)).nan_to_num(0.0, 0.0, 0.0)
        normal = self.slopes.mT @ self.slopes
        scale = normal.diagonal(dim1=1, dim2=2).clamp_min(SMALLEST)
        matrix = normal + torch.diag_embed(damping[:, None] * scale)
        step = -torch.linalg.solve_ex(matrix, gradient)[0].nan_to_num(0.0, 0.0, 0.0)
        gain = -(step.mT @ (2.0 * gradient + normal @ step)).flatten()
        return step.squeeze(-1), gain


class FitState(NamedTuple):
    """State of ``FitSteps``."""

    damping: Float[Tensor, " batch"]
    step: Float[Tensor, "batch unknowns"]


class FitSteps(Rule[FitPoint, FitState]):
    """Damped Gauss-Newton steps; rows that gain nothing more are dropped."""

    @override
    def start(self, x: Tensor, at: FitPoint) -> FitState:
        return FitState(x.new_full((len(x),), 1e-3), torch.zeros_like(x))

    @override
    def active(self, x: Tensor, at: FitPoint, state: FitState) -> tuple[Tensor, FitState]:
        step, gain = at.step(state.damping)
        return gain > GAIN * at.cost() + TINY, state._replace(step=step)

    @override
    def drops(self, active: int, rows: int, batch: int) -> bool:
        return True

    @override
    def trial(self, x: Tensor, at: FitPoint, state: FitState) -> tuple[Tensor, FitState]:
        return x + state.step, state

    @override
    def judge(
        self, active: Tensor, at: FitPoint, there: FitPoint, state: FitState
    ) -> tuple[Tensor, FitState]:
        better = there.cost() < at.cost()
        return better, state._replace(damping=state.damping * torch.where(better, 0.1, 10.0))


def parabola(q: Float[Tensor, "batch nodes n"], h: float) -> Float[Tensor, "batch 2*n"]:
    """Return the states ``(q₀, v₀)`` at node 0 of least-squares parabolas through the nodes.

    Nodes are ``h`` [s] apart; two of them have a line.
    """
    t = h * torch.arange(q.shape[1]).to(q)
    powers = t[:, None] ** torch.arange(min(3, len(t))).to(q)
    fit = torch.linalg.pinv(powers) @ q
    return torch.cat((fit[:, 0], fit[:, 1]), dim=1)
