"""Priors from the evidence."""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

FLAT = 1e-6
"""Prior precision of coefficients, which hardly shrinks them."""
LEAST, MOST = 1e-6, 1e6
"""Range of prior precisions from the evidence."""


def evidence(
    gram: Float[Tensor, "parameters parameters"],
    noise: float,
    precision: Float[Tensor, " groups"],
    theta: Float[Tensor, " parameters"],
    group: Int[Tensor, " parameters"],
    moves: Bool[Tensor, " parameters"],
    flat: Bool[Tensor, " groups"],
) -> tuple[Tensor, float] | None:
    """Return prior precisions of groups of parameters from the evidence (MacKay 1992).

        γ_g = Σ_{i∈g} 1 − α_g (G/σ² + α)⁻¹ᵢᵢ        α_g = γ_g / |θ_g|²

    Args:
        gram: ``G``.
        noise: ``σ²``.
        precision: ``α`` of each group.
        theta: The parameters.
        group: The group of each parameter.
        moves: Parameters that count.
        flat: Groups that keep their precision.

    Returns:
        New precisions and ``Σ γ``, the number of parameters that the data determine; ``None`` if
        the posterior precision has no factor.
    """
    own = precision[group]
    factor, info = torch.linalg.cholesky_ex(gram / noise + torch.diag(own))
    if int(info) != 0:
        return None
    determined = 1.0 - own * torch.cholesky_inverse(factor).diagonal()
    determined = determined.clamp(0.0, 1.0) * moves
    gamma = torch.zeros_like(precision).index_add_(0, group, determined)
    size = torch.zeros_like(gamma).index_add_(0, group, theta.square())
    found = (gamma / size).clamp(LEAST, MOST)
    known = ~flat & (gamma > 0) & (size > 0)
    return torch.where(known, found, precision), float(gamma.sum())
