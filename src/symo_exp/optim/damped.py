"""Residuals linearised at the present parameters, and damped steps that minimise them."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor


class DampedSystem:
    """``r + J δ``, both divided by the square root of the number of residuals.

    Args:
        residuals: ``r``.
        pieces: Rows of ``J``, in order.
    """

    def __init__(
        self,
        residuals: Float[Tensor, " equations"],
        pieces: Sequence[Float[Tensor, "rows parameters"]],
    ) -> None:
        self.scale = 1.0 / math.sqrt(len(residuals))
        self.r = self.scale * residuals
        self._pieces = pieces
        self._wide = pieces[0].shape[1] > len(residuals)
        self._gram = self._outer() if self._wide else self._inner()
        """``J Jᵀ`` or ``Jᵀ J``, its lower triangle."""
        self._size = float(torch.stack([j.square().sum(0) for j in pieces]).sum(0).amax())
        self._size *= self.scale**2

    def factor(self, damping: float) -> Tensor | None:
        """Return the Cholesky factor of ``JᵀJ + λ s I``, or of ``J Jᵀ + λ s I`` for wide ``J``.

        ``s`` is the largest entry of the diagonal of ``JᵀJ``. The factor is ``None`` if the matrix
        is not positive definite in floating point.
        """
        damped = self._gram.clone()
        damped.diagonal().add_(damping * self._size)
        factor, info = torch.linalg.cholesky_ex(damped)
        return factor if int(info) == 0 else None

    def towards_zero(
        self, factor: Tensor, residuals: Float[Tensor, " equations"]
    ) -> Float[Tensor, " parameters"]:
        """Return the damped step ``−(JᵀJ + λ s I)⁻¹ Jᵀ r`` for residuals.

        A wide ``J`` has it as ``−Jᵀ (J Jᵀ + λ s I)⁻¹ r``.
        """
        if self._wide:
            return -self._transposed(solved(factor, residuals))
        return -solved(factor, self._transposed(residuals))

    def change(self, step: Float[Tensor, " parameters"]) -> Float[Tensor, " equations"]:
        """Return ``J δ``."""
        return self.scale * torch.cat([j @ step for j in self._pieces])

    def _transposed(self, residuals: Tensor) -> Float[Tensor, " parameters"]:
        """Return ``Jᵀ r``."""
        parts = residuals.split([len(j) for j in self._pieces])
        sums = [r @ j for r, j in zip(parts, self._pieces, strict=True)]
        return self.scale * torch.stack(sums).sum(0)

    def _outer(self) -> Float[Tensor, "equations equations"]:
        j = self.scale * torch.cat([*self._pieces])
        return j @ j.T

    def _inner(self) -> Float[Tensor, "parameters parameters"]:
        """Return the lower triangle, in blocks: about half of the work of the full matrix."""
        size = self._pieces[0].shape[1]
        gram, block = self.r.new_zeros(size, size), max(128, -(-size // 8))
        for j in self._pieces:
            for start in range(0, size, block):
                end = min(start + block, size)
                gram[start:, start:end].addmm_(j[:, start:].T, j[:, start:end])
        return gram.mul_(self.scale**2)


def solved(factor: Float[Tensor, "n n"], right: Float[Tensor, " n"]) -> Float[Tensor, " n"]:
    """Return ``(L Lᵀ)⁻¹ b``, given the Cholesky factor ``L``."""
    return torch.cholesky_solve(right.unsqueeze(-1), factor).squeeze(-1)
