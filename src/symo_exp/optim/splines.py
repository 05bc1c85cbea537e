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

import numpy as np
import torch
from jaxtyping import Float
from scipy.linalg import lapack
from scipy.optimize import minimize_scalar
from torch import Tensor

from symo_exp.mechanics.space import space_of
from symo_exp.mechanics.types import Trajectory

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
    columns = [_Spline(c).best() for c in y.T.numpy()]
    return torch.stack([torch.as_tensor(c) for c in columns], dim=1)


class _Spline:
    """Smoothing splines of one column of values at unit spacing."""

    def __init__(self, y: np.ndarray) -> None:
        self._y, self._second = y, np.diff(y, 2)
        m = len(self._second)
        bending = np.array([1.0, -4.0, 6.0])  # upper bands of QᵀQ and of R, the diagonal last
        self._bending = np.repeat(bending[:, None], m, axis=1)
        self._r = np.repeat(np.array([0.0, 1 / 6, 2 / 3])[:, None], m, axis=1)

    def best(self) -> np.ndarray:
        """Return the values of the spline with the least error in cross-validation."""
        bounds = math.log(LEAST), math.log(MOST * len(self._y))
        found = minimize_scalar(
            self._score, bounds=bounds, method="bounded", options={"xatol": APART}
        )
        residuals, _ = self._fit(found.x)
        return self._y - residuals

    def _score(self, log_lambda: float) -> float:
        """Return the logarithm of ``Σ (y − f)² / (n − trace)²``."""
        residuals, _ = self._fit(log_lambda)
        above, below = (self._fit(log_lambda + sign * APART / 2)[1] for sign in (1, -1))
        size = float(np.linalg.norm(residuals))
        return 2.0 * math.log(max(size, 1e-300) / ((above - below) / APART))

    def _fit(self, log_lambda: float) -> tuple[np.ndarray, float]:
        """Return ``λ Q γ`` and the logarithm of the determinant of ``R + λ QᵀQ``."""
        weight = math.exp(log_lambda)
        factor, _ = lapack.dpbtrf(self._r + weight * self._bending)
        gamma, _ = lapack.dpbtrs(factor, self._second)
        residuals = weight * np.diff(np.pad(gamma, 2), 2)
        return residuals, 2.0 * float(np.log(factor[-1]).sum())
