"""A step of total least squares: Gauss-Newton over nodes and parameters, and the evidence.

With ``J_x``, ``J_θ`` the derivatives of the residuals ``r`` and ``y`` the measured nodes

    e = r + J_x (y − x)        S = J_x J_xᵀ + ε² I

eliminate the nodes ``x``, ``(J_θᵀ S⁻¹ J_θ + σ² α + λ diag) δ = −J_θᵀ S⁻¹ e − σ² α θ`` moves the
parameters, and ``x = y − J_xᵀ S⁻¹ (e + J_θ δ)`` puts the nodes back. The step is accelerated (see
``descent``): ``½ r''`` along it joins ``e``. The nodes are then put back once more with the
residuals there. ``S`` is banded: everything takes time linear in the nodes.

Where the model depends on ``θ_i²`` and the gradient ``g`` drives ``θ_i`` to zero, ``g_i/θ_i`` joins
the diagonal: a part of the second derivative that Gauss-Newton leaves out. Without it the steps of
``θ_i`` grow like ``1/θ_i``, and with them the damping of all parameters, so that friction that is
not there keeps the others from the data.

A refused step is tried again without the acceleration, which is also that of the nodes' own way,
then with more damping: ``λ`` of the parameters or, if the nodes alone do not find their way,
``μ |x − x_before|²``, since dry friction bends the residuals within a step.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from typing_extensions import override

from symo_exp.nets.roles import are_squares, is_coefficient, is_late
from symo_exp.optim.banded import BandFactor, Chain
from symo_exp.optim.base import EpochOptimizer, Equations
from symo_exp.optim.damped import solved
from symo_exp.optim.descent import PROBE, Descent, Move, accelerated
from symo_exp.optim.evidence import evidence

SUCCESS, FAILURE, SURPRISE = 1 / 3, 8.0, 2.5
"""Factors of the damping after a step as predicted, a refused one, and one that gains little."""
TRIALS = 14
"""Trials of a step; the damping grows by twelve powers of ten in them."""
LIMIT, SETTLED = 1e12, 1e-6
"""The largest damping, and the relative change of noise and priors that counts as none."""


class SmoothingObjective:
    """``Σ|x − y|² + Σ|r|²/ε² + σ² Σ_g α_g |θ_g|²``, in units of the noise of ``q``.

    Args:
        owner: The optimiser.
        model: The equations.
        chain: The measured nodes.
        weight: The noise of each column of the nodes, relative to ``σ``.
        epsilon: ``ε``; ``None`` holds the nodes.
        late: Whether late parameters move.
    """

    def __init__(
        self,
        owner: EpochOptimizer,
        model: Equations,
        chain: Chain,
        weight: Float[Tensor, " d"],
        epsilon: float | None,
        *,
        late: bool,
    ) -> None:
        self.owner, self.memory, self.chain, self.epsilon = owner, owner.memory, chain, epsilon
        self._model, self.weight = model, weight
        sizes = torch.tensor([p.numel() for p in owner.parameters])
        self._group = torch.repeat_interleave(torch.arange(len(sizes)), sizes)
        self._flat = torch.tensor([is_coefficient(p) for p in owner.parameters])
        self.squares = torch.cat([are_squares(p).flatten() for p in owner.parameters])
        """Parameters of which the model depends on the squares."""
        moves = [late or not is_late(p) for p in owner.parameters]
        self.moves = torch.tensor(moves)[self._group]
        """Parameters that move."""

    @property
    def precision(self) -> Float[Tensor, " parameters"]:
        """``α`` of each parameter."""
        precision: Tensor = self.memory["precision"][self._group]
        return precision

    @torch.no_grad()
    def residuals(self, x: Float[Tensor, "nodes d"]) -> Float[Tensor, "windows k"]:
        """Return ``r``; residuals of velocities are divided by their weight."""
        return self.chain.weighted(self._model.residuals, self.chain.stencil(x), self.weight)

    def differentiated(self, x: Tensor, parameters: Sequence[Tensor]) -> tuple[Any, ...]:
        """Return ``r``, ``J_θ`` and ``J_x``."""
        return self.chain.linearised(self._model.residuals, x, self.weight, parameters)

    def value(self, x: Tensor, r: Tensor, theta: Tensor) -> float:
        """Return the objective at nodes ``x`` and parameters ``θ`` with residuals ``r``."""
        return self.misfit(x, r) + self.memory["noise"] * float(self.precision @ theta.square())

    def misfit(self, x: Tensor, r: Tensor) -> float:
        """Return ``χ²`` in units of ``σ²``, infinite if it is not a number."""
        if self.epsilon is None:
            misfit = r.square().sum()
        else:
            moved = ((x - self.chain.x) / self.weight).square().sum()
            misfit = moved + r.square().sum() / self.epsilon**2
        return float(misfit.nan_to_num(nan=math.inf, posinf=math.inf))

    def noise(self, x: Float[Tensor, "nodes d"]) -> float:
        """Return ``σ² = χ²/M`` at nodes ``x``, one if it is not a number."""
        r = self.residuals(x)
        noise = self.misfit(x, r) / r.numel()
        return noise if math.isfinite(noise) else 1.0

    def update_priors(self, gram: Tensor, x: Tensor, r: Tensor, theta: Tensor) -> bool:
        """Update noise ``σ² = χ²/(M − γ)`` and priors from the evidence.

        Returns:
            Whether they have settled. They stay as they are if the posterior has no factor.
        """
        noise, precision = self.memory["noise"], self.memory["precision"]
        found = evidence(gram, noise, precision, theta, self._group, self.moves, self._flat)
        misfit = self.misfit(x, r)
        if found is None or not math.isfinite(misfit):
            return True
        self.memory["precision"], determined = found
        freedom = max(r.numel() - determined, 0.1 * r.numel())
        self.memory["noise"] = max(misfit / freedom, 1e-24)
        return math.isclose(noise, self.memory["noise"], rel_tol=SETTLED) and torch.allclose(
            precision, self.memory["precision"], rtol=SETTLED, atol=0.0
        )


def smoothing_step(objective: SmoothingObjective) -> tuple[dict[str, float], bool]:
    """Move nodes and parameters by one accepted step, then update noise and priors.

    Returns:
        Metrics, and whether further steps are pointless: none was accepted at the largest damping,
        and noise and priors no longer change.
    """
    memory = objective.memory
    descent = NodesAndParameters(objective)
    accepted = descent.run(TRIALS)
    free, x, r, theta = descent.free, descent.x, descent.r, descent.theta
    settled = free is None or objective.update_priors(free.gram, x, r, theta)
    stuck = max(memory["damping"], memory["held"]) >= LIMIT
    metrics = {
        "train_loss": float(r.square().mean()),
        "noise_estimate": memory["noise"] ** 0.5,
        "damping": memory["damping"],
    }
    return metrics, not accepted and stuck and settled


class Reduced(NamedTuple):
    """The linear problem without its nodes."""

    e: Float[Tensor, "windows k"]
    """``r + J_x (y − x)``."""
    by_x: tuple[Float[Tensor, "windows k d"], ...]
    factor: BandFactor | None
    """Of ``S``; ``None`` if the nodes are held."""
    target: Float[Tensor, "nodes d"]
    """``y``, or with damped nodes a point between ``y`` and ``x``."""
    weight: float
    """``1 + μ``, of the nodes' distance from there."""
    gram: Float[Tensor, "parameters parameters"]
    """``J_θᵀ S⁻¹ J_θ``."""
    gradient: Float[Tensor, " parameters"]
    """``J_θᵀ S⁻¹ e``."""


class NodesAndParameters(Descent):
    """Trials of one step of nodes and parameters."""

    def __init__(self, objective: SmoothingObjective) -> None:
        self._objective, self._memory = objective, objective.memory
        self._owner, self._chain = objective.owner, objective.chain
        self.x, self.theta = self._memory["nodes"], self._owner.flat()
        self.r, by_theta, self._by_x = objective.differentiated(self.x, self._owner.parameters)
        self._by_theta = by_theta * objective.moves
        self.free = self._eliminated(0.0)
        """The problem without damped nodes."""
        self._at: Reduced | None = None
        self._held = 0.0
        super().__init__(objective.value(self.x, self.r, self.theta))

    @override
    def proposed(self) -> Move | None:
        self._held = self._memory["held"] if self._objective.epsilon else 0.0
        self._at = at = self._eliminated(self._held) if self._held else self.free
        if at is None:
            return None
        prior = self._memory["noise"] * self._objective.precision
        diagonal = at.gram.diagonal()
        damping = self._memory["damping"] * (diagonal + 1e-6 * diagonal.amax())
        slope = (at.gradient + prior * self.theta) * self._objective.moves
        bent = torch.where(self._objective.squares, slope / self.theta, 0.0)
        bent = bent.nan_to_num(0.0).clamp(min=0.0)
        factor, info = torch.linalg.cholesky_ex(at.gram + torch.diag(prior + bent + damping))
        if int(info) != 0:
            return None
        straight = -solved(factor, slope)
        bend = self._bend(at, straight)
        pull = bend if at.factor is None else at.factor.solve(bend)
        correction = -solved(factor, self._by_theta.flatten(0, 1).T @ pull.flatten())
        predicted = float(-(slope @ straight) + damping @ straight.square())

        def length(step: Tensor) -> Tensor:
            return (damping @ step.square()).sqrt()

        return accelerated(straight, bend, correction, predicted, length)

    @override
    def take(self, move: Move) -> float:
        assert self._at is not None
        value = self._placed(self._at, move)
        if value >= self.objective and move.bend is not None and self._at.factor is not None:
            # No damping of the parameters shortens the nodes' own way and its bend.
            value = self._placed(self._at, move.straight())
        return value

    def _placed(self, at: Reduced, move: Move) -> float:
        moved = self.theta + move.step
        self._owner.place(moved)
        x, r = self._arrived(at, move)
        self._trial = x, r, moved
        return self._objective.value(x, r, moved)

    @override
    def accepted(self, gain: float, *, first: bool) -> None:
        self.x, self.r, self.theta = self._trial
        self._memory["nodes"] = self.x
        if gain < 0.2:
            self._memory["damping"] *= SURPRISE
        elif gain > 0.6 and first:
            self._memory["damping"] *= SUCCESS
            self._memory["held"] = self._held * SUCCESS if self._held > 1.0 else 0.0

    @override
    def refused(self) -> None:
        self._owner.place(self.theta)
        held_nodes = self._objective.epsilon is None
        if held_nodes or (self._at is not None and self._nodes_settle(self._at)):
            self._memory["damping"] = min(self._memory["damping"] * FAILURE, LIMIT)
        else:
            self._memory["held"] = min(max(self._held * FAILURE, 1.0), LIMIT)

    def _nodes(self, at: Reduced, e: Tensor) -> Float[Tensor, "nodes d"]:
        """Return ``y − J_xᵀ S⁻¹ e``."""
        if at.factor is None:
            return self.x
        moved = self._chain.spread(at.by_x, at.factor.solve(e)) / at.weight
        return at.target - self._objective.weight * moved

    def _bend(self, at: Reduced, delta: Tensor) -> Float[Tensor, "windows k"]:
        """Return ``½ r''`` along a step of the parameters and the nodes that follow it."""
        linear = self._by_theta @ delta
        way = self._nodes(at, at.e + linear) - self.x
        linear = linear + self._chain.apply(at.by_x, way / self._objective.weight)
        self._owner.place(self.theta + PROBE * delta)
        there = self._objective.residuals(self.x + PROBE * way)
        return (there - self.r - PROBE * linear) / PROBE**2

    def _eliminated(self, held: float) -> Reduced | None:
        """Eliminate the nodes, damped by ``μ = held``; ``None`` if ``S`` has no factor."""
        weight, by_theta = 1.0 + held, self._by_theta
        target = self.x + (self._chain.x - self.x) / weight
        if self._objective.epsilon is None:
            e, factor, white, white_e = self.r, None, by_theta.flatten(0, 1), self.r.flatten()
        else:
            e, factor = self._factored(self.x, self.r, self._by_x, target, weight)
            if factor is None:
                return None
            white, white_e = factor.whiten(by_theta), factor.whiten(e).flatten()
        gram, gradient = white.T @ white, white.T @ white_e
        return Reduced(e, self._by_x, factor, target, weight, gram, gradient)

    def _factored(
        self, x: Tensor, r: Tensor, by_x: tuple[Tensor, ...], target: Tensor, weight: float
    ) -> tuple[Tensor, BandFactor | None]:
        """Return ``e`` and the factor of ``S``, if there is one."""
        assert self._objective.epsilon is not None
        e = r + self._chain.apply(by_x, (target - x) / self._objective.weight)
        scaled = tuple(j / weight**0.5 for j in by_x)
        return e, self._chain.factor(scaled, self._objective.epsilon**2)

    def _arrived(self, at: Reduced, move: Move) -> tuple[Tensor, Tensor]:
        """Return the nodes that belong to the parameters in place, and the residuals there.

        The better of two steps of the nodes and of the first one alone, which is surely downhill.
        """
        e = at.e + self._by_theta @ move.step
        x = self._nodes(at, e if move.bend is None else e + move.bend)
        if at.factor is None:
            return x, self._objective.residuals(x)
        r, _, by_x = self._objective.differentiated(x, ())
        e, factor = self._factored(x, r, by_x, at.target, at.weight)
        if factor is None:
            return x, r
        further = self._nodes(at._replace(by_x=by_x, factor=factor), e)
        steps = (x, r), (further, self._objective.residuals(further))
        return min(steps, key=lambda step: self._objective.misfit(*step))

    def _nodes_settle(self, at: Reduced) -> bool:
        """Return whether a step of the nodes alone does not raise the objective."""
        x = self._nodes(at, at.e)
        value = self._objective.value(x, self._objective.residuals(x), self.theta)
        return value <= self.objective * (1.0 + 1e-13)
