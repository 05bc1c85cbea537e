"""Smoothing splines through measured trajectories, the start of total least squares.

The natural cubic spline ``f`` at unit spacing that minimises ``Σ (y − f)² + λ ∫ f''²`` has the
values ``f = y − λ Q γ`` with ``(R + λ QᵀQ) γ = Qᵀ y``: ``Qᵀ`` are second differences and ``R`` is
tridiagonal. The trace of the map from ``y`` to ``f``, ``n − d log|R + λ QᵀQ| / d log λ``, follows
from Cholesky factors, so that everything takes time linear in ``n``.

Source: C. H. Reinsch, Smoothing by spline functions, Numerische Mathematik 10, 1967.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from jaxtyping import Float
from scipy.optimize import minimize_scalar
from torch import Tensor

from symo_exp.mechanics.space import space_of
from symo_exp.mechanics.types import Trajectory
from symo_exp.optim.banded import BandFactor

LEAST, MOST = 1e-8, 1e2
"""Bounds of ``λ``: interpolation, and as many times the nodes."""
APART = 1e-2
"""Distance in ``log λ`` of the factors whose determinants give the derivative; ``λ`` is found as
accurately."""


def smoothed(trajectories: Sequence[Trajectory], velocities: bool) -> Float[Tensor, "nodes d"]:
    """Return every coordinate smoothed by a spline, by generalised cross-validation.

    Rotations are smoothed by their entries; the result has the coordinates of the nearest rotation
    in the chart at the measured one.
    """
    return torch.cat([_smoothed(t, velocities) for t in trajectories])


def _smoothed(trajectory: Trajectory, velocities: bool) -> Tensor:
    q, v = trajectory.q.double(), trajectory.v.double()
    space = space_of(q, v)
    y = _splines(torch.cat((q, v), dim=1) if velocities else q)
    near = space.normalised(y[:, : q.shape[1]])
    return torch.cat((space.chart(q, near), y[:, q.shape[1] :]), dim=1)


def _splines(y: Tensor) -> Tensor:
    if len(y) < 6:  # too few to tell noise from motion
        return y.clone()
    return torch.stack([_spline(c) for c in y.T], dim=1)


def _spline(y: Float[Tensor, " n"]) -> Float[Tensor, " n"]:
    """Return the values of the spline with the least error in cross-validation."""
    second = y.diff(n=2)

    def factor(log_lambda: float) -> BandFactor:
        weight, m = math.exp(log_lambda), len(second)
        bands = 2 / 3 + 6 * weight, 1 / 6 - 4 * weight, weight  # of R + λ QᵀQ
        blocks = [torch.full((m - k, 1, 1), x, dtype=y.dtype) for k, x in enumerate(bands)]
        found = BandFactor.of(blocks, 0.0)
        assert found is not None
        return found

    def residuals(log_lambda: float) -> Tensor:
        gamma = factor(log_lambda).solve(second.unsqueeze(1)).squeeze(1)
        return math.exp(log_lambda) * torch.nn.functional.pad(gamma, (2, 2)).diff(n=2)

    def score(log_lambda: float) -> float:
        """Return the logarithm of ``Σ (y − f)² / (n − trace)²``."""
        above, below = (factor(log_lambda + x).log_determinant for x in (APART / 2, -APART / 2))
        size = float(residuals(log_lambda).norm())
        return 2.0 * math.log(max(size, 1e-300) / ((above - below) / APART))

    bounds = math.log(LEAST), math.log(MOST * len(y))
    found = minimize_scalar(score, bounds=bounds, method="bounded", options={"xatol": APART})
    return y - residuals(found.x)
