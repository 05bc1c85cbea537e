"""Lagrangians with a further generalised force."""

from __future__ import annotations

from abc import abstractmethod

from jaxtyping import Float
from torch import Tensor, nn
from typing_extensions import override

from symo_exp.mechanics.lagrangian import Gradients, Lagrangian, Rates
from symo_exp.mechanics.space import Space


class ForcedLagrangian(nn.Module, Lagrangian):
    """A Lagrangian whose ``∂ℒ/∂q`` has a further force; energy and inertia are its own.

    Args:
        conservative: The Lagrangian without the force.
    """

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
