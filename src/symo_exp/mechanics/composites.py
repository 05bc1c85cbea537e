"""Closed-form derivatives of the Lagrangian of rigid bodies on hinges and slides.

A joint ``i`` carries the bodies after it, whose poses ``X_b`` it changes by its twist
``Ξᵢ = ∂X_b/∂qᵢ X_b⁻¹``. ``Π_b`` is the pseudo-inertia of a body in world axes: its second moments,
mass times centre and mass (Wensing, Kim and Slotine 2018). The inertia follows from composites
``Cᵢ = Σ_b Π_b`` over the bodies that joint ``i`` carries (Featherstone 2008, section 6.2).
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn
from typing_extensions import override

from symo_exp.mechanics.lagrangian import Curvature, Expansion, Gradients, Lagrangian, matvec
from symo_exp.mechanics.rows import Rowwise


class ChainOrder:
    """The order of joints in a chain, where each carries all bodies after it."""

    def outwards(self, x: Float[Tensor, "batch n a b"]) -> Float[Tensor, "batch n a b"]:
        """Return the sums over the bodies that each joint carries."""
        return x.flip(1).cumsum(1).flip(1)

    def inwards(self, x: Float[Tensor, "batch n a b"]) -> Float[Tensor, "batch n a b"]:
        """Return the sums over the joints that carry each body."""
        return x.cumsum(1)

    def behind(self, x: Float[Tensor, "batch n n"]) -> Float[Tensor, "batch n n"]:
        """Return the entries ``(i, j)`` where joint ``j`` carries body ``i``, else zero."""
        return torch.tril(x)


class TreeOrder(ChainOrder):
    """The order of the joints of a tree.

    Args:
        carried: 1 at ``(b, i)`` where joint ``i`` carries body ``b``, its own included; else 0.
    """

    def __init__(self, carried: Float[Tensor, "n n"]) -> None:
        self._carried = carried

    def outwards(self, x: Float[Tensor, "batch n a b"]) -> Float[Tensor, "batch n a b"]:
        """Return the sums over the bodies that each joint carries."""
        return (self._carried.to(x).T @ x.flatten(2)).view_as(x)

    def inwards(self, x: Float[Tensor, "batch n a b"]) -> Float[Tensor, "batch n a b"]:
        """Return the sums over the joints that carry each body."""
        return (self._carried.to(x) @ x.flatten(2)).view_as(x)

    def behind(self, x: Float[Tensor, "batch n n"]) -> Float[Tensor, "batch n n"]:
        """Return the entries ``(i, j)`` where joint ``j`` carries body ``i``, else zero."""
        return x * self._carried.to(x)


class BodyRates(NamedTuple):
    """Rates of moving bodies."""

    velocity: Float[Tensor, "batch n 3 4"]
    """``V_b = Ẋ_b X_b⁻¹``, the sum of ``Ξᵢ vᵢ`` over the joints that carry body ``b``."""
    twists: Float[Tensor, "batch n 3 4"]
    """``Ξ̇ᵢ = [Vᵢ, Ξᵢ]``."""
    momenta: Float[Tensor, "batch n 3 4"]
    """``V_b Π_b``."""
    carried: Float[Tensor, "batch n 3 4"]
    """``Aᵢ``, the sum of ``V_b Π_b`` over the bodies that joint ``i`` carries."""


class Composites(Rowwise):
    """Rigid bodies at a configuration, in world axes, each on a joint of its own.

    ``T = ½ Σ_b ⟨V_b, V_b Π_b⟩ + ½ Σ_i aᵢ vᵢ²`` and ``V = −Σ_b m_b γ · c_b``.

    Args:
        order: Which bodies each joint carries.
        twists: ``Ξᵢ``, without its last row, zero.
        bodies: ``Π_b``.
        rotors: ``aᵢ``, inertia that turns with a joint.
        gravity: ``γ``.
    """

    parts = ("order", "twists", "bodies", "rotors", "gravity", "pushed")

    def __init__(
        self,
        order: ChainOrder,
        twists: Float[Tensor, "batch n 3 4"],
        bodies: Float[Tensor, "batch n 4 4"],
        rotors: Float[Tensor, "batch n"],
        gravity: Float[Tensor, "batch 3"],
    ) -> None:
        self.order, self.twists, self.bodies = order, twists, bodies
        self.rotors, self.gravity = rotors, gravity
        self.pushed = twists @ order.outwards(bodies)
        """``Ξᵢ Cᵢ``."""

    def mass(self) -> Float[Tensor, "batch n n"]:
        """Return ``H``, ``H_ij = ⟨Ξᵢ Cᵢ, Ξⱼ⟩`` where joint ``j`` carries body ``i``."""
        below = self.order.behind(self.pushed.flatten(2) @ self.twists.flatten(2).mT)
        return _symmetric(below) + torch.diag_embed(self.rotors)

    def potential(self) -> Float[Tensor, " batch"]:
        """Return ``−Σ_b m_b γ · c_b``."""
        return -(self.gravity * self.bodies[..., :3, 3].sum(1)).sum(-1)

    def motion(self, v: Float[Tensor, "batch n"]) -> BodyRates:
        """Return the rates of bodies whose joints move."""
        velocity = self.order.inwards(v[..., None, None] * self.twists)
        momenta = velocity @ self.bodies
        return BodyRates(
            velocity, _bracket(velocity, self.twists), momenta, self.order.outwards(momenta)
        )

    def gradients(self, v: Float[Tensor, "batch n"], at: BodyRates) -> Gradients:
        """Return ``∂T/∂qᵢ = ⟨Ξ̇ᵢ, Aᵢ⟩`` with the pull of gravity, and ``pᵢ = ⟨Ξᵢ, Aᵢ⟩ + aᵢ vᵢ``.

        The part ``Ξᵢ V_b`` of ``∂Ẋ_b/∂qᵢ = d/dt(Ξᵢ X_b)`` does no work.
        """
        weight = self.pushed[..., 3]  # of the bodies that a joint moves
        dq = (at.twists * at.carried).sum((-2, -1)) + matvec(weight, self.gravity)
        return Gradients(dq, (self.twists * at.carried).sum((-2, -1)) + self.rotors * v)

    def mass_rate(self, v: Float[Tensor, "batch n"], at: BodyRates) -> Float[Tensor, "batch n"]:
        """Return ``Ḣ v``."""
        turning = self.order.inwards(v[..., None, None] * at.twists)  # V̇_b at constant velocities
        change = turning @ self.bodies
        change = change + at.velocity @ _whole(at.momenta) + at.momenta @ _whole(at.velocity).mT
        moved = at.twists * at.carried + self.twists * self.order.outwards(change)
        return moved.sum((-2, -1))

    def curvature(self, at: BodyRates) -> Curvature:
        """Return the second derivatives.

        Joint ``j`` moves what it carries: ``∂Ξᵢ/∂qⱼ = [Ξⱼ, Ξᵢ]`` and ``∂Π_b/∂qⱼ = Ξⱼ Π_b + Π_b
        Ξⱼᵀ`` for joints ``i`` and bodies ``b`` behind it, and the linear part ``Ωⱼ`` of a twist is
        skew. With ``Sᵢ = Ξ̇ᵢ Cᵢ + Aᵢ Ξᵢᵀ + Ωᵢ Aᵢ`` and the last column ``wᵢ`` of ``Ξᵢ Cᵢ`` follow

            ∂²ℒ/∂qᵢ∂qⱼ = ⟨Sᵢ, Ξ̇ⱼ⟩ + γ · Ωⱼ wᵢ    where j carries i,
            ∂pᵢ/∂qⱼ = ⟨Ξᵢ Cᵢ, Ξ̇ⱼ⟩    where j carries i,    ⟨Ξᵢ, Sⱼ⟩    where i carries j.
        """
        turns = self.twists[..., :3]
        lever = nn.functional.pad(at.carried @ self.twists.mT, (0, 1))
        sums = at.twists @ self.order.outwards(self.bodies) + lever + turns @ at.carried
        weight = turns.mT @ self.gravity[:, None, :, None]  # Ωⱼᵀ γ
        qq = sums.flatten(2) @ at.twists.flatten(2).mT + self.pushed[..., 3] @ weight.squeeze(3).mT
        below = self.pushed.flatten(2) @ at.twists.flatten(2).mT
        above = self.twists.flatten(2) @ sums.flatten(2).mT
        vq = self.order.behind(below) + _strict(self.order.behind(above.mT)).mT
        return Curvature(_symmetric(self.order.behind(qq)), vq, vq.mT)


class BodiesExpansion(Expansion):
    """``ℒ`` of rigid bodies around ``(q, v)``.

    Args:
        lagrangian: ``ℒ``.
        at: The bodies at ``q``.
        motion: Their rates.
        v: Velocities.
        springs: Forces and stiffness of springs of the joints, (batch, n) each.
    """

    parts = ("_lagrangian", "_at", "_motion", "_springs", "values")

    def __init__(
        self,
        lagrangian: Lagrangian,
        at: Composites,
        motion: BodyRates,
        v: Float[Tensor, "batch n"],
        springs: tuple[Tensor, Tensor] | None = None,
    ) -> None:
        self._lagrangian, self._at, self._motion, self._springs = lagrangian, at, motion, springs
        with torch.no_grad():
            self.values = at.gradients(v, motion)
            if springs is not None:
                self.values = self.values._replace(q=self.values.q + springs[0])

    @override
    @torch.no_grad()
    def mass(self) -> Tensor:
        return self._at.mass()

    @override
    @torch.no_grad()
    def curvature(self, before: Expansion | None = None) -> Curvature:
        found = self._at.curvature(self._motion)
        if self._springs is None:
            return found
        return found._replace(qq=found.qq - torch.diag_embed(self._springs[1]))


def _strict(lower: Float[Tensor, "batch n n"]) -> Float[Tensor, "batch n n"]:
    """Return a matrix without its diagonal."""
    return lower - torch.diag_embed(lower.diagonal(dim1=1, dim2=2))


def _symmetric(lower: Float[Tensor, "batch n n"]) -> Float[Tensor, "batch n n"]:
    """Return the symmetric matrix of a triangle."""
    return lower + _strict(lower).mT


def _whole(x: Float[Tensor, "*batch 3 4"]) -> Float[Tensor, "*batch 4 4"]:
    """Append the last row, zero."""
    return torch.cat((x, torch.zeros_like(x[..., :1, :])), dim=-2)


def _bracket(
    a: Float[Tensor, "*batch 3 4"], b: Float[Tensor, "*batch 3 4"]
) -> Float[Tensor, "*batch 3 4"]:
    """Return ``A B − B A``."""
    return a[..., :3] @ b - b[..., :3] @ a
