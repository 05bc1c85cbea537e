"""Dissipation: generalised forces that only ever take energy out of a system.

With a force ``F_d(q, v)``, ``v · F_d ≤ 0``, the equations of motion are those of d'Alembert,

    d/dt ∂ℒ/∂v − ∂ℒ/∂q = F_d(q, v) + B u

and whatever reads ``∂ℒ/∂q`` of a Lagrangian finds ``∂ℒ/∂q + F_d`` there: the acceleration, and at
every Gauss point the discrete Euler-Lagrange equations.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

import torch
from jaxtyping import Float
from torch import Tensor, nn

from symo_exp.mechanics.lagrangian import (
    Curvature,
    Expansion,
    Gradients,
    Lagrangian,
    Rates,
    jacobian,
    matvec,
)


class Dissipation(ABC):
    """A generalised force with ``v · F_d(q, v) ≤ 0``."""

    @abstractmethod
    def force(
        self, q: Float[Tensor, "batch n"], v: Float[Tensor, "batch n"]
    ) -> Float[Tensor, "batch n"]:
        """``F_d(q, v)`` [N or N m], differentiable in both."""

    def derivatives(
        self, q: Float[Tensor, "batch n"], v: Float[Tensor, "batch n"]
    ) -> tuple[Float[Tensor, "batch n n"], Float[Tensor, "batch n n"]]:
        """``∂F_d/∂q`` and ``∂F_d/∂v`` without a graph, by automatic differentiation."""
        with torch.enable_grad():
            q, v = (x.detach().clone().requires_grad_() for x in (q, v))
            force = self.force(q, v)
            return jacobian(force, q).detach(), jacobian(force, v).detach()

    def damping(
        self, q: Float[Tensor, "batch n"], v: Float[Tensor, "batch n"]
    ) -> Float[Tensor, "batch n n"]:
        """``∂F_d/∂v`` without a graph, or what of it may be stiff."""
        return self.derivatives(q, v)[1]


class Friction(Dissipation):
    """``F_d = −D v − c ∘ tanh(v / ε_v)``: viscous friction, and dry friction smoothed at rest."""

    def __init__(
        self,
        viscous: Float[Tensor, "n n"],
        coulomb: Float[Tensor, " n"],
        rest_velocity: float,
    ) -> None:
        """``D`` [N m s] is positive semidefinite, ``c ≥ 0`` [N m], ``ε_v`` [rad/s] positive."""
        self.viscous, self.coulomb, self.rest_velocity = viscous, coulomb, rest_velocity

    def force(self, q: Tensor, v: Tensor) -> Tensor:
        dry = self.coulomb.to(v) * torch.tanh(v / self.rest_velocity)
        return -matvec(self.viscous.to(v), v) - dry


class DissipativeLagrangian(nn.Module, Lagrangian):
    """A Lagrangian with a dissipation; energy and inertia are those of the Lagrangian."""

    def __init__(self, conservative: Lagrangian, dissipation: Dissipation) -> None:
        super().__init__()
        self.conservative, self.dissipation = conservative, dissipation

    def mass_matrix(self, q: Float[Tensor, "batch n"]) -> Float[Tensor, "batch n n"]:
        return self.conservative.mass_matrix(q)

    def potential(self, q: Float[Tensor, "batch n"]) -> Float[Tensor, " batch"]:
        return self.conservative.potential(q)

    def gradients(self, q: Float[Tensor, "batch n"], v: Float[Tensor, "batch n"]) -> Gradients:
        """``∂ℒ/∂q + F_d`` and ``∂ℒ/∂v``."""
        dq, p = self.conservative.gradients(q, v)
        return Gradients(dq + self.dissipation.force(q, v), p)

    def rates(self, q: Float[Tensor, "batch n"], v: Float[Tensor, "batch n"]) -> Rates:
        """``H``, ``Ḣ v`` and ``∂ℒ/∂q + F_d``."""
        rates = self.conservative.rates(q, v)
        return rates._replace(q=rates.q + self.dissipation.force(q, v))

    def expand(self, q: Float[Tensor, "batch n"], v: Float[Tensor, "batch n"]) -> Expansion:
        q, v = q.detach(), v.detach()
        return DissipativeExpansion(self.conservative.expand(q, v), self.dissipation, q, v)


class DissipativeExpansion(Expansion):
    """A Lagrangian around ``(q, v)``, with the force there."""

    dissipates = True
    parts = ("_at", "_dissipation", "_q", "_v")

    def __init__(self, at: Expansion, dissipation: Dissipation, q: Tensor, v: Tensor) -> None:
        self._at, self._dissipation, self._q, self._v = at, dissipation, q, v
        with torch.no_grad():
            force = dissipation.force(q, v)
        self.values = Gradients(at.values.q + force, at.values.v)

    def mass(self) -> Tensor:
        return self._at.mass()

    def curvature(self) -> Curvature:
        force_q, force_v = self._dissipation.derivatives(self._q, self._v)
        qq, vq, qv = self._at.curvature()
        return Curvature(qq + force_q, vq, qv + force_v)

    def damping(self) -> Tensor:
        return self._dissipation.damping(self._q, self._v)

    def gradients(self, q: Tensor, v: Tensor) -> Gradients:
        dq, p = self._at.gradients(q, v)
        return Gradients(dq + self._dissipation.force(q, v), p)
