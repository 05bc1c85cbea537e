"""From network outputs to inertia and potential (thesis section 4.1.1).

The outputs ``o`` are, in this order, the diagonal of a Cholesky factor before its softplus (n),
its strictly lower part row by row (n(n−1)/2), and the potential V (1):

    H = L Lᵀ + ε I,   ℒ = ½ |y|² + ½ ε |v|² − V,   y = Lᵀ v.

The closed forms below are those of ``ℒ`` as a function of ``o`` and ``v``.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn

EPSILON = 1e-9
"""``ε`` in ``H = L Lᵀ + ε I``."""


class HeadPoint(NamedTuple):
    """``ℒ(o, v)`` at one batch of outputs and velocities."""

    v: Float[Tensor, "batch n"]
    factor: Float[Tensor, "batch n n"]
    """``L``."""
    slope: Float[Tensor, "batch n"]
    """``σ(o)``, derivative of the softplus on the diagonal."""
    y: Float[Tensor, "batch n"]
    """``y = Lᵀ v``."""


class CholeskyHead(nn.Module):
    """The map ``o → (L, V)`` for ``n`` coordinates, and the derivatives of ``ℒ`` through it."""

    place: Tensor
    lower_row: Tensor
    lower_column: Tensor

    def __init__(self, n: int) -> None:
        super().__init__()
        self.n = n
        row, column = torch.tril_indices(n, n, offset=-1)
        place = torch.full((n, n), n + len(row))  # entries above the diagonal: the zero at the end
        place[range(n), range(n)] = torch.arange(n)
        place[row, column] = n + torch.arange(len(row))
        for name, index in (
            ("place", place.flatten()),
            ("lower_row", row),
            ("lower_column", column),
        ):
            self.register_buffer(name, index, persistent=False)

    @property
    def outputs(self) -> int:
        """Number of network outputs."""
        return self.n * (self.n + 1) // 2 + 1

    def factor(self, outputs: Float[Tensor, "*batch outputs"]) -> Float[Tensor, "*batch n n"]:
        """``L``, lower triangular with a positive diagonal."""
        diagonal = nn.functional.softplus(outputs[..., : self.n])
        return self._fill(diagonal, outputs)

    def factor_tangent(
        self,
        slope: Float[Tensor, "*#batch n"],
        rates: Float[Tensor, "*batch outputs"],
    ) -> Float[Tensor, "*batch n n"]:
        """``L'`` when the outputs change at ``rates``; linear in them."""
        return self._fill(slope * rates[..., : self.n], rates)

    def slope(self, outputs: Float[Tensor, "*batch outputs"]) -> Float[Tensor, "*batch n"]:
        """``σ(o)`` of the diagonal."""
        return torch.sigmoid(outputs[..., : self.n])

    def mass(self, factor: Float[Tensor, "*batch n n"]) -> Float[Tensor, "*batch n n"]:
        """``H = L Lᵀ + ε I``."""
        identity = torch.eye(self.n, dtype=factor.dtype, device=factor.device)
        return factor @ factor.mT + EPSILON * identity

    def point(
        self, outputs: Float[Tensor, "batch outputs"], v: Float[Tensor, "batch n"]
    ) -> HeadPoint:
        """``ℒ`` at ``(o, v)``."""
        factor = self.factor(outputs)
        return HeadPoint(v, factor, self.slope(outputs), _row(v, factor))

    def momentum(self, at: HeadPoint) -> Float[Tensor, "batch n"]:
        """``∂ℒ/∂v = L y + ε v``."""
        return _apply(at.factor, at.y) + EPSILON * at.v

    def cotangent(self, at: HeadPoint) -> Float[Tensor, "batch outputs"]:
        """``∂ℒ/∂o``: ``vᵢ yⱼ`` for ``L_ij``, ``−1`` for ``V``."""
        minus_one = -torch.ones_like(at.v[:, :1])
        return self._collect(at, at.v, at.y, last=minus_one)

    def tangent(
        self, at: HeadPoint, rates: Float[Tensor, "batch outputs"], b: Float[Tensor, "batch n"]
    ) -> tuple[Tensor, Tensor]:
        """``L'`` and ``y' = L'ᵀ v + Lᵀ b`` when ``o`` changes at ``rates`` and ``v`` at ``b``."""
        factor_rate = self.factor_tangent(at.slope, rates)
        return factor_rate, _row(at.v, factor_rate) + _row(b, at.factor)

    def directional_cotangents(
        self,
        at: HeadPoint,
        rates: Float[Tensor, "batch outputs"],
        b: Float[Tensor, "batch n"],
        mass_cotangent: Float[Tensor, "batch n n"] | None,
    ) -> tuple[Float[Tensor, "batch outputs"], Float[Tensor, "batch n"]]:
        """Gradients in ``o`` and ``v`` of ``φ = ∂ℒ/∂o · o' + ∂ℒ/∂v · b + ⟨M, H⟩``, ``o'`` fixed.

        ``φ = y · y' − V' + ε v · b + ⟨M, L Lᵀ⟩`` with ``y'`` as in ``tangent``.
        """
        factor_rate, y_rate = self.tangent(at, rates, b)
        outputs = self._collect(at, at.v, y_rate, last=torch.zeros_like(at.v[:, :1]))
        outputs = outputs + self._collect(at, b, at.y, last=torch.zeros_like(b[:, :1]))
        # The second derivative of the softplus, on the diagonal.
        bend = at.v * at.y * at.slope * (1.0 - at.slope) * rates[:, : self.n]
        if mass_cotangent is not None:
            # ∂⟨M, L Lᵀ⟩/∂L = (M + Mᵀ) L
            dense = (mass_cotangent + mass_cotangent.mT) @ at.factor
            bend = bend + at.slope * dense.diagonal(dim1=-2, dim2=-1)
            lower = dense[:, self.lower_row, self.lower_column]
            outputs[:, self.n : -1] += lower
        outputs[:, : self.n] += bend
        velocity = _apply(at.factor, y_rate) + _apply(factor_rate, at.y) + EPSILON * b
        return outputs, velocity

    def _fill(self, diagonal: Tensor, outputs: Tensor) -> Tensor:
        lower = outputs[..., self.n : -1]
        zero = torch.zeros_like(diagonal[..., :1])
        flat = torch.cat((diagonal, lower, zero), dim=-1)[..., self.place]
        return flat.unflatten(-1, (self.n, self.n))

    def _collect(self, at: HeadPoint, left: Tensor, right: Tensor, *, last: Tensor) -> Tensor:
        """``leftᵢ rightⱼ`` for each entry of ``L``, through the softplus on the diagonal."""
        diagonal = left * right * at.slope
        lower = left[:, self.lower_row] * right[:, self.lower_column]
        return torch.cat((diagonal, lower, last), dim=1)


def _row(vector: Tensor, matrix: Tensor) -> Tensor:
    """``Aᵀ x``."""
    return (vector.unsqueeze(-2) @ matrix).squeeze(-2)


def _apply(matrix: Tensor, vector: Tensor) -> Tensor:
    """``A x``."""
    return (matrix @ vector.unsqueeze(-1)).squeeze(-1)
