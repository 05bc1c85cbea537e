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
    gram: Float[Tensor, "parameters parameters"]
    """``J_θᵀ S⁻¹ J_θ``."""
    gradient: Float[Tensor, " parameters"]
    """``J_θᵀ S⁻¹ e``."""


class Smoothing:
    """One step. With ``J_x``, ``J_θ`` the derivatives of the residuals ``r``

        e = r + J_x (y − x)        S = J_x J_xᵀ + ε² I

    eliminate the nodes, ``(J_θᵀ S⁻¹ J_θ + σ² α + λ diag) δ = −J_θᵀ S⁻¹ e − σ² α θ`` moves the
    parameters, and ``x = y − J_xᵀ S⁻¹ (e + J_θ δ)`` puts the nodes back, once more with the
    residuals there. A step that lowers the objective is taken; after some that do not the nodes,
    too, go a part of their way only, for dry friction bends the residuals within a step. ``S`` is
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
        r, at = self._linearise(x)
        objective = before = self._objective(x, r, theta)
        for trial in range(owner.trials):
            delta, foreseen = self._update(at, theta)
            if delta is not None:
                owner.place(theta + delta)
                share = 0.5 ** max(0, trial - 2)  # of the way that the nodes go
                arrived = self._arrived(at, delta, once_more=share == 1.0)
                there = x + share * (arrived - x)
                with torch.no_grad():
                    r_there = self._residuals(self._chain.stencil(there))
                objective = self._objective(there, r_there, theta + delta)
                if objective < before:
                    gain = (before - objective) / max(foreseen, 1e-300)
                    memory["nodes"], x, r, theta = there, there, r_there, theta + delta
                    if gain < 0.2:
                        memory["damping"] *= SURPRISE
                    elif gain > 0.6 and trial == 0:
                        memory["damping"] *= SUCCESS
                    break
            memory["damping"] = min(memory["damping"] * FAILURE, 1e12)
        else:
            owner.place(theta)
        self._update_evidence(at.gram, x, r, theta)
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
        self, x: Tensor, r: Tensor, by_x: Sequence[Tensor]
    ) -> tuple[Tensor, BandFactor | None]:
        """``e`` and the factor of ``S``."""
        if self._epsilon is None:
            return r, None
        e = r + self._chain.apply(by_x, (self._chain.x - x) / self._weight)
        return e, self._chain.factor(by_x, self._epsilon**2)

    def _linearise(self, x: Tensor) -> tuple[Tensor, Linear]:
        r, by_theta, by_x = self._differentiated(x, self._owner.parameters)
        by_theta = by_theta * self._moves
        e, factor = self._eliminated(x, r, by_x)
        white = by_theta.flatten(0, 1) if factor is None else factor.whiten(by_theta)
        white_e = e.flatten() if factor is None else factor.whiten(e).flatten()
        return r, Linear(e, by_theta, by_x, factor, white.T @ white, white.T @ white_e)

    def _update(self, at: Linear, theta: Tensor) -> tuple[Tensor | None, float]:
        """``δ``, and by how much the objective should fall."""
        prior = self._memory["noise"] * self._memory["precision"][self._group]
        slope = (at.gradient + prior * theta) * self._moves
        diagonal = at.gram.diagonal()
        damping = self._memory["damping"] * (diagonal + 1e-6 * diagonal.amax())
        damped = at.gram + torch.diag(prior + damping)
        factor, info = torch.linalg.cholesky_ex(damped)
        if int(info) != 0:
            return None, 0.0
        delta = -torch.cholesky_solve(slope.unsqueeze(-1), factor).squeeze(-1)
        return delta, float(-(slope @ delta) + damping @ delta.square())

    def _nodes(self, at: Linear, e: Tensor) -> Float[Tensor, "nodes d"]:
        """``y − J_xᵀ S⁻¹ e``."""
        if at.factor is None:
            held: Tensor = self._memory["nodes"]
            return held
        return self._chain.x - self._weight * self._chain.spread(at.by_x, at.factor.solve(e))

    def _arrived(self, at: Linear, delta: Tensor, *, once_more: bool) -> Tensor:
        """The nodes that go with the parameters in place; only the first of two steps is surely
        one downhill."""
        x = self._nodes(at, at.e + at.by_theta @ delta)
        if at.factor is not None and once_more:
            r, _, by_x = self._differentiated(x, ())
            try:
                e, factor = self._eliminated(x, r, by_x)
                x = self._nodes(at._replace(by_x=by_x, factor=factor), e)
            except ArithmeticError:  # too far: the objective will say so
                pass
        return x

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
