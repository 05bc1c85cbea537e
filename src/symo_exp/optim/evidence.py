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
        ``G`` is not finite.
    """
    if not bool(gram.isfinite().all()):
        return None
    determined = _determined(gram / noise, precision[group]) * moves
    gamma = torch.zeros_like(precision).index_add_(0, group, determined)
    size = torch.zeros_like(gamma).index_add_(0, group, theta.square())
    found = (gamma / size).clamp(LEAST, MOST)
    known = ~flat & (gamma > 0) & (size > 0)
    return torch.where(known, found, precision), float(gamma.sum())


def _determined(gram: Tensor, own: Tensor) -> Float[Tensor, " parameters"]:
    """Return ``1 − α (G + α)⁻¹ᵢᵢ`` of each parameter.

    Combinations of parameters that do not change the residuals have ``α`` alone. Where that is lost
    in the rounding of ``G``, the eigenvalues ``λ`` of ``G`` in units of ``α`` give the same number,
    ``λ / (1 + λ)`` each; those of rounding are zero.
    """
    posterior = gram + torch.diag(own)
    rounding = len(own) * torch.finfo(own.dtype).eps
    factor, info = torch.linalg.cholesky_ex(posterior)
    least = factor.diagonal().amin().square()
    if int(info) == 0 and bool(least > rounding * posterior.diagonal().amax()):
        return (1.0 - own * torch.cholesky_inverse(factor).diagonal()).clamp(0.0, 1.0)
    unit = own.rsqrt()
    values, vectors = torch.linalg.eigh(unit[:, None] * gram * unit)
    values = torch.where(values > rounding * values[-1], values, 0.0)
    return vectors.square() @ (values / (1.0 + values))
