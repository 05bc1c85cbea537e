"""A step of total least squares: Gauss-Newton over nodes and parameters, and the evidence."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

import torch
from jaxtyping import Float
from torch import Tensor

from symo_exp.nets.affine import parameter_jacobian
from symo_exp.nets.roles import is_coefficient, is_late
from symo_exp.optim.banded import BandFactor, Chain
from symo_exp.optim.base import Problem
from symo_exp.optim.evidence import evidence

SUCCESS, FAILURE, SURPRISE = 1 / 3, 8.0, 2.5
"""What damping is multiplied by: after a step as foreseen, one refused, one that gains little."""

TENTH, BEND = 0.1, 0.75
"""Where on the way its bend is measured; the longest correction for it, twice, over the step."""
TRIALS = 14
"""Trials of a step; the damping grows by twelve powers of ten in them."""
LIMIT, SETTLED = 1e12, 1e-6
"""The largest damping, and the relative change of noise and priors that counts as none."""


class Owner(Protocol):
    """Whose step it is."""

    parameters: list[Tensor]
    memory: dict[str, Any]

    def weight(self, chain: Chain) -> Float[Tensor, " d"]: ...
    def flat(self) -> Tensor: ...
    def place(self, flat: Tensor) -> None: ...


class Reduced(NamedTuple):
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


class Found(NamedTuple):
    """The result of a step."""

    metrics: dict[str, float]
    ended: bool
    """Whether further steps would find nothing: none was accepted at the largest damping, and noise
    and priors no longer change."""


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

    Noise, ``σ² = χ²/(M − γ)``, and priors of every tensor come from the ``evidence``.
    """

    def __init__(
        self, owner: Owner, model: Problem, chain: Chain, epsilon: float | None, *, late: bool
    ) -> None:
        """``epsilon=None`` holds the nodes; ``late`` lets the late parameters move."""
        self._owner, self._memory, self._model = owner, owner.memory, model
        self._chain, self._epsilon = chain, epsilon
        self._weight = owner.weight(chain)
        sizes = torch.tensor([p.numel() for p in owner.parameters])
        self._group = torch.repeat_interleave(torch.arange(len(sizes)), sizes)
        self._flat = torch.tensor([is_coefficient(p) for p in owner.parameters])
        moves = [late or not is_late(p) for p in owner.parameters]
        self._moves = torch.tensor(moves)[self._group]

    def step(self) -> Found:
        """Try steps with growing damping until one lowers the objective."""
        owner, memory = self._owner, self._memory
        x, theta = memory["nodes"], owner.flat()
        r, by_theta, by_x = self._differentiated(x, owner.parameters)
        by_theta = by_theta * self._moves
        free = self._eliminated(x, r, by_theta, by_x, 0.0)
        before, accepted = self._objective(x, r, theta), False
        for trial in range(TRIALS):
            held = memory["held"] if self._epsilon else 0.0
            at = self._eliminated(x, r, by_theta, by_x, held) if held else free
            move = None if at is None else self._move(at, x, r, theta)
            if at is not None and move is not None:
                moved = theta + move.delta
                owner.place(moved)
                there, r_there = self._arrived(at, move)
                fall = before - self._objective(there, r_there, moved)
                accepted = fall > 0.0
                if accepted:
                    gain = fall / max(move.foreseen, 1e-300)
                    memory["nodes"], x, r, theta = there, there, r_there, moved
                    if gain < 0.2:
                        memory["damping"] *= SURPRISE
                    elif gain > 0.6 and trial == 0:
                        memory["damping"] *= SUCCESS
                        memory["held"] = held * SUCCESS if held > 1.0 else 0.0
                    break
            owner.place(theta)
            if self._epsilon is None or (at is not None and self._nodes_settle(at, before, theta)):
                memory["damping"] = min(memory["damping"] * FAILURE, LIMIT)
            else:
                memory["held"] = min(max(held * FAILURE, 1.0), LIMIT)
        settled = free is None or self._weigh(free.gram, x, r, theta)
        stuck = max(memory["damping"], memory["held"]) >= LIMIT
        metrics = {
            "train_loss": float(r.square().mean()),
            "noise_estimate": memory["noise"] ** 0.5,
            "damping": memory["damping"],
        }
        return Found(metrics, ended=not accepted and stuck and settled)

    def _residuals(self, stencil: Sequence[Tensor]) -> Tensor:
        """``r``, those of velocities over their weight."""
        found = self._model.residuals(self._chain.windows(*stencil))
        return found / self._weight[: found.shape[1]]

    @torch.no_grad()
    def _residuals_at(self, x: Tensor) -> Tensor:
        return self._residuals(self._chain.stencil(x))

    def _differentiated(self, x: Tensor, parameters: Sequence[Tensor]) -> tuple[Any, ...]:
        """``r``, ``J_θ`` and ``J_x``."""
        stencil = [y.clone().requires_grad_() for y in self._chain.stencil(x)]
        r, by_theta, by_x = parameter_jacobian(
            lambda: self._residuals(stencil), parameters, stencil
        )
        return r, by_theta, tuple(j * self._weight for j in by_x)

    def _eliminated(
        self, x: Tensor, r: Tensor, by_theta: Tensor, by_x: tuple[Tensor, ...], held: float
    ) -> Reduced | None:
        """Eliminate the nodes, damped by ``μ = held``; ``None`` if ``S`` has no factor."""
        weight = 1.0 + held
        target = x + (self._chain.x - x) / weight
        if self._epsilon is None:
            e, factor, white, white_e = r, None, by_theta.flatten(0, 1), r.flatten()
        else:
            e, factor = self._factored(x, r, by_x, target, weight)
            if factor is None:
                return None
            white, white_e = factor.whiten(by_theta), factor.whiten(e).flatten()
        gram, gradient = white.T @ white, white.T @ white_e
        return Reduced(e, by_theta, by_x, factor, target, weight, gram, gradient)

    def _factored(
        self, x: Tensor, r: Tensor, by_x: tuple[Tensor, ...], target: Tensor, weight: float
    ) -> tuple[Tensor, BandFactor | None]:
        """Return ``e`` and the factor of ``S``, if there is one."""
        assert self._epsilon is not None
        e = r + self._chain.apply(by_x, (target - x) / self._weight)
        scaled = tuple(j / weight**0.5 for j in by_x)
        return e, self._chain.factor(scaled, self._epsilon**2)

    def _move(self, at: Reduced, x: Tensor, r: Tensor, theta: Tensor) -> Move | None:
        """The next trial, straight where the way bends too much; ``None`` without a factor."""
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
        self, at: Reduced, x: Tensor, r: Tensor, theta: Tensor, delta: Tensor
    ) -> Float[Tensor, "windows k"]:
        """``½ r''`` along the step, by residuals a tenth of the way."""
        way = self._nodes(at, at.e + at.by_theta @ delta) - x
        linear = at.by_theta @ delta + self._chain.apply(at.by_x, way / self._weight)
        self._owner.place(theta + TENTH * delta)
        there = self._residuals_at(x + TENTH * way)
        return (there - r - TENTH * linear) / TENTH**2

    def _nodes(self, at: Reduced, e: Tensor) -> Float[Tensor, "nodes d"]:
        """``y − J_xᵀ S⁻¹ e``."""
        if at.factor is None:
            held: Tensor = self._memory["nodes"]
            return held
        moved = self._chain.spread(at.by_x, at.factor.solve(e)) / at.weight
        return at.target - self._weight * moved

    def _arrived(self, at: Reduced, move: Move) -> tuple[Tensor, Tensor]:
        """The nodes that go with the parameters in place, and the residuals there: after two steps
        or after the first, which alone is surely downhill."""
        x = self._nodes(at, at.e + at.by_theta @ move.delta + move.bend)
        if at.factor is None:
            return x, self._residuals_at(x)
        r, _, by_x = self._differentiated(x, ())
        e, factor = self._factored(x, r, by_x, at.target, at.weight)
        if factor is None:
            return x, r
        further = self._nodes(at._replace(by_x=by_x, factor=factor), e)
        steps = (x, r), (further, self._residuals_at(further))
        return min(steps, key=lambda step: self._misfit(*step))

    def _nodes_settle(self, at: Reduced, before: float, theta: Tensor) -> bool:
        """Whether the nodes alone find their way."""
        x = self._nodes(at, at.e)
        return self._objective(x, self._residuals_at(x), theta) <= before * (1.0 + 1e-13)

    def _objective(self, x: Tensor, r: Tensor, theta: Tensor) -> float:
        """``σ²`` times what is minimised."""
        precision = self._memory["precision"][self._group]
        return self._misfit(x, r) + self._memory["noise"] * float(precision @ theta.square())

    def _misfit(self, x: Tensor, r: Tensor) -> float:
        """Return ``χ²`` in units of ``σ²``, infinite if it is not a number."""
        if self._epsilon is None:
            misfit = r.square().sum()
        else:
            moved = ((x - self._chain.x) / self._weight).square().sum()
            misfit = moved + r.square().sum() / self._epsilon**2
        return float(misfit.nan_to_num(nan=math.inf, posinf=math.inf))

    def _weigh(self, gram: Tensor, x: Tensor, r: Tensor, theta: Tensor) -> bool:
        """Update noise and priors if the posterior has a factor; return whether they settled."""
        noise, precision = self._memory["noise"], self._memory["precision"]
        found = evidence(gram, noise, precision, theta, self._group, self._moves, self._flat)
        misfit = self._misfit(x, r)
        if found is None or not math.isfinite(misfit):
            return True
        self._memory["precision"], determined = found
        freedom = max(r.numel() - determined, 0.1 * r.numel())
        self._memory["noise"] = max(misfit / freedom, 1e-24)
        return math.isclose(noise, self._memory["noise"], rel_tol=SETTLED) and torch.allclose(
            precision, self._memory["precision"], rtol=SETTLED, atol=0.0
        )
