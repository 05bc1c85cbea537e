"""From network outputs to inertia and potential (thesis section 4.1.1).

The outputs ``o`` are, in this order, the diagonal of a Cholesky factor before its softplus (n),
its strictly lower part row by row (n(n−1)/2), and the potential V (1):

    H = L Lᵀ + ε I,   ℒ = ½ |y|² + ½ ε |v|² − V,   y = Lᵀ v.

Alternatively ``L`` (n, 3n) has ``2n`` unrestricted columns and a diagonal, row by row: the kinetic
energy is a sum of squared speeds ``y``, each linear in the velocities, as that of rigid bodies.

The closed forms below are those of ``ℒ`` as a function of ``o`` and ``v``.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn

from symo_exp.mechanics.lagrangian import matvec, vecmat

EPSILON = 1e-9
"""``ε`` in ``H = L Lᵀ + ε I`` over the inertia at the start of training."""


class HeadPoint(NamedTuple):
    """``ℒ(o, v)`` at one batch of outputs and velocities."""

    v: Float[Tensor, "batch n"]
    factor: Float[Tensor, "batch n r"]
    """``L``."""
    slope: Float[Tensor, "batch soft"]
    """``σ(o)``, derivative of the softplus on the diagonal."""
    y: Float[Tensor, "batch r"]
    """``y = Lᵀ v``."""
    diagonal: Float[Tensor, "batch soft"]
    """``∂ℒ/∂o`` of the diagonal: ``v y σ(o)``."""


class FactorHead(nn.Module):
    """The map ``o → (L, V)`` for ``n`` coordinates, and the derivatives of ``ℒ`` through it.

    Args:
        n: Number of coordinates.
        squares: Whether the kinetic energy is a sum of squared speeds; else ``L`` is a Cholesky
            factor.
        inertia: Inertia at the start of training, to which ``ε`` is relative: that of a light
            machine may be smaller than any fixed number.
    """

    place: Tensor
    lower_row: Tensor
    lower_column: Tensor

    def __init__(self, n: int, *, squares: bool = False, inertia: float = 1.0) -> None:
        super().__init__()
        self.epsilon = EPSILON * inertia
        self.n = n
        self.soft = 0 if squares else n
        """Number of outputs, the first ones, that are a diagonal before its softplus."""
        own, full = torch.eye(n), torch.ones(n, n)
        filled = torch.cat((full, full, own), dim=1) if squares else full.tril(-1)
        row, column = filled.nonzero(as_tuple=True)
        place = torch.full(filled.shape, self.soft + len(row))  # of no output: the zero at the end
        place[range(self.soft), range(self.soft)] = torch.arange(self.soft)
        place[row, column] = self.soft + torch.arange(len(row))
        for name, index in (
            ("place", place.flatten()),
            ("lower_row", row),
            ("lower_column", column),
        ):
            self.register_buffer(name, index, persistent=False)

    @property
    def outputs(self) -> int:
        """Number of network outputs."""
        return self.soft + len(self.lower_row) + 1

    def outputs_of(self, diagonal: float) -> Float[Tensor, " outputs"]:
        """Return the outputs of ``L = diagonal · I`` and ``V = 0``."""
        outputs = torch.zeros(self.outputs)
        own = self.place.view(self.n, -1).diagonal()
        outputs[own] = _inverse_softplus(diagonal) if self.soft else diagonal
        return outputs

    def scales_of(self, diagonal: float) -> Float[Tensor, " outputs"]:
        """Return the sizes of small changes of the outputs that matter as much as at ``L = I``."""
        scales = torch.full((self.outputs,), diagonal)
        scales[: self.soft] *= math.expm1(-1.0) / math.expm1(-diagonal)  # slopes of the softplus
        scales[-1] = diagonal**2
        return scales

    def factor(self, outputs: Float[Tensor, "*batch outputs"]) -> Float[Tensor, "*batch n r"]:
        """Return ``L``."""
        diagonal = nn.functional.softplus(outputs[..., : self.soft])
        return self._fill(diagonal, outputs)

    def factor_tangent(
        self,
        slope: Float[Tensor, "*#batch soft"],
        rates: Float[Tensor, "*batch outputs"],
    ) -> Float[Tensor, "*batch n r"]:
        """Return ``L'`` when the outputs change at ``rates``; linear in them."""
        return self._fill(slope * rates[..., : self.soft], rates)

    def slope(self, outputs: Float[Tensor, "*batch outputs"]) -> Float[Tensor, "*batch soft"]:
        """Return ``σ(o)`` of the diagonal."""
        return torch.sigmoid(outputs[..., : self.soft])

    def mass(self, factor: Float[Tensor, "*batch n r"]) -> Float[Tensor, "*batch n n"]:
        """Return ``H = L Lᵀ + ε I``."""
        identity = torch.eye(self.n, dtype=factor.dtype, device=factor.device)
        return factor @ factor.mT + self.epsilon * identity

    def point(
        self, outputs: Float[Tensor, "batch outputs"], v: Float[Tensor, "batch n"]
    ) -> HeadPoint:
        """Return ``ℒ`` at ``(o, v)``."""
        factor, slope = self.factor(outputs), self.slope(outputs)
        y = vecmat(v, factor)
        return HeadPoint(v, factor, slope, y, self._own(v, y) * slope)

    def momentum(self, at: HeadPoint) -> Float[Tensor, "batch n"]:
        """Return ``∂ℒ/∂v = L y + ε v``."""
        return matvec(at.factor, at.y) + self.epsilon * at.v

    def cotangent(self, at: HeadPoint) -> Float[Tensor, "batch outputs"]:
        """Return ``∂ℒ/∂o``: ``vᵢ yⱼ`` for ``L_ij``, ``−1`` for ``V``."""
        lower = self._entries(at.v, at.y)
        return torch.cat((at.diagonal, lower, -torch.ones_like(at.v[:, :1])), dim=1)

    def directional_cotangents(
        self,
        at: HeadPoint,
        rates: Float[Tensor, "batch outputs"],
        b: Float[Tensor, "batch n"],
    ) -> tuple[Float[Tensor, "batch outputs"], Float[Tensor, "batch n"]]:
        """Return the gradients in ``o``, ``v`` of ``φ = ∂ℒ/∂o · o' + ∂ℒ/∂v · b`` with ``o'`` fixed.

        ``φ = y · y' − V' + ε v · b`` with ``y' = L'ᵀ v + Lᵀ b``.
        """
        factor_rate = self.factor_tangent(at.slope, rates)
        y_rate = vecmat(at.v, factor_rate) + vecmat(b, at.factor)
        # The last factor of the diagonal is the second derivative of the softplus.
        bend = at.diagonal * (1.0 - at.slope) * rates[:, : self.soft]
        diagonal = (self._own(at.v, y_rate) + self._own(b, at.y)) * at.slope + bend
        lower = self._entries(at.v, y_rate) + self._entries(b, at.y)
        outputs = torch.cat((diagonal, lower, torch.zeros_like(at.v[:, :1])), dim=1)
        velocity = matvec(at.factor, y_rate) + matvec(factor_rate, at.y) + self.epsilon * b
        return outputs, velocity

    def curvature(
        self, at: HeadPoint, rates: Float[Tensor, "batch k outputs"]
    ) -> tuple[Float[Tensor, "batch k k"], Float[Tensor, "batch n k"]]:
        """Return ``o_iᵀ (∂²ℒ/∂o²) o_j`` and ``∂ℒ_v/∂o · o_j`` for ``k`` directions ``o_i``.

        With ``y_i = L_iᵀ v`` the first is ``y_i · y_j`` and a term of the softplus, the second
        ``L_j y + L y_j``.
        """
        factors = self.factor_tangent(at.slope.unsqueeze(1), rates)  # L_i: (B, k, n, n)
        ys = vecmat(at.v.unsqueeze(1), factors)
        bend = at.diagonal * (1.0 - at.slope)
        diagonal = rates[..., : self.soft]
        second = ys @ ys.mT + (diagonal * bend.unsqueeze(1)) @ diagonal.mT
        stacked = matvec(factors.flatten(1, 2), at.y).unflatten(1, factors.shape[1:3])
        momenta = stacked + ys @ at.factor.mT
        return second, momenta.mT

    def _fill(self, diagonal: Tensor, outputs: Tensor) -> Tensor:
        if self.soft == 0:  # each row of L has its 2n entries and its own: without an index
            rows = outputs[..., :-1].unflatten(-1, (self.n, -1))
            return torch.cat((rows[..., :-1], torch.diag_embed(rows[..., -1])), dim=-1)
        lower = outputs[..., self.soft : -1]
        zero = torch.zeros_like(outputs[..., :1])
        flat = torch.cat((diagonal, lower, zero), dim=-1).index_select(-1, self.place)
        return flat.unflatten(-1, (self.n, -1))

    def _entries(self, v: Tensor, y: Tensor) -> Tensor:
        """Return ``vᵢ yⱼ`` for the entries ``L_ij`` that are not under a softplus."""
        if self.soft == 0:
            shared = y[:, None, : 2 * self.n].expand(-1, self.n, -1)
            rows = torch.cat((shared, y[:, 2 * self.n :].unsqueeze(-1)), dim=-1)
            return (v.unsqueeze(-1) * rows).flatten(1)
        return v.index_select(1, self.lower_row) * y.index_select(1, self.lower_column)

    def _own(self, v: Tensor, y: Tensor) -> Tensor:
        """Return ``v y`` of the diagonal under a softplus."""
        return v[:, : self.soft] * y[:, : self.soft]


def _inverse_softplus(value: float) -> float:
    # beyond 40 they are the same in float64, and e^value overflows from 710 on
    return math.log(math.expm1(value)) if value < 40.0 else value
