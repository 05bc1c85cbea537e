"""The cartpole: a rod that balances on a cart driven along a rail."""

from __future__ import annotations

from typing import final

import torch
from jaxtyping import Float
from torch import Tensor

from symo_exp.mechanics.types import Coordinates
from symo_exp.systems.base import SamplingBox, Skeleton, System

BOX = SamplingBox(q=((-0.5, 0.5), (-3.14, 3.14)), v=((-0.05, 0.05), (-3.0, 3.0)), u=((-2.0, 2.0),))


@final
class Cartpole(System):
    """Uniform rod of length ``2 L`` hinged on a cart, ``θ = 0`` upright, force ``u`` on the cart::

        H = [[m_c + m_p, m_p L cos θ], [m_p L cos θ, 4/3 m_p L²]],    V = m_p g L cos θ

    without friction (thesis B.3; Florian, "Correct equations for the dynamics of the cart-pole
    system", 2007). The pole's end is at ``x + 2 L sin θ``. ``B = [1, 0]ᵀ``.

    Parameters: ``gravity`` g [m/s²], ``mass_cart`` m_c [kg], ``mass_pole`` m_p [kg],
    ``half_length`` L, from the hinge to the pole's centre of mass [m].
    """

    def __init__(
        self,
        *,
        time_step: float = 0.05,
        gravity: float = 9.8,
        mass_cart: float = 1.0,
        mass_pole: float = 0.1,
        half_length: float = 0.5,
        box: SamplingBox = BOX,
    ) -> None:
        super().__init__(
            coordinates=Coordinates(names=("x", "theta"), angular=(False, True)),
            input_matrix=[[1.0], [0.0]],
            time_step=time_step,
            parameters={
                "gravity": (gravity, "m/s^2"),
                "mass_cart": (mass_cart, "kg"),
                "mass_pole": (mass_pole, "kg"),
                "half_length": (half_length, "m"),
            },
            box=box,
        )
        self.gravity, self.half_length = gravity, half_length
        self.mass_cart, self.mass_pole = mass_cart, mass_pole

    def mass_matrix(self, q: Float[Tensor, "batch 2"]) -> Float[Tensor, "batch 2 2"]:
        coupling = self.mass_pole * self.half_length * q[:, 1].cos()
        total = torch.full_like(coupling, self.mass_cart + self.mass_pole)
        pole = torch.full_like(coupling, 4 / 3 * self.mass_pole * self.half_length**2)
        return torch.stack([total, coupling, coupling, pole], -1).unflatten(-1, (2, 2))

    def potential(self, q: Float[Tensor, "batch 2"]) -> Float[Tensor, " batch"]:
        return self.mass_pole * self.gravity * self.half_length * q[:, 1].cos()

    def skeleton(self, q: Float[Tensor, " 2"]) -> Skeleton:
        cart = torch.stack([q[0], torch.zeros_like(q[0])])
        tip = cart + 2 * self.half_length * torch.stack([q[1].sin(), q[1].cos()])
        return Skeleton(
            torch.stack([cart, tip]), links=((0, 1),), carts=(0,), reach=2 * self.half_length
        )
