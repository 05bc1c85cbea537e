"""Weights of iteratively reweighted least squares, by which outliers count little."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor

NORMAL = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""
SMALLEST = 1e-12
"""Lower bound on a threshold: a little above rounding, since errors are over the units of the
machine, in which motions are of order one."""


def huber_weights(errors: Float[Tensor, "*batch n"], factor: float) -> Float[Tensor, "*batch n"]:
    """Return ``w = min(1, c/|e|)``, with which least squares minimise Huber's loss.

    The gradient of ``Σ w e²`` with ``w`` held is that of ``Σ ρ(e)``, ``ρ = e²`` up to the threshold
    ``c`` and ``2c|e| − c²`` beyond (Huber 1964). Steps from new weights each time find its minimum
    (Holland and Welsch 1977).

    Args:
        errors: ``e``.
        factor: ``c`` of a coordinate in robust standard deviations of its errors, which are 1.48
            times the median of ``|e|``.
    """
    size = errors.abs()
    scale = NORMAL * median_of_rows(size.flatten(0, -2))
    return weights_beyond(factor * scale, size)


def weights_beyond(threshold: Tensor, size: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """Return ``min(1, c/|e|)`` for a threshold ``c`` and sizes ``|e|``."""
    threshold = threshold.clamp_min(SMALLEST)
    return threshold / size.maximum(threshold)


def median_of_rows(x: Float[Tensor, "count ..."]) -> Float[Tensor, " ..."]:
    """Return the median over the rows; ``torch.median`` has the lower one of an even number."""
    return 0.5 * (x.median(0).values - (-x).median(0).values)
