"""The embedding ``s(q) = (r, cos φ, sin φ, R)`` of a configuration (thesis section 4.1.3)."""

from __future__ import annotations

from functools import reduce
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn
from typing_extensions import override

from symo_exp.errors import ConfigError
from symo_exp.mechanics.space import Space, cross, torques, with_rotations
from symo_exp.mechanics.types import Coordinates


class Features(NamedTuple):
    """``s(q)`` with its derivatives.

    A feature depends on one coordinate, its owner, or on one sum of relative angles, or it is an
    entry of a rotation. Entries are the last ones.
    """

    x: Float[Tensor, "batch features"]
    dx: Float[Tensor, "batch features"]
    """``∂s_f/∂q`` with respect to the owner; 1 of an entry."""


class Embedding(nn.Module):
    """Features of a configuration with each angle as cosine and sine, periodic and smooth in it.

    Features are ordered: translational coordinates, cosines, sines, the nine entries of each
    rotation. Derivatives in a rotation are those along ``R exp φ``.

    Args:
        angular: Which of the coordinates before the rotations are angles.
        relative: Whether each angle is relative to the one before; features are then those of the
            sums ``φ₁ + … + φᵢ``.
        rotations: Number of rotations.
    """

    owner: Tensor
    selection: Tensor
    bend: Tensor
    spin: Tensor
    turn: Tensor | None

    def __init__(
        self, *, angular: tuple[bool, ...], relative: bool = False, rotations: int = 0
    ) -> None:
        super().__init__()
        straight = [i for i, is_angle in enumerate(angular) if not is_angle]
        angles = [i for i, is_angle in enumerate(angular) if is_angle]
        owner = torch.tensor([*straight, *angles, *angles], dtype=torch.int64)
        self._straight, self._angles = len(straight), len(angles)
        self.space = Space(rotations)
        self.register_buffer("owner", owner, persistent=False)
        turn = directions(angular) if relative else torch.eye(len(angular))
        self.register_buffer("turn", turn if relative else None, persistent=False)
        # selection[f, i] = 1 if coordinate i is in the owner of feature f.
        self.register_buffer("selection", turn[owner], persistent=False)
        # the map from the entries of R to those of R [e₁], R [e₂] and R [e₃]
        spin = torch.einsum("jm,ikl->jkiml", torch.eye(3), cross(torch.eye(3)))
        self.register_buffer("spin", spin.reshape(9, 27), persistent=False)
        bend = torch.cat((torch.zeros(len(straight)), -torch.ones(2 * len(angles))))
        self.register_buffer("bend", bend, persistent=False)

    @property
    def size(self) -> int:
        """Number of features."""
        return self._flat + 9 * self.space.rotations

    @property
    def _flat(self) -> int:
        """Number of features of the coordinates before the rotations."""
        return self._straight + 2 * self._angles

    @override
    def forward(self, q: Float[Tensor, "batch N"]) -> Features:
        flat, entries = self._parts(q, 9)
        if not self._flat:
            return Features(entries, torch.ones_like(entries))
        owned = self._spread(flat)
        r = owned[:, : self._straight]
        phi = owned[:, self._straight : self._straight + self._angles]
        cos, sin = torch.cos(phi), torch.sin(phi)
        x = torch.cat((r, cos, sin), dim=1)
        dx = torch.cat((torch.ones_like(r), -sin, cos), dim=1)
        if self.space.rotations:
            x, dx = torch.cat((x, entries), 1), torch.cat((dx, torch.ones_like(entries)), 1)
        return Features(x, dx)

    def rate(
        self, features: Features, direction: Float[Tensor, "batch n"]
    ) -> Float[Tensor, "batch features"]:
        """Return ``s_q a``."""
        if not self.space.rotations:
            return features.dx * self._spread(direction)
        flat, turning = self._parts(direction, 3)
        along = with_rotations(self._spread(flat), turning)
        return features.dx * self.space.push(features.x, along)

    def basis_tangents(self, features: Features) -> Float[Tensor, "batch n features"]:
        """Return ``s_q eᵢ`` for every coordinate ``i``."""
        blocks = []
        if self._flat:
            blocks.append(features.dx[:, : self._flat].unsqueeze(1) * self.selection.T)
        if self.space.rotations:
            entries = self.space.rotation_matrices(features.x).flatten(-2) @ self.spin
            blocks += entries.unflatten(-1, (3, 9)).unbind(1)
        return reduce(block_diagonal, blocks)

    def to_coordinates(
        self, features: Features, cotangent: Float[Tensor, "batch features"]
    ) -> Float[Tensor, "batch n"]:
        """Return ``s_qᵀ c``, the derivatives in the coordinates of ``c · s(q)``."""
        if not self.space.rotations:
            return (features.dx * cotangent) @ self.selection
        first = slice(self._flat)
        own = cotangent[:, first]
        if self._flat:
            own = (features.dx[:, first] * own) @ self.selection
        turns, by_turn = map(self.space.rotation_matrices, (features.x, cotangent))
        return with_rotations(own, torques(turns, by_turn).flatten(1))

    def to_stored(
        self,
        features: Features,
        cotangent: Float[Tensor, "batch features"],
        second: Float[Tensor, "batch features"],
        direction: Float[Tensor, "batch n"],
    ) -> Float[Tensor, "batch N"]:
        """Return partial derivatives of ``c · s + c₂ · s_q a`` in the numbers of a configuration.

        Args:
            features: ``s``.
            cotangent: ``c``.
            second: ``c₂``.
            direction: ``a``.
        """
        flat, turning = self._parts(direction, 3)
        first = slice(self._flat)
        bend = features.x[:, first] * self.bend * second[:, first] * self._spread(flat)
        own = (cotangent[:, first] * features.dx[:, first] + bend) @ self.selection
        if not self.space.rotations:
            return own
        rates = cross(turning.unflatten(1, (-1, 3)))
        bent = self.space.rotation_matrices(second) @ rates.mT
        return torch.cat((own, cotangent[:, self._flat :] + bent.flatten(1)), dim=1)

    def curvature(
        self, features: Features, cotangent: Float[Tensor, "batch features"]
    ) -> Float[Tensor, "batch n n"]:
        """Return the second derivatives in the coordinates of ``c · s(q)``.

        Those of ``⟨C, R⟩`` are ``M − (tr M) I`` with ``M = Rᵀ C``.
        """
        blocks = []
        if self._flat:
            own = features.x[:, : self._flat] * self.bend * cotangent[:, : self._flat]
            if self.turn is None:
                blocks.append(torch.diag_embed(own @ self.selection))
            else:
                blocks.append((self.selection.T * own.unsqueeze(1)) @ self.selection)
        if self.space.rotations:
            turns, by_turn = map(self.space.rotation_matrices, (features.x, cotangent))
            moment = turns.mT @ by_turn
            trace = moment.diagonal(dim1=-2, dim2=-1).sum(-1, keepdim=True)
            blocks += (moment - torch.diag_embed(trace.expand(*trace.shape[:-1], 3))).unbind(1)
        return reduce(block_diagonal, blocks)

    def _parts(self, x: Float[Tensor, "batch k"], size: int) -> tuple[Tensor, Tensor]:
        """Return what belongs to lengths and angles, and the ``size`` numbers of each rotation."""
        flat = x.shape[1] - size * self.space.rotations
        return x[:, :flat], x[:, flat:]

    def _spread(self, direction: Float[Tensor, "batch n"]) -> Float[Tensor, "batch features"]:
        """Return the owner's entry for each feature before the entries of rotations."""
        turned = direction if self.turn is None else direction @ self.turn.T
        return turned.index_select(1, self.owner)


def block_diagonal(
    first: Float[Tensor, "batch a b"], second: Float[Tensor, "batch c d"]
) -> Float[Tensor, "batch a+c b+d"]:
    """Return block diagonal matrices of two blocks."""
    above = nn.functional.pad(first, (0, second.shape[2]))
    return torch.cat((above, nn.functional.pad(second, (first.shape[2], 0))), dim=1)


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


def features_of(coordinates: Coordinates) -> Embedding:
    """Return the embedding of the configurations of some coordinates."""
    return Embedding(
        angular=coordinates.angular[: len(coordinates.flat)], rotations=len(coordinates.rotations)
    )


def directions(angular: tuple[bool, ...]) -> Float[Tensor, "n n"]:
    """Return the sums ``φ₁ + … + φᵢ`` of the angles, and the other coordinates as they are."""
    turn = torch.eye(len(angular))
    angles = [i for i, is_angle in enumerate(angular) if is_angle]
    for k, i in enumerate(angles):
        turn[i, angles[: k + 1]] = 1.0
    return turn
