"""The acrobot: two links, driven at the elbow only."""

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
class Acrobot(LagrangianSystem):
    """Two-link arm, ``θ₁ = 0`` hanging, ``θ₂`` relative to link 1, torque on the second joint.

    With ``α = I₁ + m₁ l_c1² + m₂ l₁²``, ``β = I₂ + m₂ l_c2²``, ``δ = m₂ l₁ l_c2 cos θ₂``::

        H = [[α + β + 2δ, β + δ], [β + δ, β]]
        V = −(m₁ l_c1 + m₂ l₁) g cos θ₁ − m₂ l_c2 g cos(θ₁ + θ₂)

    (thesis B.2 with ``l_c2`` in (B.5); Spong, "The swing up control problem for the acrobot", 1995;
    Sutton and Barto, example 11.3). ``B = [0, 1]ᵀ``. ``centre`` is ``l_c``, the distance of a
    link's centre of mass from its joint, ``inertia`` the link's about that centre.
    """

    gravity: Annotated[float, "m/s^2"]
    mass_1: Annotated[float, "kg"]
    mass_2: Annotated[float, "kg"]
    length_1: Annotated[float, "m"]
    length_2: Annotated[float, "m"]
    centre_1: Annotated[float, "m"]
    centre_2: Annotated[float, "m"]
    inertia_1: Annotated[float, "kg m^2"]
    inertia_2: Annotated[float, "kg m^2"]

    coordinates = Coordinates(names=("theta_1", "theta_2"), angular=(True, True))
    input_matrix = torch.tensor([[0.0], [1.0]], dtype=torch.float64)

    @override
    def mass_matrix(self, q: Float[Tensor, "batch 2"]) -> Float[Tensor, "batch 2 2"]:
        alpha = self.inertia_1 + self.mass_1 * self.centre_1**2 + self.mass_2 * self.length_1**2
        beta = self.inertia_2 + self.mass_2 * self.centre_2**2
        delta = self.mass_2 * self.length_1 * self.centre_2 * q[:, 1].cos()
        off_diagonal = beta + delta
        return torch.stack(
            [alpha + beta + 2 * delta, off_diagonal, off_diagonal, beta * torch.ones_like(delta)],
            -1,
        ).unflatten(-1, (2, 2))

    @override
    def potential(self, q: Float[Tensor, "batch 2"]) -> Float[Tensor, " batch"]:
        shoulder = self.mass_1 * self.centre_1 + self.mass_2 * self.length_1
        elbow = self.mass_2 * self.centre_2
        return -self.gravity * (shoulder * q[:, 0].cos() + elbow * q.sum(-1).cos())

    @property
    @override
    def linkage(self) -> Linkage:
        far, near, next_ = (float(x) for x in (self.length_1, self.centre_1, self.centre_2))
        first = link("theta_1", float(self.mass_1), (0.0, 0.0, -near), (float(self.inertia_1),) * 3)
        second = link(
            "theta_2",
            float(self.mass_2),
            (0.0, 0.0, -far - next_),
            (float(self.inertia_2),) * 3,
            anchor=(0.0, 0.0, -far),
            parent=0,
        )
        return Linkage((first, second), (0.0, 0.0, -float(self.gravity)), torch.eye(2).double())

    @override
    def skeleton(self, q: Float[Tensor, " 2"]) -> Skeleton:
        first, second = q[0], q[0] + q[1]
        elbow = self.length_1 * torch.stack([first.sin(), -first.cos()])
        tip = elbow + self.length_2 * torch.stack([second.sin(), -second.cos()])
        points = torch.stack([torch.zeros_like(tip), elbow, tip])
        return Skeleton(points, links=((0, 1), (1, 2)), reach=self.length_1 + self.length_2)
