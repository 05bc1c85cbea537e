"""Linear springs beside a learned Lagrangian.

``V(q) = V₀(q) + ½ xᵀ K x − fᵀ x`` with the lengths and angles ``x``. Angles count turns, so that a
torsion spring is wound up.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor, nn
from typing_extensions import override

from symo_exp.errors import ConfigError
from symo_exp.mechanics.forced import ForcedExpansion, ForcedLagrangian
from symo_exp.mechanics.lagrangian import Curvature, Expansion, Lagrangian, matvec
from symo_exp.mechanics.types import Coordinates
from symo_exp.nets.affine import repeated
from symo_exp.nets.roles import mark


class LinearSprings(nn.Module):
    """Stiffness ``K``, symmetric, and preload ``f``.

    ``K`` may have either sign: magnets and linkages with counterweights push away from a place.

    Args:
        coordinates: The coordinates.
        start: ``K`` at the start of training, a row for each length and angle; ``None``: zero.

    Raises:
        ConfigError: If there are only rotations, or ``start`` is not a symmetric matrix.
    """

    places: Tensor

    def __init__(
        self, *, coordinates: Coordinates, start: Sequence[Sequence[float]] | None = None
    ) -> None:
        super().__init__()
        n = len(coordinates.flat)
        if n == 0:
            raise ConfigError(
                "springs=linear: springs act on lengths and angles, and the system has the "
                f"rotation {', '.join(coordinates.rotations)} only; set springs=none"
            )
        row, column = torch.tril_indices(n, n)
        places = torch.zeros(n, n, dtype=torch.long)
        places[row, column] = places[column, row] = torch.arange(len(row))
        self.register_buffer("places", places, persistent=False)
        self.stiffness = nn.Parameter(_symmetric(start, n)[row, column])
        """The lower triangle of ``K``, row by row [N/m, N m/rad]."""
        self.preload = nn.Parameter(torch.zeros(n))
        """``f`` [N, N m]."""
        mark(self.parameters(), "coefficient")

    @property
    def matrix(self) -> Float[Tensor, "n n"]:
        """``K``."""
        return self.stiffness[self.places]

    def energy(self, q: Float[Tensor, "batch N"]) -> Float[Tensor, " batch"]:
        """Return ``½ xᵀ K x − fᵀ x`` [J]."""
        x = q[:, : len(self.preload)]
        return (x * (0.5 * (x @ self.matrix) - self.preload)).sum(1)

    def force(self, q: Float[Tensor, "batch N"], n: int) -> Float[Tensor, "batch n"]:
        """Return ``f − K x``, zero along rotations, of ``n`` coordinates."""
        x = q[:, : len(self.preload)]
        stiffness = repeated(self.stiffness, q.shape[0])[:, self.places]
        force = repeated(self.preload, q.shape[0]) - matvec(stiffness, x)
        return nn.functional.pad(force, (0, n - x.shape[1]))


def _symmetric(start: Sequence[Sequence[float]] | None, n: int) -> Float[Tensor, "n n"]:
    """Return the given matrix, zero if there is none; refuse one that is not symmetric."""
    if start is None:
        return torch.zeros(n, n)
    try:
        found = torch.tensor([[float(x) for x in row] for row in start])
    except (TypeError, ValueError):
        found = torch.zeros(0)
    fits = found.shape == (n, n) and bool(found.isfinite().all()) and torch.equal(found, found.T)
    if not fits:
        rows = ",".join([f"[{','.join('0' * n)}]"] * n)
        raise ConfigError(
            f"springs.start={start}: expected a symmetric matrix of finite numbers with a row for "
            f"each length and angle, such as [{rows}]"
        )
    return found


class SprungExpansion(ForcedExpansion):
    """A Lagrangian with springs around ``(q, v)``."""

    lagrangian: SprungLagrangian

    @override
    @torch.no_grad()
    def curvature(self, before: Expansion | None = None) -> Curvature:
        qq, vq, qv = self.at.curvature()
        stiffness = self.lagrangian.springs.matrix
        more = qq.shape[-1] - len(stiffness)
        return Curvature(qq - nn.functional.pad(stiffness, (0, more, 0, more)), vq, qv)


class SprungLagrangian(ForcedLagrangian):
    """A Lagrangian with springs beside it.

    Args:
        conservative: The Lagrangian without springs.
        springs: The springs.
    """

    expansion = SprungExpansion

    def __init__(self, conservative: Lagrangian, springs: LinearSprings) -> None:
        super().__init__(conservative)
        self.springs = springs

    @override
    def further_force(self, q: Tensor, v: Tensor) -> Tensor:
        return self.springs.force(q, v.shape[1])

    @override
    def potential(self, q: Float[Tensor, "batch N"]) -> Float[Tensor, " batch"]:
        return super().potential(q) + self.springs.energy(q)
