"""Lower triangular matrices from vectors of parameters."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn


class Triangle(nn.Module):
    """Lower triangular matrices of ``n`` rows as vectors of their entries."""

    place: Tensor

    def __init__(self, n: int) -> None:
        super().__init__()
        self.entries = n * (n + 1) // 2
        row, column = torch.tril_indices(n, n)
        place = torch.full((n, n), self.entries)  # above the diagonal: the zero at the end
        place[row, column] = torch.arange(self.entries)
        self.register_buffer("place", place, persistent=False)

    def square(self, flat: Float[Tensor, "*batch entries"]) -> Float[Tensor, "*batch n n"]:
        """Return the matrices of such vectors."""
        padded = torch.cat((flat, torch.zeros_like(flat[..., :1])), dim=-1)
        return padded[..., self.place]

    def factors(
        self, flat: Float[Tensor, "*batch entries"]
    ) -> tuple[Float[Tensor, "*batch n n"], Float[Tensor, "*batch n"]]:
        """Return the unit triangle ``U`` and ``d``, the squared diagonal, of ``U diag(d) Uᵀ``."""
        square = self.square(flat)
        d = square.diagonal(dim1=-2, dim2=-1).square()
        return torch.tril(square, -1) + torch.eye(d.shape[-1]).to(d), d

    def semidefinite(self, flat: Float[Tensor, "*batch entries"]) -> Float[Tensor, "*batch n n"]:
        """Return ``U diag(d) Uᵀ``."""
        unit, d = self.factors(flat)
        return unit * d.unsqueeze(-2) @ unit.mT

    def flat(self, matrix: Float[Tensor, "n n"]) -> Float[Tensor, " entries"]:
        """Return the vector of a matrix."""
        return matrix[tuple(torch.tril_indices(*matrix.shape))]
