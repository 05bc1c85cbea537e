"""The embedding ``s(q) = (r, cos φ, sin φ)`` of a configuration (thesis section 4.1.3)."""

from __future__ import annotations

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn
from typing_extensions import override

from symo_exp.errors import ConfigError
from symo_exp.mechanics.types import Coordinates


class Features(NamedTuple):
    """``s(q)`` with its derivatives.

    A feature depends on one coordinate, its owner, or on one sum of relative angles.
    """

    x: Float[Tensor, "batch features"]
    dx: Float[Tensor, "batch features"]
    """``∂s_f/∂q`` with respect to the owner."""


class Embedding(nn.Module):
    """Features of a configuration with each angle as cosine and sine, periodic and smooth in it.

    Features are ordered: translational coordinates, cosines, sines.

    Args:
        angular: Which coordinates are angles.
        relative: Whether each angle is relative to the one before; features are then those of the
            sums ``φ₁ + … + φᵢ``.
    """

    owner: Tensor
    selection: Tensor
    bend: Tensor
    turn: Tensor | None

    def __init__(self, *, angular: tuple[bool, ...], relative: bool = False) -> None:
        super().__init__()
        straight = [i for i, is_angle in enumerate(angular) if not is_angle]
        angles = [i for i, is_angle in enumerate(angular) if is_angle]
        owner = torch.tensor([*straight, *angles, *angles], dtype=torch.int64)
        self._straight, self._angles = len(straight), len(angles)
        self.register_buffer("owner", owner, persistent=False)
        turn = directions(angular) if relative else torch.eye(len(angular))
        self.register_buffer("turn", turn if relative else None, persistent=False)
        # selection[f, i] = 1 if coordinate i is in the owner of feature f.
        self.register_buffer("selection", turn[owner], persistent=False)
        bend = torch.cat((torch.zeros(len(straight)), -torch.ones(2 * len(angles))))
        self.register_buffer("bend", bend, persistent=False)

    @property
    def size(self) -> int:
        """Number of features."""
        return self._straight + 2 * self._angles

    @override
    def forward(self, q: Float[Tensor, "batch n"]) -> Features:
        owned = self.spread(q)
        r = owned[:, : self._straight]
        phi = owned[:, self._straight : self._straight + self._angles]
        cos, sin = torch.cos(phi), torch.sin(phi)
        return Features(
            torch.cat((r, cos, sin), dim=1), torch.cat((torch.ones_like(r), -sin, cos), dim=1)
        )

    def second(self, features: Features) -> Float[Tensor, "batch features"]:
        """Return ``∂²s_f/∂q²`` with respect to the owner: ``−s_f`` for an angle, else zero."""
        return features.x * self.bend

    def spread(self, direction: Float[Tensor, "batch n"]) -> Float[Tensor, "batch features"]:
        """Return the owner's entry for each feature; times ``dx`` it is the features' rate."""
        turned = direction if self.turn is None else direction @ self.turn.T
        return turned.index_select(1, self.owner)

    def basis_tangents(self, features: Features) -> Float[Tensor, "batch n features"]:
        """Return ``s_q eᵢ`` for every coordinate ``i``."""
        return features.dx.unsqueeze(1) * self.selection.T

    def to_coordinates(
        self, cotangent: Float[Tensor, "batch features"]
    ) -> Float[Tensor, "batch n"]:
        """Return the sums of a cotangent over the features of each coordinate."""
        return cotangent @ self.selection

    def curvature(
        self, features: Features, cotangent: Float[Tensor, "batch features"]
    ) -> Float[Tensor, "batch n n"]:
        """Return the second derivatives in ``q`` of ``cotangent · s(q)``."""
        own = self.second(features) * cotangent
        if self.turn is None:
            return torch.diag_embed(self.to_coordinates(own))
        return (self.selection.T * own.unsqueeze(1)) @ self.selection


class EntriesEmbedding(nn.Module):
    """Features of configurations with rotations: those of the flat part, and nine entries of each.

    Args:
        coordinates: The coordinates.
    """

    def __init__(self, *, coordinates: Coordinates) -> None:
        super().__init__()
        self._flat = len(coordinates.flat)
        self.flat = Embedding(angular=coordinates.angular[: self._flat])
        self._entries = 9 * len(coordinates.rotations)

    @property
    def size(self) -> int:
        """Number of features."""
        return self.flat.size + self._entries

    @override
    def forward(self, q: Float[Tensor, "batch N"]) -> Features:
        x, entries = q[:, : self._flat], q[:, self._flat :]
        flat = self.flat(x)
        return Features(
            torch.cat((flat.x, entries), dim=1), torch.cat((flat.dx, torch.ones_like(entries)), 1)
        )


def require_flat(coordinates: Coordinates, choice: str, instead: str) -> None:
    """Refuse a choice that reads lengths and angles only for a system with rotations.

    Raises:
        ConfigError: If there are rotations.
    """
    if coordinates.rotations:
        raise ConfigError(
            f"{choice} reads lengths and angles only, and the system has the rotation "
            f"{', '.join(coordinates.rotations)}; choose {instead}"
        )


def require_one_body(coordinates: Coordinates, choice: str, instead: str) -> None:
    """Refuse a choice for one rigid body with other coordinates.

    Raises:
        ConfigError: If they are not a rotation, or a position of three lengths and a rotation.
    """
    flat = len(coordinates.flat)
    if len(coordinates.rotations) != 1 or flat not in (0, 3) or any(coordinates.angular):
        raise ConfigError(
            f"{choice} is for one body, a rotation or a position of three lengths and a rotation; "
            f"the system has {', '.join(coordinates.names)}: choose {instead}"
        )


def features_of(coordinates: Coordinates) -> Embedding | EntriesEmbedding:
    """Return the embedding of the configurations of some coordinates."""
    if coordinates.rotations:
        return EntriesEmbedding(coordinates=coordinates)
    return Embedding(angular=coordinates.angular)


def directions(angular: tuple[bool, ...]) -> Float[Tensor, "n n"]:
    """Return the sums ``φ₁ + … + φᵢ`` of the angles, and the other coordinates as they are."""
    turn = torch.eye(len(angular))
    angles = [i for i, is_angle in enumerate(angular) if is_angle]
    for k, i in enumerate(angles):
        turn[i, angles[: k + 1]] = 1.0
    return turn
