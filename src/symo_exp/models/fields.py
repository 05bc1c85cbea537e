"""Vector fields: the acceleration of a state, by a network or by a Lagrangian."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor, nn
from typing_extensions import override

from symo_exp.mechanics.euler_lagrange import acceleration
from symo_exp.mechanics.lagrangian import Lagrangian
from symo_exp.mechanics.scaled import Scale
from symo_exp.mechanics.space import FLAT, Space
from symo_exp.mechanics.types import Coordinates
from symo_exp.mechanics.units import SI
from symo_exp.nets.embedding import features_of


@runtime_checkable
class MakesNetwork(Protocol):
    """A factory of networks, such as ``MLP`` with its sizes bound (``net`` in ``conf``)."""

    def __call__(self, *, inputs: int, outputs: int) -> nn.Module:
        """Return a new network with so many inputs and outputs."""


class Field(nn.Module, ABC):
    """An acceleration ``v̇ = a(q, v, u)`` of ``n`` coordinates under ``m`` controls, in SI units.

    Args:
        input_matrix: ``B`` (n, m) of the generalised force ``F = B u``.
    """

    lagrangian: Lagrangian | None
    """The Lagrangian of the field, if it has one."""
    input_matrix: Tensor
    space: Space = FLAT
    """The space of configurations."""

    def __init__(self, input_matrix: Float[Tensor, "n m"]) -> None:
        super().__init__()
        matrix = input_matrix.to(torch.get_default_dtype())
        self.register_buffer("input_matrix", matrix, persistent=False)

    @abstractmethod
    def forward(self, q: Tensor, v: Tensor, u: Tensor) -> Float[Tensor, "batch n"]:
        """Return the accelerations at a batch of states under a batch of controls."""


class NetworkAcceleration(Field):
    """``v̇ = net(s(q), v, u)``, without mechanics.

    Angles are embedded as ``(cos, sin)``, rotations by their entries. The numbers of the network
    are in the units of the coordinates.

    Args:
        net: Factory of the network, called with the numbers of its inputs and outputs.
        coordinates: Coordinates of the system.
        input_matrix: ``B`` (n, m) of the generalised force ``F = B u``.
    """

    lagrangian = None

    def __init__(
        self, net: MakesNetwork, *, coordinates: Coordinates, input_matrix: Tensor
    ) -> None:
        super().__init__(input_matrix)
        n, m = input_matrix.shape
        self.space, self.embedding = coordinates.space, features_of(coordinates)
        self.net = net(inputs=self.embedding.size + n + m, outputs=n)
        self.scale = None if coordinates.units == SI else Scale(coordinates)

    @override
    def forward(self, q: Tensor, v: Tensor, u: Tensor) -> Tensor:
        if self.scale is not None:
            (q, v), u = self.scale.inside(q, v), self.scale.inputs(u, self.input_matrix)
        found: Tensor = self.net(torch.cat((self.embedding(q).x, v, u), dim=1))
        return found if self.scale is None else self.scale.outside(found, 2)


class EulerLagrangeAcceleration(Field):
    """``v̇ = H⁻¹ (B u − Ḣ v + ℒ_q)`` (thesis (3.14)) of a learned or a true Lagrangian.

    Args:
        lagrangian: The Lagrangian ``ℒ``.
        input_matrix: ``B`` (n, m) of the generalised force ``F = B u``.
    """

    lagrangian: Lagrangian

    def __init__(self, lagrangian: Lagrangian, input_matrix: Tensor) -> None:
        super().__init__(input_matrix)
        self.lagrangian, self.space = lagrangian, lagrangian.space

    @override
    def forward(self, q: Tensor, v: Tensor, u: Tensor) -> Tensor:
        force = self.lagrangian.input_force(self.input_matrix, q, u)
        return acceleration(self.lagrangian, q, v, force)
