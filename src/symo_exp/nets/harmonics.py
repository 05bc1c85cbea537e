"""First harmonics of the angles, which represent chains of rigid links exactly."""

from __future__ import annotations

from itertools import combinations, product

import torch
from jaxtyping import Float
from torch import Tensor, nn

from symo_exp.nets.embedding import Features, directions


class Harmonics(nn.Module):
    """``cos(k·q)`` and ``sin(k·q)`` for ``k`` in {−1, 0, 1} of at most ``order`` angles.

    They span the products of ``(1, cos, sin)`` of these angles, which inertia and potential of a
    chain of rigid links consist of. One of ``k`` and ``−k`` is enough.

    Args:
        angular: Which coordinates are angles.
        order: Largest number of angles in a harmonic.
        relative: Whether each angle is relative to the one before; ``k`` then multiplies the sums
            ``φ₁ + … + φᵢ``.
    """

    waves: Tensor

    def __init__(self, *, angular: tuple[bool, ...], order: int, relative: bool = False) -> None:
        super().__init__()
        angles = [i for i, is_angle in enumerate(angular) if is_angle]
        rows = []
        for count in range(1, min(order, len(angles)) + 1):
            for chosen in combinations(angles, count):
                for signs in product((1.0, -1.0), repeat=count - 1):
                    wave = torch.zeros(len(angular))
                    wave[list(chosen)] = torch.tensor((1.0, *signs))
                    rows.append(wave)
        wave_numbers = torch.stack(rows) if rows else torch.zeros(0, len(angular))
        if relative:
            wave_numbers = wave_numbers @ directions(angular)
        self.register_buffer("waves", torch.cat((wave_numbers, wave_numbers)), persistent=False)

    @property
    def size(self) -> int:
        """Number of features."""
        return len(self.waves)

    def forward(self, q: Float[Tensor, "batch n"]) -> Features:
        """Return the features with their derivatives in the phase ``k·q``."""
        phase = q @ self.waves[: self.size // 2].T
        cos, sin = torch.cos(phase), torch.sin(phase)
        return Features(torch.cat((cos, sin), dim=1), torch.cat((-sin, cos), dim=1))

    def spread(self, direction: Float[Tensor, "batch n"]) -> Float[Tensor, "batch features"]:
        """Return the rate of each phase; times ``dx`` they are the features' rates."""
        return direction @ self.waves.T

    def basis_tangents(self, features: Features) -> Float[Tensor, "batch n features"]:
        """Return the features' rates along every coordinate."""
        return features.dx.unsqueeze(1) * self.waves.T

    def to_coordinates(
        self, cotangent: Float[Tensor, "batch features"]
    ) -> Float[Tensor, "batch n"]:
        """Return the cotangent in ``q`` of a cotangent in the phases."""
        return cotangent @ self.waves

    def curvature(
        self, features: Features, cotangent: Float[Tensor, "batch features"]
    ) -> Float[Tensor, "batch n n"]:
        """Return the second derivatives in ``q`` of ``cotangent · features``."""
        return -(self.waves.T * (cotangent * features.x).unsqueeze(1)) @ self.waves
