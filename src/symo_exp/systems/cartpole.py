"""The cartpole: a rod that balances on a cart driven along a rail."""

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
class Cartpole(LagrangianSystem):
    """A uniform rod of length ``2 L`` hinged on a cart, ``θ = 0`` upright, force ``u`` on the cart.

    ::

        H = [[m_c + m_p, m_p L cos θ], [m_p L cos θ, 4/3 m_p L²]],    V = m_p g L cos θ

    without friction (thesis B.3; Florian, "Correct equations for the dynamics of the cart-pole
    system", 2007). The pole's end is at ``x + 2 L sin θ``. ``B = [1, 0]ᵀ``.
    """

    gravity: Annotated[float, "m/s^2"]
    mass_cart: Annotated[float, "kg"]
    mass_pole: Annotated[float, "kg"]
    half_length: Annotated[float, "m"]
    """``L``, from the hinge to the pole's centre of mass."""

    coordinates = Coordinates(names=("x", "theta"), angular=(False, True))
    input_matrix = torch.tensor([[1.0], [0.0]], dtype=torch.float64)

    @override
    def mass_matrix(self, q: Float[Tensor, "batch 2"]) -> Float[Tensor, "batch 2 2"]:
        coupling = self.mass_pole * self.half_length * q[:, 1].cos()
        one = torch.ones_like(coupling)
        total = (self.mass_cart + self.mass_pole) * one
        pole = 4 / 3 * self.mass_pole * self.half_length**2 * one
        return torch.stack([total, coupling, coupling, pole], -1).unflatten(-1, (2, 2))

    @override
    def potential(self, q: Float[Tensor, "batch 2"]) -> Float[Tensor, " batch"]:
        return self.mass_pole * self.gravity * self.half_length * q[:, 1].cos()

    @property
    @override
    def linkage(self) -> Linkage:
        mass, half = float(self.mass_pole), float(self.half_length)
        inertia = mass * half**2 / 3
        cart = link("x", float(self.mass_cart), axis=(1.0, 0.0, 0.0), slides=True)
        pole = link(
            "theta", mass, (0.0, 0.0, half), (inertia, inertia, 0.0), axis=(0.0, 1.0, 0.0), parent=0
        )
        return Linkage((cart, pole), (0.0, 0.0, -float(self.gravity)), torch.eye(2).double())

    @override
    def skeleton(self, q: Float[Tensor, " 2"]) -> Skeleton:
        cart = torch.stack([q[0], torch.zeros_like(q[0])])
        tip = cart + 2 * self.half_length * torch.stack([q[1].sin(), q[1].cos()])
        return Skeleton(
            torch.stack([cart, tip]), links=((0, 1),), carts=(0,), reach=2 * self.half_length
        )
