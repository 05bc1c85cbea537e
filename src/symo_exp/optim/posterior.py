"""Gaussian posterior of parameters that were estimated by least squares along trajectories.

Two methods estimate parameters from trajectories of noisy nodes ``y``: Levenberg-Marquardt
minimises ``Σ|r(y; θ)|²``, total least squares ``Σ|x − y|²/σ² + Σ|r(x; θ)|²/(ε σ)²``, which around
its solution is ``eᵀ S_ε⁻¹ e`` with ``e = r + J_x (y − x)`` and ``S_ε = J_x J_xᵀ + ε² I``. The noise
of the nodes and of the model make the covariance of ``e``

    σ̂² Ŝ,   Ŝ = J_x J_xᵀ + ε̂² I,

with ``σ̂`` and ``ε̂`` by maximum likelihood, whatever ``ε`` the estimate was made with. With the
weights ``W = S_ε⁻¹``, or ``W = I``, its covariance is (Huber 1967; White 1982)

    (JᵀWJ + P)⁻¹ (σ̂² JᵀW Ŝ W J + σ̂² P) (JᵀWJ + P)⁻¹,   P = σ̂² diag(α),

the prior precisions ``α`` being those of total least squares.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from jaxtyping import Float
from scipy.optimize import minimize_scalar
from torch import Tensor

from symo_exp.mechanics.types import Trajectory
from symo_exp.optim.banded import Chain, WindowResiduals

ITERATIONS = 15
"""Steps that put the nodes where the model has them, at most."""
LOW, HIGH = 1e-3, 1e3
"""Range of ``ε̂``."""
SINGULAR = 1e-8
"""Singular values below this share of the largest belong to directions without information."""
TINY = 1e-13
"""Size of a parameter's derivatives, relative to the largest, below which they are rounding."""
LEAST = 1e-12
"""Share of the information that counts as none."""
LARGEST = 1.0
"""Standard deviation of a direction in parameters, beyond which samples do not go."""


class Posterior(NamedTuple):
    """A Gaussian posterior of a vector of parameters, direction by direction.

    Attributes:
        mean: The parameters.
        directions: Columns ``d_i``, so that the covariance is ``Σ d_i d_iᵀ``.
        free: Orthonormal columns along which the data have no information, though a prior may.
        noise: ``σ̂``, standard deviation of the nodes over the units of the coordinates.
        model_noise: ``ε̂ σ̂``, that of the residuals.
        residuals: Number of residuals.
        by_data: Share of the information about each parameter that is not the prior's; ``None``
            in runs of earlier versions.
    """

    mean: Float[Tensor, " p"]
    directions: Float[Tensor, "p k"]
    free: Float[Tensor, "p f"]
    noise: float
    model_noise: float
    residuals: int
    by_data: Float[Tensor, " p"] | None = None

    def without_prior(self) -> Float[Tensor, "p k"]:
        """Return the directions, each parameter as uncertain as without a prior of its own.

        Taking the prior of precision ``α`` out of a variance ``s²`` leaves ``s² / (1 − α s²)``.
        """
        if self.by_data is None:
            return self.directions
        return self.directions / self.by_data.clamp_min(LEAST).sqrt().unsqueeze(1)

    def informed(self) -> Float[Tensor, "p k"]:
        """Return the directions without their parts that data have no information about.

        Those do not change predictions to first order, and beyond it a prior would.
        """
        return self.directions - self.free @ (self.free.T @ self.directions)

    def samples(self, count: int, generator: torch.Generator) -> Float[Tensor, "count p"]:
        """Draw parameters; free directions keep their values, and no other goes beyond 1."""
        drawn = torch.randn(
            count, self.directions.shape[1], dtype=torch.float64, generator=generator
        )
        directions = self.informed()
        size = directions.norm(dim=0)
        bounded = directions * (LARGEST / size.clamp_min(LARGEST))
        return self.mean + drawn @ bounded.T


def posterior(
    residuals: WindowResiduals,
    parameters: Sequence[Tensor],
    trajectories: Sequence[Trajectory],
    *,
    velocities: bool = False,
    epsilon: float | None = None,
    velocity_weight: float = 1.0,
    input_weight: float = 0.0,
    sizes: Float[Tensor, " n"] | None = None,
    precision: Float[Tensor, " p"] | None = None,
) -> Posterior | None:
    """Return the posterior of parameters at their estimate.

    ``None`` where residuals or their derivatives are not finite.

    Args:
        residuals: Residuals of a batch of windows, those that were made small.
        parameters: The parameters, float64, at their estimate.
        trajectories: The trajectories of the estimate.
        velocities: Whether residuals read velocities.
        epsilon: ``ε`` of total least squares; ``None`` for Levenberg-Marquardt.
        velocity_weight: Noise of velocities over that of configurations [1/s].
        input_weight: Noise of inputs over that of configurations; 0: inputs are exact.
        sizes: Unit of each coordinate, to which its noise is relative [m]; 1 if left out.
        precision: ``α`` of each parameter; none where it is zero.
    """
    chain = Chain.of(trajectories, velocities=velocities, inputs=input_weight > 0)
    units = torch.ones(chain.n) if sizes is None else sizes
    weight = chain.weights(units, velocity_weight, input_weight)
    x = chain.x if epsilon is None else _settled(residuals, chain, weight, epsilon)
    r, by_theta, by_x = chain.linearised(residuals, x, weight, parameters)
    if not all(bool(one.isfinite().all()) for one in (r, by_theta, *by_x)):
        return None
    e = r + chain.apply(by_x, (chain.x - x) / weight)
    count, size = e.numel(), by_theta.shape[2]
    own, variance = _likeliest(chain, by_x, e)
    variance *= count / max(count - size, 0.1 * count)
    alpha = torch.zeros(size, dtype=torch.float64) if precision is None else precision
    factor = None if epsilon is None else chain.factor(by_x, epsilon**2)
    # the sandwich, along the singular vectors of the weighted derivatives
    flat = by_theta.flatten(0, 1)
    white = flat if factor is None else factor.whiten(by_theta)
    prior = torch.diag((variance * alpha).sqrt())
    basis, _ = _directions(torch.cat((white, prior)))
    _, free = _directions(white)  # whatever the prior says
    moved = (flat @ basis).T.unflatten(1, by_theta.shape[:2])
    pulled = moved if factor is None else torch.stack([factor.solve(column) for column in moved])
    spread = torch.stack([chain.spread(by_x, column).flatten() for column in pulled])
    columns = pulled.flatten(1)
    meat = variance * (spread @ spread.T + own * columns @ columns.T)
    meat = meat + variance**2 * basis.T @ (alpha.unsqueeze(1) * basis)
    stretch, turn = torch.linalg.eigh(0.5 * (meat + meat.T))
    directions = basis @ turn * stretch.clamp_min(0.0).sqrt()
    by_data = (1.0 - variance * alpha * basis.square().sum(1)).clamp(0.0, 1.0)
    noise = variance**0.5
    mean = torch.cat([p.detach().flatten() for p in parameters])
    return Posterior(mean, directions, free, noise, own**0.5 * noise, len(flat), by_data)


def _settled(
    residuals: WindowResiduals, chain: Chain, weight: Float[Tensor, " d"], epsilon: float
) -> Float[Tensor, "nodes d"]:
    """Return the nodes that minimise ``|x − y|² + |r|²/ε²``, by Gauss-Newton steps."""
    x, best, least = chain.x, chain.x, torch.inf
    for _ in range(ITERATIONS):
        r, _, by_x = chain.linearised(residuals, x, weight)
        moved = ((x - chain.x) / weight).square().sum()
        cost = float(moved + r.square().sum() / epsilon**2)
        if not cost < least:
            x = 0.5 * (x + best)
            if ((x - best) / weight).abs().max() < 1e-9 * (1.0 + (best / weight).abs().max()):
                break
            continue
        settled = cost >= least * (1.0 - 1e-9)
        best, least = x, cost
        if settled:
            break
        e = r + chain.apply(by_x, (chain.x - x) / weight)
        factor = chain.factor(by_x, epsilon**2)
        if factor is None:
            break
        pull = factor.solve(e)
        x = chain.x - weight * chain.spread(by_x, pull)
    return best


def _likeliest(chain: Chain, by_x: Sequence[Tensor], e: Tensor) -> tuple[float, float]:
    """Return ``ε̂²``, ``σ̂²`` of the largest likelihood of ``e``, by Brent's method in ``log ε̂``."""

    def of(exponent: float) -> tuple[float, float, float]:
        own = 10.0 ** (2.0 * exponent)
        factor = chain.factor(by_x, own)
        if factor is None:
            return torch.inf, own, 1.0
        white = factor.whiten(e)
        variance = max(float(white.square().sum()) / e.numel(), 1e-300)
        likelihood = factor.log_determinant + e.numel() * math.log(variance)
        return 0.5 * likelihood, own, variance

    low, high = math.log10(LOW), math.log10(HIGH)
    grid = [low + (high - low) * i / 12 for i in range(13)]
    best = min(grid, key=lambda a: of(a)[0])
    found = minimize_scalar(
        lambda exponent: of(exponent)[0],
        bounds=(best - 0.5, best + 0.5), method="bounded", options={"xatol": 1e-3},
    )  # fmt: skip
    _, own, variance = of(float(found.x))
    return own, variance


def _directions(rows: Float[Tensor, "rows p"]) -> tuple[Tensor, Tensor]:
    """Return directions with independent effects of size one on the rows, and those without any.

    The latter are orthonormal.
    """
    upper = torch.linalg.qr(rows, mode="r")[1]
    scale = _sizes(upper)
    _, values, right = torch.linalg.svd(upper / scale)
    there = values > SINGULAR * values.amax().clamp_min(1e-300)
    basis = right[: len(values)][there].T / values[there] / scale.unsqueeze(1)
    free = right[int(there.sum()) :].T / scale.unsqueeze(1)
    return basis, torch.linalg.qr(free)[0] if free.shape[1] else free


def _sizes(columns: Float[Tensor, "rows p"]) -> Float[Tensor, " p"]:
    """Return the norms of the columns; of those that are rounding the largest, or 1."""
    size = columns.norm(dim=0)
    largest = size.amax()
    return torch.where(size > TINY * largest, size, largest if largest > 0.0 else 1.0)
