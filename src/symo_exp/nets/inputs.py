"""An input matrix that is learned beside a Lagrangian."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn

from symo_exp.errors import ConfigError
from symo_exp.mechanics.lagrangian import matvec
from symo_exp.mechanics.types import Coordinates
from symo_exp.nets.affine import repeated
from symo_exp.nets.embedding import require_flat


class LearnedInputs(nn.Module):
    """The input matrix ``B = B₀ + C`` near a given ``B₀``, whose largest entry is kept.

    Inputs in volts, amperes or per cent have unknown gains, and a motor may also drive a neighbour
    of its coordinate. A common factor of all entries cannot be distinguished from a factor of the
    Lagrangian; therefore one entry is held. Entries are in units of the largest one of their
    column, so that they are about as large as each other, and are shrunk to zero unless the data
    contradict ``B₀``.

    Args:
        given: ``B₀`` (n, m) of the generalised force ``F = B u``.
        coordinates: The coordinates.

    Raises:
        ConfigError: If there is nothing to learn, or a rotation.
    """

    given: Tensor
    basis: Tensor

    def __init__(self, given: Float[Tensor, "n m"], coordinates: Coordinates) -> None:
        super().__init__()
        instead = "lagrangian=rigid_body, which has lagrangian.learned_inputs"
        require_flat(coordinates, "model.inputs=learned", instead)
        if given.numel() < 2:
            raise ConfigError(
                f"model.inputs=learned needs two entries of the input matrix or more, and it has "
                f"{given.numel()}: a factor of all of them is one of the inertia"
            )
        given, units = given.double(), coordinates.sizes.unsqueeze(1)
        size = (given * units).abs().amax(0)
        size = torch.where(size > 0.0, size, size.max() if bool(size.any()) else 1.0)
        held = int((given * units).abs().argmax())
        basis = torch.diag((size / units).flatten())
        basis = torch.cat((basis[:held], basis[held + 1 :]))
        like = torch.get_default_dtype()
        self.register_buffer("given", given.to(like), persistent=False)
        self.register_buffer("basis", basis.to(like), persistent=False)
        self.entries = nn.Parameter(torch.zeros(len(basis)))

    @property
    def matrix(self) -> Float[Tensor, "n m"]:
        """``B``."""
        return self.given + (self.entries @ self.basis).view_as(self.given)

    def force(self, u: Float[Tensor, "batch m"]) -> Float[Tensor, "batch n"]:
        """Return ``B u``."""
        more = (repeated(self.entries, u.shape[0]) @ self.basis).unflatten(1, self.given.shape)
        return u @ self.given.T + matvec(more, u)
