"""Lagrangians with a further generalised force, and their expansions."""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar

import torch
from jaxtyping import Float
from torch import Tensor, nn
from typing_extensions import override

from symo_exp.mechanics.lagrangian import Expansion, Gradients, Lagrangian, Rates
from symo_exp.mechanics.space import Space


class ForcedLagrangian(nn.Module, Lagrangian):
    """A Lagrangian whose ``∂ℒ/∂q`` has a further force; energy and inertia are its own.

    Args:
        conservative: The Lagrangian without the force.
    """

    expansion: ClassVar[type[ForcedExpansion]]
    """Its expansions."""

    def __init__(self, conservative: Lagrangian) -> None:
        super().__init__()
        self.conservative = conservative

    @abstractmethod
    def further_force(
        self, q: Float[Tensor, "batch N"], v: Float[Tensor, "batch n"]
    ) -> Float[Tensor, "batch n"]:
        """Return the force [N, N m], differentiable in both."""

    @property
    @override
    def space(self) -> Space:
        return self.conservative.space

    @override
    def input_force(self, input_matrix: Tensor, q: Tensor, u: Tensor) -> Tensor:
        return self.conservative.input_force(input_matrix, q, u)

    @override
    def mass_matrix(self, q: Float[Tensor, "batch N"]) -> Float[Tensor, "batch n n"]:
        return self.conservative.mass_matrix(q)

    @override
    def potential(self, q: Float[Tensor, "batch N"]) -> Float[Tensor, " batch"]:
        return self.conservative.potential(q)

    @override
    def gradients(self, q: Float[Tensor, "batch N"], v: Float[Tensor, "batch n"]) -> Gradients:
        dq, p = self.conservative.gradients(q, v)
        return Gradients(dq + self.further_force(q, v), p)

    @override
    def rates(self, q: Float[Tensor, "batch N"], v: Float[Tensor, "batch n"]) -> Rates:
        rates = self.conservative.rates(q, v)
        return rates._replace(q=rates.q + self.further_force(q, v))

    @override
    def expand(self, q: Float[Tensor, "batch N"], v: Float[Tensor, "batch n"]) -> Expansion:
        q, v = q.detach(), v.detach()
        return self.expansion(self, self.conservative.expand(q, v), q, v)


class ForcedExpansion(Expansion):
    """A Lagrangian with a further force around ``(q, v)``; a subclass adds the second derivatives.

    Args:
        lagrangian: The Lagrangian with the force.
        at: The Lagrangian without it, expanded.
        q: Configurations.
        v: Velocities.
    """

    parts = ("lagrangian", "at", "q", "v", "values")

    def __init__(self, lagrangian: ForcedLagrangian, at: Expansion, q: Tensor, v: Tensor) -> None:
        self.lagrangian, self.at, self.q, self.v = lagrangian, at, q, v
        with torch.no_grad():
            self.values = self._with_force(at.values, q, v)

    def _with_force(self, gradients: Gradients, q: Tensor, v: Tensor) -> Gradients:
        return Gradients(gradients.q + self.lagrangian.further_force(q, v), gradients.v)

    @override
    def mass(self) -> Tensor:
        return self.at.mass()

    @override
    def gradients(self, q: Tensor, v: Tensor) -> Gradients:
        return self._with_force(self.at.gradients(q, v), q, v)
