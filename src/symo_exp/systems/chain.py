"""A chain of pendulums with any number of links."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from math import pi
from typing import Annotated, Any, final

import torch
from jaxtyping import Float
from torch import Tensor
from typing_extensions import override

from symo_exp.checks import whole_number
from symo_exp.mechanics.bodies import link
from symo_exp.mechanics.types import Coordinates
from symo_exp.systems.base import LagrangianSystem, Linkage, Skeleton
from symo_exp.systems.box import SamplingBox, completed


@final
@dataclass(frozen=True)
class ChainPendulum(LagrangianSystem):
    """``links`` point masses ``m`` on massless rods of length ``l``, hanging one below the other.

    ``θᵢ`` is the absolute angle of rod i, 0 hanging. With ``μᵢⱼ = m (links − max(i, j))``,
    counting from 0::

        Hᵢⱼ = μᵢⱼ l² cos(θᵢ − θⱼ),        V = −Σᵢ μᵢᵢ g l cos θᵢ

    Motors sit in the joints: ``uⱼ`` turns rod j against rod j−1, so ``B = I − shift``. Motions
    start within a quarter turn [rad], speeds and inputs within ±1, unless ``box`` says otherwise.
    """

    links: int = 3
    gravity: Annotated[float, "m/s^2"] = 9.81
    mass: Annotated[float, "kg"] = 1.0
    length: Annotated[float, "m"] = 1.0
    time_step: float = field(default=0.05, kw_only=True)
    box: Any = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        whole_number("system.links", self.links, high=1000)
        sides = {"q": (-pi / 2, pi / 2), "v": (-1.0, 1.0), "u": (-1.0, 1.0)}
        box = SamplingBox(**{name: (side,) * self.links for name, side in sides.items()})
        vars(self)["box"] = completed(self.box, box)
        super().__post_init__()

    @property
    @override
    def coordinates(self) -> Coordinates:
        names = tuple(f"theta_{i + 1}" for i in range(self.links))
        return Coordinates(names=names, angular=(True,) * self.links)

    @cached_property
    @override
    def input_matrix(self) -> Tensor:
        eye = torch.eye(self.links, dtype=torch.float64)
        return eye - torch.diag(torch.ones(self.links - 1, dtype=torch.float64), 1)

    @cached_property
    def _carried(self) -> Tensor:
        index = torch.arange(self.links, dtype=torch.float64)
        return self.mass * (self.links - torch.maximum(index[:, None], index[None, :]))

    @override
    def mass_matrix(self, q: Float[Tensor, "batch n"]) -> Float[Tensor, "batch n n"]:
        angle = q.unsqueeze(-1) - q.unsqueeze(-2)
        return self._carried.to(q) * self.length**2 * angle.cos()

    @override
    def potential(self, q: Float[Tensor, "batch n"]) -> Float[Tensor, " batch"]:
        weight = self._carried.diagonal().to(q) * self.gravity * self.length
        return -(weight * q.cos()).sum(-1)

    @property
    def linkage(self) -> Linkage:
        """In angles between neighbours, ``θᵢ − θᵢ₋₁``."""
        mass, length = float(self.mass), float(self.length)
        links = tuple(
            link(
                f"joint_{i + 1}",
                mass,
                (0.0, 0.0, -length * (i + 1)),
                anchor=(0.0, 0.0, -length * i),
                parent=i - 1,
            )
            for i in range(self.links)
        )
        apart = torch.eye(self.links) - torch.diag(torch.ones(self.links - 1), -1)
        return Linkage(links, (0.0, 0.0, -float(self.gravity)), apart.double())

    @override
    def skeleton(self, q: Float[Tensor, " n"]) -> Skeleton:
        rods = self.length * torch.stack([q.sin(), -q.cos()], -1)
        points = torch.cat([torch.zeros_like(rods[:1]), rods.cumsum(0)])
        links = tuple((i, i + 1) for i in range(len(q)))
        return Skeleton(points, links=links, reach=self.length * len(q))
