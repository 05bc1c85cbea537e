"""The physical pendulum: a rod that swings about one end."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, final

import torch
from jaxtyping import Float
from torch import Tensor
from typing_extensions import override

from symo_exp.mechanics.bodies import link
from symo_exp.mechanics.types import Coordinates
from symo_exp.systems.base import LagrangianSystem, Linkage, Skeleton


@final
@dataclass(frozen=True, kw_only=True)
class Pendulum(LagrangianSystem):
    """Uniform rod, ``θ = 0`` upright, torque ``u`` on the pivot (thesis B.1, (B.3) corrected).

    ``T = ½ I θ̇²`` with ``I = ⅓ m l²``, ``V = ½ m g l (1 + cos θ)``; hence
    ``θ̈ = (3 g / 2 l) sin θ + 3 u / (m l²)``.
    """

    gravity: Annotated[float, "m/s^2"]
    mass: Annotated[float, "kg"]
    length: Annotated[float, "m"]

    coordinates = Coordinates(names=("theta",), angular=(True,))
    input_matrix = torch.tensor([[1.0]], dtype=torch.float64)

    @override
    def mass_matrix(self, q: Float[Tensor, "batch 1"]) -> Float[Tensor, "batch 1 1"]:
        inertia = self.mass * self.length**2 / 3
        return (inertia * torch.ones_like(q)).unsqueeze(-1)

    @override
    def potential(self, q: Float[Tensor, "batch 1"]) -> Float[Tensor, " batch"]:
        return 0.5 * self.mass * self.gravity * self.length * (1 + q[:, 0].cos())

    @property
    @override
    def linkage(self) -> Linkage:
        mass, length = float(self.mass), float(self.length)
        inertia = mass * length**2 / 12
        rod = link("theta", mass, (0.0, 0.0, length / 2), (inertia, inertia, 0.0))
        return Linkage((rod,), (0.0, 0.0, -float(self.gravity)), torch.eye(1).double())

    @override
    def skeleton(self, q: Float[Tensor, " 1"]) -> Skeleton:
        tip = self.length * torch.stack([-q[0].sin(), q[0].cos()])
        points = torch.stack([torch.zeros_like(tip), tip])
        return Skeleton(points, links=((0, 1),), reach=self.length)
