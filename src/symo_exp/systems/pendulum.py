"""The physical pendulum: a rod that swings about one end."""

from __future__ import annotations

from math import pi
from typing import final

import torch
from jaxtyping import Float
from torch import Tensor

from symo_exp.mechanics.types import Coordinates
from symo_exp.systems.base import SamplingBox, Skeleton, System

BOX = SamplingBox(q=((-pi, pi),), v=((-2 * pi, 2 * pi),), u=((-2.0, 2.0),))


@final
class Pendulum(System):
    """Uniform rod, ``θ = 0`` upright, torque ``u`` on the pivot (thesis B.1, (B.3) corrected).

    ``T = ½ I θ̇²`` with ``I = ⅓ m l²``, ``V = ½ m g l (1 + cos θ)``; hence
    ``θ̈ = (3 g / 2 l) sin θ + 3 u / (m l²)``.

    Parameters: ``gravity`` g [m/s²], ``mass`` m [kg], ``length`` l [m].
    """

    def __init__(
        self,
        *,
        time_step: float = 0.1,
        gravity: float = 9.8,
        mass: float = 1.0,
        length: float = 1.0,
        box: SamplingBox = BOX,
    ) -> None:
        super().__init__(
            coordinates=Coordinates(names=("theta",), angular=(True,)),
            input_matrix=[[1.0]],
            time_step=time_step,
            parameters={
                "gravity": (gravity, "m/s^2"),
                "mass": (mass, "kg"),
                "length": (length, "m"),
            },
            box=box,
        )
        self.gravity, self.mass, self.length = gravity, mass, length

    def mass_matrix(self, q: Float[Tensor, "batch 1"]) -> Float[Tensor, "batch 1 1"]:
        inertia = self.mass * self.length**2 / 3
        return torch.full_like(q, inertia).unsqueeze(-1)

    def potential(self, q: Float[Tensor, "batch 1"]) -> Float[Tensor, " batch"]:
        return 0.5 * self.mass * self.gravity * self.length * (1 + q[:, 0].cos())

    def skeleton(self, q: Float[Tensor, " 1"]) -> Skeleton:
        tip = self.length * torch.stack([-q[0].sin(), q[0].cos()])
        points = torch.stack([torch.zeros_like(tip), tip])
        return Skeleton(points, links=((0, 1),), reach=self.length)
