"""The learned Lagrangian of a chain of rigid bodies, each on a joint of the previous one."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn
from typing_extensions import override

from symo_exp.checks import real
from symo_exp.errors import ConfigError
from symo_exp.mechanics.lagrangian import (
    Curvature,
    Expansion,
    Gradients,
    Lagrangian,
    Rates,
    matvec,
)
from symo_exp.mechanics.space import cross
from symo_exp.mechanics.types import Coordinates
from symo_exp.nets.affine import repeated
from symo_exp.nets.embedding import require_flat
from symo_exp.nets.triangle import Triangle

PLACE = 0.1
"""Distances of joints at the start of training [m]."""


class _Chain(NamedTuple):
    """A chain at a configuration, in world axes."""

    twists: Float[Tensor, "batch n 3 4"]
    """``Ξᵢ = ∂X/∂qᵢ X⁻¹``, without its last row, zero."""
    bodies: Float[Tensor, "batch n 4 4"]
    """``Π_b = X_b Λ_b Λ_bᵀ X_bᵀ``."""
    pushed: Float[Tensor, "batch n 3 4"]
    """``Ξᵢ Cᵢ`` of the bodies that joint ``i`` carries, ``Cᵢ = Σ_{b ≥ i} Π_b``."""
    rotors: Float[Tensor, "batch n"]
    """``aᵢ²``."""
    gravity: Float[Tensor, "batch 3"]

    def mass(self) -> Float[Tensor, "batch n n"]:
        """Return ``H``, ``H_ij = ⟨Ξᵢ, Ξⱼ Cⱼ⟩`` for ``i ≤ j``, with the rotors."""
        upper = torch.triu(self.twists.flatten(2) @ self.pushed.flatten(2).mT)
        return upper + torch.triu(upper, 1).mT + torch.diag_embed(self.rotors)

    def potential(self) -> Float[Tensor, " batch"]:
        """Return ``−Σ_b m_b γ · c_b``."""
        return -(self.gravity * self.bodies[..., :3, 3].sum(1)).sum(-1)

    def rates(self, v: Float[Tensor, "batch n"]) -> _Rates:
        motion = (v[..., None, None] * self.twists).cumsum(1)
        momenta = motion @ self.bodies
        return _Rates(motion, _bracket(motion, self.twists), momenta, _outwards(momenta))

    def gradients(self, v: Float[Tensor, "batch n"], at: _Rates) -> Gradients:
        """Return ``∂T/∂qᵢ = ⟨Ξ̇ᵢ, Aᵢ⟩`` and ``pᵢ = ⟨Ξᵢ, Aᵢ⟩``, ``Aᵢ = Σ_{b ≥ i} V_b Π_b``."""
        weight = self.pushed[..., 3]  # of the bodies that a joint moves
        dq = (at.twists * at.carried).sum((-2, -1)) + matvec(weight, self.gravity)
        return Gradients(dq, (self.twists * at.carried).sum((-2, -1)) + self.rotors * v)

    def curvature(self, at: _Rates) -> Curvature:
        """Return the second derivatives.

        Joint ``j`` moves what it carries, ``∂Ξᵢ/∂qⱼ = [Ξⱼ, Ξᵢ]`` and ``∂Π_b/∂qⱼ = Ξⱼ Π_b + Π_b
        Ξⱼᵀ`` for ``j ≤ i, b``, and the linear part ``Ωⱼ`` of a twist is skew. With
        ``Sᵢ = Ξ̇ᵢ Cᵢ + Aᵢ Ξᵢᵀ + Ωᵢ Aᵢ`` and the last column ``wᵢ`` of ``Ξᵢ Cᵢ`` follow

            ∂²ℒ/∂qᵢ∂qⱼ = ⟨Sᵢ, Ξ̇ⱼ⟩ + γ · Ωⱼ wᵢ    for j ≤ i,
            ∂pᵢ/∂qⱼ = ⟨Ξᵢ Cᵢ, Ξ̇ⱼ⟩    for j ≤ i,    ⟨Ξᵢ, Sⱼ⟩    for j > i.
        """
        turns = self.twists[..., :3]
        lever = nn.functional.pad(at.carried @ self.twists.mT, (0, 1))
        sums = at.twists @ _outwards(self.bodies) + lever + turns @ at.carried
        weight = turns.mT @ self.gravity[:, None, :, None]  # Ωⱼᵀ γ
        qq = sums.flatten(2) @ at.twists.flatten(2).mT + self.pushed[..., 3] @ weight.squeeze(3).mT
        below = self.pushed.flatten(2) @ at.twists.flatten(2).mT
        above = self.twists.flatten(2) @ sums.flatten(2).mT
        vq = torch.tril(below) + torch.triu(above, 1)
        return Curvature(torch.tril(qq) + torch.tril(qq, -1).mT, vq, vq.mT)


class _Rates(NamedTuple):
    """Rates of a moving chain."""

    motion: Float[Tensor, "batch n 3 4"]
    """``V_b = Ẋ_b X_b⁻¹ = Σ_{i ≤ b} Ξᵢ vᵢ``."""
    twists: Float[Tensor, "batch n 3 4"]
    """``Ξ̇ᵢ = [Vᵢ, Ξᵢ]``."""
    momenta: Float[Tensor, "batch n 3 4"]
    """``V_b Π_b``."""
    carried: Float[Tensor, "batch n 3 4"]
    """``Σ_{b ≥ i} V_b Π_b``."""


class RigidChain(nn.Module, Lagrangian):
    """``T = ½ Σ_b ‖Ẋ_b Λ_b‖² + ½ Σ_i (aᵢ vᵢ)²`` and ``V = −Σ_b m_b γ · c_b``, learned.

    ``X_b(q)``, a rotation and a place, takes body ``b`` to the world,
    ``X_b = X_{b−1} Trans(r_b) exp(ω_b q_b)``: hinges turn about a unit axis and slides go along
    it. ``Λ_b Λ_bᵀ``, 4 x 4, is the body's pseudo-inertia, its second moments, mass times centre
    and mass (Wensing, Kim and Slotine 2018), so that every ``Λ_b`` is a possible body. ``aᵢ`` are
    rotors that turn with a joint. Axes, places ``r``, ``Λ``, ``a`` and the gravity ``γ`` are
    parameters, 17 for each joint and 3, which is exact for every open chain without branches, in
    space or in a plane. Frames are parallel at the configuration zero.

    Training finds the truth from most starts if ``axes`` are correct to about 15 degrees, from one
    in three if they are random; otherwise it ends far from it, often with an immovable joint.

    ``H`` is computed from composites (Featherstone 2008, section 6.2). ``∂T/∂qᵢ`` follows from
    ``∂Ẋ_b/∂qᵢ = d/dt(Ξᵢ X_b)``, whose part ``Ξᵢ V_b`` does no work.

    Args:
        coordinates: The coordinates; angles are hinges, others slides.
        initial_inertia: Inertia at the start of training [kg, kg m²].
        axes: Initial axes, three numbers for each joint; random if null.
    """

    turns: Tensor

    def __init__(
        self,
        *,
        coordinates: Coordinates,
        initial_inertia: float | None = 1.0,
        axes: Any = None,
    ) -> None:
        super().__init__()
        if initial_inertia is not None:
            real("lagrangian.initial_inertia", initial_inertia, above=0)
        require_flat(coordinates, "lagrangian=rigid", "lagrangian=network or rigid_body")
        n = coordinates.n
        self.register_buffer("turns", torch.tensor(coordinates.angular), persistent=False)
        self._turns = tuple(coordinates.angular)  # to branch on while a step is traced
        self._triangle = Triangle(4)
        root = 0.5 * math.sqrt(initial_inertia or 1.0)
        moments = 0.1 * root * torch.randn(n, self._triangle.entries)
        moments[:, self._triangle.flat(torch.eye(4)).bool()] += root
        self.axes = nn.Parameter(_directions(axes, n).flatten())
        self.places = nn.Parameter(PLACE * torch.randn(3 * n))
        self.moments = nn.Parameter(moments.flatten())
        self.rotors = nn.Parameter(torch.full((n,), 0.5 * root))
        self.gravity = nn.Parameter(torch.tensor([0.0, 0.0, -9.81]))

    @override
    def mass_matrix(self, q: Float[Tensor, "batch n"]) -> Float[Tensor, "batch n n"]:
        return self._at(q).mass()

    @override
    def potential(self, q: Float[Tensor, "batch n"]) -> Float[Tensor, " batch"]:
        return self._at(q).potential()

    @override
    def gradients(self, q: Float[Tensor, "batch n"], v: Float[Tensor, "batch n"]) -> Gradients:
        at = self._at(q)
        return at.gradients(v, at.rates(v))

    @override
    @torch.no_grad()
    def expand(self, q: Float[Tensor, "batch n"], v: Float[Tensor, "batch n"]) -> Expansion:
        chain = self._at(q)
        return RigidChainExpansion(self, chain, chain.rates(v), v)

    @override
    def rates(self, q: Float[Tensor, "batch n"], v: Float[Tensor, "batch n"]) -> Rates:
        chain = self._at(q)
        at = chain.rates(v)
        turning = (v[..., None, None] * at.twists).cumsum(1)  # of V_b, at constant velocities
        change = turning @ chain.bodies
        change = change + at.motion @ _whole(at.momenta) + at.momenta @ _whole(at.motion).mT
        moved = (at.twists * at.carried + chain.twists * _outwards(change)).sum((-2, -1))
        return Rates(chain.mass(), moved, chain.gradients(v, at).q)

    def factors(self) -> Float[Tensor, "n 4 4"]:
        """Return ``Λ`` of each body."""
        return self._triangle.square(self.moments.view(len(self.rotors), -1))

    def _at(self, q: Tensor) -> _Chain:
        batch, n = q.shape
        axes = repeated(self.axes, batch).unflatten(1, (n, 3))
        axes = axes / axes.norm(dim=-1, keepdim=True)
        places = repeated(self.places, batch).unflatten(1, (n, 3))
        factors = self._triangle.square(repeated(self.moments, batch).unflatten(1, (n, -1)))
        relative = _rotation(axes, q * self.turns)
        turn, at = torch.eye(3).to(q).expand(batch, 3, 3), torch.zeros_like(places[:, 0])
        turns, points, world = [], [], []
        for i in range(n):
            at = at + matvec(turn, places[:, i])
            axis = matvec(turn, axes[:, i])
            points.append(at)
            world.append(axis)
            if self._turns[i]:
                turn = turn @ relative[:, i]
            else:
                at = at + q[:, i : i + 1] * axis
            turns.append(torch.cat((turn, at.unsqueeze(-1)), dim=-1))
        anchors, axis = torch.stack(points, 1), torch.stack(world, 1)
        hinge = self.turns.to(q)[:, None]
        about = torch.linalg.cross(anchors, hinge * axis) + (1.0 - hinge) * axis
        twists = torch.cat((cross(hinge * axis), about.unsqueeze(-1)), dim=-1)
        above = torch.stack(turns, 1) @ factors
        weighted = torch.cat((above, factors[..., 3:, :]), dim=-2)
        bodies, own = weighted @ weighted.mT, repeated(self.rotors, batch).square()
        pushed = twists @ _outwards(bodies)
        return _Chain(twists, bodies, pushed, own, repeated(self.gravity, batch))


class RigidChainExpansion(Expansion):
    """``ℒ`` of a chain around ``(q, v)``."""

    parts = ("_lagrangian", "_chain", "_rates", "_v")

    def __init__(self, lagrangian: RigidChain, chain: _Chain, rates: _Rates, v: Tensor) -> None:
        self._lagrangian, self._chain, self._rates, self._v = lagrangian, chain, rates, v
        with torch.no_grad():
            self.values = chain.gradients(v, rates)

    @override
    @torch.no_grad()
    def mass(self) -> Tensor:
        return self._chain.mass()

    @override
    @torch.no_grad()
    def curvature(self, before: Expansion | None = None) -> Curvature:
        return self._chain.curvature(self._rates)

    @override
    def gradients(self, q: Tensor, v: Tensor) -> Gradients:
        return self._lagrangian.gradients(q, v)


def _directions(given: Any, n: int) -> Float[Tensor, "n 3"]:
    """Return the given axes, or random ones."""
    if given is None:
        return torch.randn(n, 3)
    listed = [list(row) if isinstance(row, Sequence) else [] for row in given]
    if len(listed) == n and all(len(row) == 3 for row in listed):
        found = torch.tensor(listed, dtype=torch.get_default_dtype())
        if bool(found.isfinite().all()) and bool(found.norm(dim=1).min() > 0.0):
            return found
    raise ConfigError(
        f"lagrangian.axes={given}: expected {n} rows of three numbers, one of them not 0, "
        "as [[0,0,1],[0,1,0]]"
    )


def _outwards(x: Float[Tensor, "batch n a b"]) -> Float[Tensor, "batch n a b"]:
    """Return the sums over a body and the bodies that it carries."""
    return x.flip(1).cumsum(1).flip(1)


def _whole(x: Float[Tensor, "*batch 3 4"]) -> Float[Tensor, "*batch 4 4"]:
    """Append the last row, zero."""
    return torch.cat((x, torch.zeros_like(x[..., :1, :])), dim=-2)


def _bracket(
    a: Float[Tensor, "*batch 3 4"], b: Float[Tensor, "*batch 3 4"]
) -> Float[Tensor, "*batch 3 4"]:
    """Return ``A B − B A``."""
    return a[..., :3] @ b - b[..., :3] @ a


def _rotation(
    axes: Float[Tensor, "batch n 3"], angles: Float[Tensor, "batch n"]
) -> Float[Tensor, "batch n 3 3"]:
    """Return rotations by Rodrigues' formula."""
    across, angle = cross(axes), angles[..., None, None]
    return torch.eye(3).to(axes) + angle.sin() * across + (1.0 - angle.cos()) * (across @ across)
