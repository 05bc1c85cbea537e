"""A chain of pendulums with any number of links: the test system for n = 1, 2, 3 and beyond."""

from __future__ import annotations

from math import pi
from typing import final

import torch
from jaxtyping import Float
from torch import Tensor

from symo_exp.mechanics.types import Coordinates
from symo_exp.systems.base import SamplingBox, Skeleton, System


@final
class ChainPendulum(System):
    """``links`` point masses ``m`` on massless rods of length ``l``, hanging one below the other.

    ``θᵢ`` is the absolute angle of rod i, 0 hanging. With ``μᵢⱼ = m (links − max(i, j))``,
    counting from 0::

        Hᵢⱼ = μᵢⱼ l² cos(θᵢ − θⱼ),        V = −Σᵢ μᵢᵢ g l cos θᵢ

    Motors sit in the joints: ``uⱼ`` turns rod j against rod j−1, so ``B = I − shift``.
    """

    def __init__(
        self,
        links: int = 3,
        *,
        time_step: float = 0.05,
        gravity: float = 9.81,
        mass: float = 1.0,
        length: float = 1.0,
    ) -> None:
        names = tuple(f"theta_{i + 1}" for i in range(links))
        eye = torch.eye(links)
        super().__init__(
            coordinates=Coordinates(names=names, angular=(True,) * links),
            input_matrix=(eye - torch.diag(torch.ones(links - 1), 1)).tolist(),
            time_step=time_step,
            parameters={
                "gravity": (gravity, "m/s^2"),
                "mass": (mass, "kg"),
                "length": (length, "m"),
            },
            box=SamplingBox(
                q=((-pi / 2, pi / 2),) * links,
                v=((-1.0, 1.0),) * links,
                u=((-1.0, 1.0),) * links,
            ),
        )
        self.gravity, self.mass, self.length = gravity, mass, length
        index = torch.arange(links, dtype=torch.float64)
        self._carried = mass * (links - torch.maximum(index[:, None], index[None, :]))

    def mass_matrix(self, q: Float[Tensor, "batch n"]) -> Float[Tensor, "batch n n"]:
        angle = q.unsqueeze(-1) - q.unsqueeze(-2)
        return self._carried.to(q) * self.length**2 * angle.cos()

    def potential(self, q: Float[Tensor, "batch n"]) -> Float[Tensor, " batch"]:
        weight = self._carried.diagonal().to(q) * self.gravity * self.length
        return -(weight * q.cos()).sum(-1)

    def skeleton(self, q: Float[Tensor, " n"]) -> Skeleton:
        rods = self.length * torch.stack([q.sin(), -q.cos()], -1)
        points = torch.cat([torch.zeros_like(rods[:1]), rods.cumsum(0)])
        links = tuple((i, i + 1) for i in range(len(q)))
        return Skeleton(points, links=links, reach=self.length * len(q))
