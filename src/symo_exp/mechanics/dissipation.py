"""Dissipation: generalised forces that never add energy to a system.

With a force ``F_d(q, v)``, ``v · F_d ≤ 0``, the equations of motion are those of d'Alembert,

    d/dt ∂ℒ/∂v − ∂ℒ/∂q = F_d(q, v) + B u

A ``DissipativeLagrangian`` returns ``∂ℒ/∂q + F_d`` for ``∂ℒ/∂q``, which accelerations and discrete
Euler-Lagrange equations then contain.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

import torch
from jaxtyping import Float
from torch import Tensor
from typing_extensions import override

from symo_exp.mechanics.forced import ForcedExpansion, ForcedLagrangian
from symo_exp.mechanics.lagrangian import Curvature, Expansion, Lagrangian, jacobian, matvec
from symo_exp.mechanics.space import space_of


class Dissipation(ABC):
    """A generalised force with ``v · F_d(q, v) ≤ 0``."""

    @abstractmethod
    def force(
        self, q: Float[Tensor, "batch N"], v: Float[Tensor, "batch n"]
    ) -> Float[Tensor, "batch n"]:
        """Return ``F_d(q, v)`` [N or N m], differentiable in both."""

    def derivatives(
        self, q: Float[Tensor, "batch N"], v: Float[Tensor, "batch n"]
    ) -> tuple[Float[Tensor, "batch n n"], Float[Tensor, "batch n n"]]:
        """Return ``∂F_d/∂q`` and ``∂F_d/∂v`` without a graph, by automatic differentiation.

        Those in rotations are along ``Space.retract``.
        """
        with torch.enable_grad():
            at = [x.detach().clone().requires_grad_() for x in (q, v)]
            force = self.force(*at)
            by_q, by_v = (jacobian(force, x).detach() for x in at)
        return space_of(q, v).pull(q.detach().unsqueeze(1), by_q), by_v

    def damping(
        self, q: Float[Tensor, "batch N"], v: Float[Tensor, "batch n"]
    ) -> Float[Tensor, "batch n n"]:
        """Return ``∂F_d/∂v``, or its stiff part, without a graph."""
        return self.derivatives(q, v)[1]

    def chord(
        self, v: Float[Tensor, "batch n"], before: Float[Tensor, "batch n"]
    ) -> Float[Tensor, "batch n n"] | None:
        """Return what is added to ``∂F_d/∂v`` for the slope of the chord from ``before`` to ``v``.

        ``None``: the force does not bend sharply.
        """
        return None


def chord_excess(
    v: Float[Tensor, "batch n"], before: Float[Tensor, "batch n"], rest: Tensor | float
) -> Float[Tensor, "batch n"]:
    """Return the slope of the chord of ``tanh(v / ε_v)`` less its derivative, times ``ε_v``.

    It is at least 0, and 0 where ``v`` changes by less than ``ε_v``.

    Args:
        v: Velocities.
        before: Those from which the chord extends.
        rest: ``ε_v``.
    """
    w, w_before = v / rest, before / rest
    t, change = torch.tanh(w), w - w_before
    excess = (t - torch.tanh(w_before)) / change - (1.0 - t.square())
    return torch.where(change.abs() > 1.0, excess.clamp(min=0.0), 0.0)


class Friction(Dissipation):
    """``F_d = −D v − c ∘ tanh(v / ε_v)``: viscous friction, and dry friction smoothed at rest.

    Args:
        viscous: ``D`` [N m s, N s/m; N s between both], positive semidefinite.
        coulomb: ``c ≥ 0`` [N m, N].
        rest_velocity: ``ε_v > 0`` [rad/s, m/s].
    """

    def __init__(
        self,
        viscous: Float[Tensor, "n n"],
        coulomb: Float[Tensor, " n"],
        rest_velocity: float,
    ) -> None:
        self.viscous, self.coulomb, self.rest_velocity = viscous, coulomb, rest_velocity

    @override
    def force(self, q: Tensor, v: Tensor) -> Tensor:
        dry = self.coulomb.to(v) * torch.tanh(v / self.rest_velocity)
        return -matvec(self.viscous.to(v), v) - dry


class DissipativeExpansion(ForcedExpansion):
    """A Lagrangian and a dissipative force around ``(q, v)``."""

    dissipates = True
    lagrangian: DissipativeLagrangian

    @override
    def curvature(self, before: Expansion | None = None) -> Curvature:
        dissipation = self.lagrangian.dissipation
        force_q, force_v = dissipation.derivatives(self.q, self.v)
        if isinstance(before, DissipativeExpansion):
            chord = dissipation.chord(self.v, before.v)
            force_v = force_v if chord is None else force_v + chord
        qq, vq, qv = self.at.curvature()
        return Curvature(qq + force_q, vq, qv + force_v)

    @override
    def damping(self) -> Tensor:
        return self.lagrangian.dissipation.damping(self.q, self.v)


class DissipativeLagrangian(ForcedLagrangian):
    """A Lagrangian with a dissipation; energy and inertia are those of the Lagrangian alone."""

    expansion = DissipativeExpansion

    def __init__(self, conservative: Lagrangian, dissipation: Dissipation) -> None:
        super().__init__(conservative)
        self.dissipation = dissipation

    @override
    def further_force(self, q: Tensor, v: Tensor) -> Tensor:
        return self.dissipation.force(q, v)
