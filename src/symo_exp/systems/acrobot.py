"""The acrobot: two links, driven at the elbow only."""

from __future__ import annotations

from typing import final

import torch
from jaxtyping import Float
from torch import Tensor

from symo_exp.mechanics.types import Coordinates
from symo_exp.systems.base import SamplingBox, Skeleton, System

_ANY = (-3.14, 3.14)
BOX = SamplingBox(q=(_ANY, _ANY), v=(_ANY, _ANY), u=((-2.0, 2.0),))


@final
class Acrobot(System):
    """Two-link arm, ``θ₁ = 0`` hanging, ``θ₂`` relative to link 1, torque on the second joint.

    With ``α = I₁ + m₁ l_c1² + m₂ l₁²``, ``β = I₂ + m₂ l_c2²``, ``δ = m₂ l₁ l_c2 cos θ₂``::

        H = [[α + β + 2δ, β + δ], [β + δ, β]]
        V = −(m₁ l_c1 + m₂ l₁) g cos θ₁ − m₂ l_c2 g cos(θ₁ + θ₂)

    (thesis B.2 with ``l_c2`` in (B.5); Spong, "The swing up control problem for the acrobot", 1995;
    Sutton and Barto, example 11.3). ``B = [0, 1]ᵀ``.

    Parameters, for links 1 and 2: ``mass`` m [kg], ``length`` l [m], ``centre`` l_c, the distance
    of the centre of mass from the link's joint [m], ``inertia`` I about it [kg m²]; ``gravity`` g
    [m/s²].
    """

    def __init__(
        self,
        *,
        time_step: float = 0.05,
        gravity: float = 9.81,
        mass_1: float = 1.0,
        mass_2: float = 1.0,
        length_1: float = 1.0,
        length_2: float = 1.0,
        centre_1: float = 0.5,
        centre_2: float = 0.5,
        inertia_1: float = 1.0,
        inertia_2: float = 1.0,
        box: SamplingBox = BOX,
    ) -> None:
        super().__init__(
            coordinates=Coordinates(names=("theta_1", "theta_2"), angular=(True, True)),
            input_matrix=[[0.0], [1.0]],
            time_step=time_step,
            parameters={
                "gravity": (gravity, "m/s^2"),
                "mass_1": (mass_1, "kg"),
                "mass_2": (mass_2, "kg"),
                "length_1": (length_1, "m"),
                "length_2": (length_2, "m"),
                "centre_1": (centre_1, "m"),
                "centre_2": (centre_2, "m"),
                "inertia_1": (inertia_1, "kg m^2"),
                "inertia_2": (inertia_2, "kg m^2"),
            },
            box=box,
        )
        self.gravity = gravity
        self.mass_1, self.mass_2 = mass_1, mass_2
        self.length_1, self.length_2 = length_1, length_2
        self.centre_1, self.centre_2 = centre_1, centre_2
        self.inertia_1, self.inertia_2 = inertia_1, inertia_2

    def mass_matrix(self, q: Float[Tensor, "batch 2"]) -> Float[Tensor, "batch 2 2"]:
        alpha = self.inertia_1 + self.mass_1 * self.centre_1**2 + self.mass_2 * self.length_1**2
        beta = self.inertia_2 + self.mass_2 * self.centre_2**2
        delta = self.mass_2 * self.length_1 * self.centre_2 * q[:, 1].cos()
        off_diagonal = beta + delta
        return torch.stack(
            [alpha + beta + 2 * delta, off_diagonal, off_diagonal, torch.full_like(delta, beta)], -1
        ).unflatten(-1, (2, 2))

    def potential(self, q: Float[Tensor, "batch 2"]) -> Float[Tensor, " batch"]:
        shoulder = self.mass_1 * self.centre_1 + self.mass_2 * self.length_1
        elbow = self.mass_2 * self.centre_2
        return -self.gravity * (shoulder * q[:, 0].cos() + elbow * q.sum(-1).cos())

    def skeleton(self, q: Float[Tensor, " 2"]) -> Skeleton:
        first, second = q[0], q[0] + q[1]
        elbow = self.length_1 * torch.stack([first.sin(), -first.cos()])
        tip = elbow + self.length_2 * torch.stack([second.sin(), -second.cos()])
        points = torch.stack([torch.zeros_like(tip), elbow, tip])
        return Skeleton(points, links=((0, 1), (1, 2)), reach=self.length_1 + self.length_2)
