"""Residuals around the present parameters, and damped steps that make them small."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

SMALLEST = 1e-6
"""A parameter is damped by at least so much of the largest entry of ``diag(JᵀJ)``."""


class Linearised:
    """``r + J δ``, with steps in units of ``D^{−½}``: ``δ = D^{−½} x``, ``K = J D^{−½}``."""

    def __init__(
        self,
        residuals: Float[Tensor, " equations"],
        pieces: Sequence[Float[Tensor, "rows parameters"]],
    ) -> None:
        self.scale = 1.0 / math.sqrt(len(residuals))
        self.r = self.scale * residuals
        self._pieces = pieces
        diagonal = torch.stack([j.square().sum(0) for j in pieces]).sum(0)
        # a model that is at rest everywhere has no J at all
        largest = diagonal.amax().clamp(min=torch.finfo(diagonal.dtype).tiny)
        self.unit = (diagonal + SMALLEST * largest).rsqrt() / self.scale
        """The diagonal of ``D^{−½}``."""
        self._wide = len(self.unit) > len(self.r)
        self._gram = self._outer() if self._wide else self._inner()
        """``K Kᵀ`` or ``Kᵀ K``, its lower triangle."""

    def factor(self, damping: float) -> Tensor | None:
        """Of the damped system; ``None`` where it is not positive definite in floating point."""
        damped = self._gram.clone()
        damped.diagonal().add_(damping)
        factor, info = torch.linalg.cholesky_ex(damped)
        return factor if int(info) == 0 else None

    def towards_zero(
        self, factor: Tensor, residuals: Float[Tensor, " equations"]
    ) -> Float[Tensor, " parameters"]:
        """The damped step ``x`` that makes such residuals small, ``−(Kᵀ K + λ I)⁻¹ Kᵀ r`` or
        ``−Kᵀ (K Kᵀ + λ I)⁻¹ r``."""
        if self._wide:
            return -self._transposed(_solve(factor, residuals))
        return -_solve(factor, self._transposed(residuals))

    def change(self, x: Float[Tensor, " parameters"]) -> Float[Tensor, " equations"]:
        """``K x``."""
        step = self.scale * self.unit * x
        return torch.cat([j @ step for j in self._pieces])

    def _transposed(self, residuals: Tensor) -> Float[Tensor, " parameters"]:
        """``Kᵀ r``."""
        parts = residuals.split([len(j) for j in self._pieces])
        sums = torch.stack([r @ j for r, j in zip(parts, self._pieces, strict=True)])
        return self.scale * self.unit * sums.sum(0)

    def _outer(self) -> Float[Tensor, "equations equations"]:
        k = torch.cat([*self._pieces]) * (self.scale * self.unit)
        return k @ k.T

    def _inner(self) -> Float[Tensor, "parameters parameters"]:
        """The lower triangle, in blocks: about half of the work of all of it."""
        size = len(self.unit)
        gram, block = self.r.new_zeros(size, size), max(128, -(-size // 8))
        for j in self._pieces:
            for start in range(0, size, block):
                end = min(start + block, size)
                gram[start:, start:end].addmm_(j[:, start:].T, j[:, start:end])
        unit = self.scale * self.unit
        return gram.mul_(unit).mul_(unit.unsqueeze(-1))


def _solve(factor: Tensor, right: Tensor) -> Tensor:
    return torch.cholesky_solve(right.unsqueeze(-1), factor).squeeze(-1)
