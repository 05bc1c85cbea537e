"""Vector fields: the acceleration of a state, from a network or from a Lagrangian."""

from __future__ import annotations

from abc import ABC, abstractmethod

import torch
from jaxtyping import Float
from torch import Tensor, nn

from symo_exp.mechanics.euler_lagrange import acceleration, generalised_force
from symo_exp.mechanics.lagrangian import Lagrangian
from symo_exp.nets.embedding import Embedding
from symo_exp.nets.mlp import MLP


class Field(nn.Module, ABC):
    """``v̇ = a(q, v, u)`` of ``n`` coordinates and ``m`` controls, in SI units."""

    lagrangian: Lagrangian | None
    """That of the system, where the field has one."""
    input_matrix: Tensor

    def __init__(self, input_matrix: Float[Tensor, "n m"]) -> None:
        super().__init__()
        matrix = input_matrix.to(torch.get_default_dtype())
        self.register_buffer("input_matrix", matrix, persistent=False)

    @abstractmethod
    def forward(self, q: Tensor, v: Tensor, u: Tensor) -> Float[Tensor, "batch n"]:
        """The acceleration at a batch of states and controls."""


class NetworkAcceleration(Field):
    """``v̇ = MLP(s(q), v, u)`` with angles embedded as ``(cos, sin)``: no mechanics in it."""

    lagrangian = None

    def __init__(
        self, *, angular: tuple[bool, ...], input_matrix: Tensor, width: int, depth: int
    ) -> None:
        super().__init__(input_matrix)
        n, m = input_matrix.shape
        self.embedding = Embedding(angular=angular)
        self.net = MLP(inputs=self.embedding.size + n + m, outputs=n, width=width, depth=depth)

    def forward(self, q: Tensor, v: Tensor, u: Tensor) -> Tensor:
        return self.net(torch.cat((self.embedding(q).x, v, u), dim=1))


class EulerLagrangeAcceleration(Field):
    """``v̇ = H⁻¹ (B u − Ḣ v + ℒ_q)`` (thesis (3.14)); the Lagrangian may be learned or true."""

    lagrangian: Lagrangian

    def __init__(self, lagrangian: Lagrangian, input_matrix: Tensor) -> None:
        super().__init__(input_matrix)
        self.lagrangian = lagrangian

    def forward(self, q: Tensor, v: Tensor, u: Tensor) -> Tensor:
        return acceleration(self.lagrangian, q, v, generalised_force(self.input_matrix, u))
