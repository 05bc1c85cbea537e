"""A step of total least squares: Gauss-Newton over nodes and parameters, and the evidence."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

import torch
from jaxtyping import Float
from scipy.interpolate import make_smoothing_spline
from torch import Tensor

from symo_exp.mechanics.types import Trajectory
from symo_exp.nets.affine import parameter_jacobian
from symo_exp.nets.roles import is_coefficient, is_late
from symo_exp.optim.banded import BandFactor, Chain
from symo_exp.optim.base import Problem

FLAT = 1e-6
"""Prior precision of coefficients, which are hardly to be drawn to zero."""
LEAST, MOST = 1e-6, 1e6
"""Prior precisions that the evidence may ask for."""
SUCCESS, FAILURE, SURPRISE = 1 / 3, 8.0, 2.5
"""What damping is multiplied by: after a step as foreseen, one refused, one that gains little."""

TENTH, BEND = 0.1, 0.75
"""Where on the way its bend is measured; the longest correction for it, twice, over the step."""


class Owner(Protocol):
    """Whose step it is."""

    parameters: list[Tensor]
    memory: dict[str, Any]
    trials: int
    velocity_weight: float

    def flat(self) -> Tensor: ...
    def place(self, flat: Tensor) -> None: ...


class Linear(NamedTuple):
    """The problem around the present nodes and parameters, in units of the noise of ``q``."""

    e: Float[Tensor, "windows k"]
    """``r + J_x (y − x)``."""
    by_theta: Float[Tensor, "windows k parameters"]
    by_x: tuple[Float[Tensor, "windows k d"], ...]
    factor: BandFactor | None
    """Of ``S``; ``None`` where the nodes are held."""
    target: Float[Tensor, "nodes d"]
    """``y``, or with damped nodes a point between ``y`` and ``x``."""
    weight: float
    """``1 + μ`` of the nodes' distance from there."""
    gram: Float[Tensor, "parameters parameters"]
    """``J_θᵀ S⁻¹ J_θ``."""
    gradient: Float[Tensor, " parameters"]
    """``J_θᵀ S⁻¹ e``."""


class Move(NamedTuple):
    """A trial."""

    delta: Float[Tensor, " parameters"]
    bend: Float[Tensor, "windows k"]
    """``½ r''`` along it."""
    foreseen: float
    """By how much the objective should fall."""


class Smoothing:
    """One step. With ``J_x``, ``J_θ`` the derivatives of the residuals ``r``

        e = r + J_x (y − x)        S = J_x J_xᵀ + ε² I

    eliminate the nodes, ``(J_θᵀ S⁻¹ J_θ + σ² α + λ diag) δ = −J_θᵀ S⁻¹ e − σ² α θ`` moves the
    parameters, and ``x = y − J_xᵀ S⁻¹ (e + J_θ δ)`` puts the nodes back. To second order, by
    geodesic acceleration (Transtrum and Sethna 2012), ``½ r''`` along the step joins ``e``: valleys
    are bent. The nodes are then put back once more with the residuals there. A step that lowers the
    objective is taken, another tried again with more damping: ``λ``, or where the nodes alone would
    go astray ``μ |x − x_before|²``, for dry friction bends the residuals within a step. ``S`` is
    banded: all takes time linear in the nodes.

    Noise and priors, a group for each parameter tensor, come from the evidence (MacKay 1992):
    ``γ_g = Σ_{i∈g} 1 − α_g (G/σ² + α)⁻¹ᵢᵢ``, ``α_g = γ_g/|θ_g|²``, ``σ² = χ²/(M − γ)``.
    """

    def __init__(
        self, owner: Owner, model: Problem, chain: Chain, epsilon: float | None, *, late: bool
    ) -> None:
        """``epsilon=None`` holds the nodes; ``late`` lets the late parameters move."""
        self._owner, self._memory, self._model = owner, owner.memory, model
        self._chain, self._epsilon = chain, epsilon
        self._weight = torch.ones(chain.x.shape[1], dtype=torch.float64)
        self._weight[chain.n :] = owner.velocity_weight
        sizes = torch.tensor([p.numel() for p in owner.parameters])
        self._group = torch.repeat_interleave(torch.arange(len(sizes)), sizes)
        moves = [late or not is_late(p) for p in owner.parameters]
        self._moves = torch.tensor(moves)[self._group]

    def step(self) -> dict[str, float]:
        """Tries steps with growing damping until one is taken; the numbers of the epoch."""
        owner, memory = self._owner, self._memory
        x, theta = memory["nodes"], owner.flat()
        r, by_theta, by_x = self._differentiated(x, owner.parameters)
        by_theta = by_theta * self._moves
        free = self._eliminated(x, r, by_theta, by_x, 0.0)
        objective = before = self._objective(x, r, theta)
        for trial in range(owner.trials):
            held = memory["held"] if self._epsilon else 0.0
            at = self._eliminated(x, r, by_theta, by_x, held) if held else free
            move = self._move(at, x, r, theta)
            if move is not None:
                moved = theta + move.delta
                owner.place(moved)
                there, r_there = self._arrived(at, move)
                objective = self._objective(there, r_there, moved)
                if objective < before:
                    gain = (before - objective) / max(move.foreseen, 1e-300)
                    memory["nodes"], x, r, theta = there, there, r_there, moved
                    if gain < 0.2:
                        memory["damping"] *= SURPRISE
                    elif gain > 0.6 and trial == 0:
                        memory["damping"] *= SUCCESS
                        memory["held"] = held * SUCCESS if held > 1.0 else 0.0
                    break
            owner.place(theta)
            if self._nodes_settle(at, before, theta):
                memory["damping"] = min(memory["damping"] * FAILURE, 1e12)
            else:
                memory["held"] = min(max(held * FAILURE, 1.0), 1e12)
        self._update_evidence(free.gram, x, r, theta)
        return {
            "train_loss": float(r.square().mean()),
            "noise_estimate": memory["noise"] ** 0.5,
            "damping": memory["damping"],
        }

    def _residuals(self, stencil: Sequence[Tensor]) -> Tensor:
        """``r``, those of velocities over their weight."""
        found = self._model.residuals(self._chain.windows(*stencil))
        return found / self._weight[: found.shape[1]]

    def _differentiated(self, x: Tensor, parameters: Sequence[Tensor]) -> tuple[Any, ...]:
        """``r``, ``J_θ`` and ``J_x``."""
        stencil = [y.clone().requires_grad_() for y in self._chain.stencil(x)]
        r, by_theta, by_x = parameter_jacobian(
            lambda: self._residuals(stencil), parameters, stencil
        )
        return r, by_theta, tuple(j * self._weight for j in by_x)

    def _eliminated(
        self, x: Tensor, r: Tensor, by_theta: Tensor, by_x: tuple[Tensor, ...], held: float
    ) -> Linear:
        """The problem without its nodes, these damped by ``μ = held``."""
        weight = 1.0 + held
        target = x + (self._chain.x - x) / weight
        if self._epsilon is None:
            e, factor = r, None
            white, white_e = by_theta.flatten(0, 1), e.flatten()
        else:
            e, factor = self._factored(x, r, by_x, target, weight)
            white, white_e = factor.whiten(by_theta), factor.whiten(e).flatten()
        gram, gradient = white.T @ white, white.T @ white_e
        return Linear(e, by_theta, by_x, factor, target, weight, gram, gradient)

    def _factored(
        self, x: Tensor, r: Tensor, by_x: tuple[Tensor, ...], target: Tensor, weight: float
    ) -> tuple[Tensor, BandFactor]:
        """``e`` and the factor of ``S``."""
        assert self._epsilon is not None
        e = r + self._chain.apply(by_x, (target - x) / self._weight)
        scaled = tuple(j / weight**0.5 for j in by_x)
        return e, self._chain.factor(scaled, self._epsilon**2)

    def _move(self, at: Linear, x: Tensor, r: Tensor, theta: Tensor) -> Move | None:
        """The next trial; ``None`` where the equations have no factor or the way bends too much."""
        prior = self._memory["noise"] * self._memory["precision"][self._group]
        slope = (at.gradient + prior * theta) * self._moves
        diagonal = at.gram.diagonal()
        damping = self._memory["damping"] * (diagonal + 1e-6 * diagonal.amax())
        factor, info = torch.linalg.cholesky_ex(at.gram + torch.diag(prior + damping))
        if int(info) != 0:
            return None
        delta = -torch.cholesky_solve(slope.unsqueeze(-1), factor).squeeze(-1)
        foreseen = float(-(slope @ delta) + damping @ delta.square())
        bend = self._bend(at, x, r, theta, delta)
        pull = bend if at.factor is None else at.factor.solve(bend)
        pulled = (at.by_theta.flatten(0, 1).T @ pull.flatten()).unsqueeze(-1)
        turn = -torch.cholesky_solve(pulled, factor).squeeze(-1)
        if not 4.0 * damping @ turn.square() <= BEND**2 * (damping @ delta.square()):
            return Move(delta, torch.zeros_like(bend), foreseen)
        return Move(delta + turn, bend, foreseen)

    def _bend(
        self, at: Linear, x: Tensor, r: Tensor, theta: Tensor, delta: Tensor
    ) -> Float[Tensor, "windows k"]:
        """``½ r''`` along the step, by residuals a tenth of the way."""
        way = self._nodes(at, at.e + at.by_theta @ delta) - x
        linear = at.by_theta @ delta + self._chain.apply(at.by_x, way / self._weight)
        self._owner.place(theta + TENTH * delta)
        with torch.no_grad():
            there = self._residuals(self._chain.stencil(x + TENTH * way))
        return (there - r - TENTH * linear) / TENTH**2

    def _nodes(self, at: Linear, e: Tensor) -> Float[Tensor, "nodes d"]:
        """``y − J_xᵀ S⁻¹ e``."""
        if at.factor is None:
            held: Tensor = self._memory["nodes"]
            return held
        moved = self._chain.spread(at.by_x, at.factor.solve(e)) / at.weight
        return at.target - self._weight * moved

    def _arrived(self, at: Linear, move: Move) -> tuple[Tensor, Tensor]:
        """The nodes that go with the parameters in place, and the residuals there: after two steps
        or after the first, which alone is surely downhill."""
        x = self._nodes(at, at.e + at.by_theta @ move.delta + move.bend)
        if at.factor is None:
            with torch.no_grad():
                return x, self._residuals(self._chain.stencil(x))
        r, _, by_x = self._differentiated(x, ())
        try:
            e, factor = self._factored(x, r, by_x, at.target, at.weight)
        except ArithmeticError:
            return x, r
        further = self._nodes(at._replace(by_x=by_x, factor=factor), e)
        with torch.no_grad():
            r_further = self._residuals(self._chain.stencil(further))
        worse = self._misfit(further, r_further) > self._misfit(x, r)
        return (x, r) if worse else (further, r_further)

    def _nodes_settle(self, at: Linear, before: float, theta: Tensor) -> bool:
        """Whether the nodes alone find their way, the parameters where they were."""
        x = self._nodes(at, at.e)
        with torch.no_grad():
            r = self._residuals(self._chain.stencil(x))
        return self._objective(x, r, theta) <= before * (1.0 + 1e-13)

    def _objective(self, x: Tensor, r: Tensor, theta: Tensor) -> float:
        """``σ²`` times what is minimised."""
        precision = self._memory["precision"][self._group]
        return self._misfit(x, r) + self._memory["noise"] * float(precision @ theta.square())

    def _misfit(self, x: Tensor, r: Tensor) -> float:
        """``χ²`` in units of ``σ²``."""
        if self._epsilon is None:
            return float(r.square().sum())
        moved = ((x - self._chain.x) / self._weight).square().sum()
        return float(moved + r.square().sum() / self._epsilon**2)

    def _update_evidence(self, gram: Tensor, x: Tensor, r: Tensor, theta: Tensor) -> None:
        """New noise and priors; where the posterior has no factor, the old ones."""
        memory, group = self._memory, self._group
        precision = memory["precision"][group]
        factor, info = torch.linalg.cholesky_ex(gram / memory["noise"] + torch.diag(precision))
        if int(info) != 0:
            return
        determined = 1.0 - precision * torch.cholesky_inverse(factor).diagonal()
        determined = determined.clamp(0.0, 1.0) * self._moves
        gamma = torch.zeros_like(memory["precision"]).index_add_(0, group, determined)
        size = torch.zeros_like(gamma).index_add_(0, group, theta.square())
        flat = torch.tensor([is_coefficient(p) for p in self._owner.parameters])
        found = (gamma / size).clamp(LEAST, MOST)
        known = ~flat & (gamma > 0) & (size > 0)
        memory["precision"] = torch.where(known, found, memory["precision"])
        freedom = max(r.numel() - float(gamma.sum()), 0.1 * r.numel())
        memory["noise"] = max(self._misfit(x, r) / freedom, 1e-24)


def smoothed(trajectories: Sequence[Trajectory], velocities: bool) -> Float[Tensor, "nodes d"]:
    """Every coordinate by a smoothing spline, as smooth as generalised cross-validation says."""
    return torch.cat([_splines(t, velocities) for t in trajectories])


def _splines(trajectory: Trajectory, velocities: bool) -> Tensor:
    y = torch.cat((trajectory.q, trajectory.v), dim=1) if velocities else trajectory.q
    if len(y) < 6:  # fewer than a spline needs
        return y.double().clone()
    time = torch.arange(len(y)).double().numpy()
    columns = [make_smoothing_spline(time, c)(time) for c in y.double().T.numpy()]
    return torch.stack([torch.as_tensor(c) for c in columns], dim=1)
