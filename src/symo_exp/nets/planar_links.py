"""The learned Lagrangian of rigid links in a plane, with few parameters.

With the directions ``ψ_k`` of the links (zero of slides), ``s`` the directions and the
displacements of slides, and ``R`` the rotation of the plane:

    T = ½ Σ_b |Σ_k R(ψ_k) G_bk ṡ_k|² + ½ Σ_k (o_k ṡ_k)² + ½ Σ_i (ρᵢ q̇ᵢ)²,
    V = Σ_k e · R(ψ_k) w_k + Σ_x f_x s_x.

The velocities of all points of rigid links are of this form, so that ``H_kl`` is a multiple of the
cosine of ``ψ_k − ψ_l`` and a phase; rotors turn with a joint, ``q̇ᵢ = ṡᵢ − ṡᵢ₋₁``. With
``A_bk = R(ψ_k) G_bk``, ``J`` the rotation by 90° and ``h_k = 1`` of hinges and 0 of slides,

    ∂A_bk/∂s_k = h_k J A_bk,

and those in other coordinates vanish. All derivatives below follow.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn
from typing_extensions import override

from symo_exp.checks import real
from symo_exp.mechanics.lagrangian import (
    Curvature,
    Expansion,
    Gradients,
    Lagrangian,
    Rates,
    matvec,
    vecmat,
)
from symo_exp.mechanics.types import Coordinates
from symo_exp.nets.affine import repeated
from symo_exp.nets.embedding import directions, require_flat
from symo_exp.nets.roles import mark, mark_squares

TURNING, UNLIKE, ROTOR, POTENTIAL = 0.01, 0.1, 0.1, 0.01
"""At the start of training: the share of ``o²`` in the inertia, and the sizes of differences of
``G`` from a chain, of ``ρ`` and of ``w``, relative to the inertia or its root."""


class _Links(NamedTuple):
    """Links at a configuration, in the coordinates ``s``.

    Vectors of the plane are stored as their first and then their second components.
    """

    hinges: Float[Tensor, "batch n"]
    """``h``."""
    partials: Float[Tensor, "batch n 2*n"]
    """``A_bk``, a row for each ``k``."""
    turning: Float[Tensor, "batch n n"]
    """``Σ_k o_k² ṡ_k² + Σᵢ ρᵢ² q̇ᵢ²`` as a matrix."""
    potential: Float[Tensor, "batch n"]
    """Terms of ``V``."""
    weight: Float[Tensor, "batch n"]
    """``∂V/∂s``."""

    def mass(self) -> Float[Tensor, "batch n n"]:
        return self.partials @ self.partials.mT + self.turning

    def gradients(self, v: Float[Tensor, "batch n"]) -> Gradients:
        velocities = vecmat(v, self.partials)
        momentum = matvec(self.partials, velocities) + matvec(self.turning, v)
        return Gradients(self._centrifugal(v, velocities) - self.weight, momentum)

    def rates(self, v: Float[Tensor, "batch n"]) -> Rates:
        """Return the terms of the Euler-Lagrange equations.

        ``Σ_k Ȧ_bk ṡ_k = J Σ_k A_bk h_k ṡ_k²``.
        """
        centrifugal = self._centrifugal(v, vecmat(v, self.partials))
        acceleration = _quarter(vecmat(self.hinges * v.square(), self.partials))
        changed = centrifugal + matvec(self.partials, acceleration)
        return Rates(self.mass(), changed, centrifugal - self.weight)

    def curvature(self, v: Float[Tensor, "batch n"]) -> Curvature:
        velocities, turning = vecmat(v, self.partials), self.hinges * v
        slopes = turning.unsqueeze(2) * _quarter(self.partials)
        across = matvec(self.partials, -_quarter(velocities))
        along = matvec(self.partials, velocities)
        vq = self.partials @ slopes.mT + torch.diag_embed(self.hinges * across)
        own = self.hinges * self.potential - turning * along
        return Curvature(slopes @ slopes.mT + torch.diag_embed(own), vq, vq.mT)

    def _centrifugal(
        self, v: Float[Tensor, "batch n"], velocities: Float[Tensor, "batch xy"]
    ) -> Float[Tensor, "batch n"]:
        """Return ``∂T/∂s_k = h_k ṡ_k Σ_b J A_bk · Σ_l A_bl ṡ_l``."""
        return self.hinges * v * matvec(self.partials, -_quarter(velocities))


class PlanarLinks(nn.Module, Lagrangian):
    """Rigid links in a plane, on hinges and slides of directions that do not turn.

    Parameters are the velocities ``G`` of ``n`` points, the roots ``o`` and ``ρ`` of inertias, and
    the potential's ``w``, at most ``2n² + 4n`` numbers. Any have a positive definite inertia.
    Training starts near a chain of equal links with equal masses at their ends, parallel at zero:
    fits from independent links, or with parameters that are shrunk to zero first, take longer or
    end at another minimum.

    Args:
        coordinates: The coordinates; angles are hinges, others slides.
        relative: Whether each angle counts from the link before; else from the world.
        initial_inertia: Inertia near which training starts [kg, kg m²].
    """

    rotors: nn.Parameter | None
    hinges: Tensor
    turn: Tensor
    joints: Tensor

    def __init__(
        self, *, coordinates: Coordinates, relative: bool = True, initial_inertia: float = 1.0
    ) -> None:
        super().__init__()
        real("lagrangian.initial_inertia", initial_inertia, above=0)
        require_flat(coordinates, "lagrangian=planar", "lagrangian=network or rigid_body")
        n, angular = coordinates.n, coordinates.angular
        angles = [i for i in range(n) if angular[i]]
        sums = directions(angular)
        for name, constant in (
            ("hinges", torch.tensor(angular).to(sums)),
            ("turn", sums if relative else torch.eye(n)),  # s = turn q
            ("joints", torch.linalg.inv(sums)[angles[1:]]),  # q̇ᵢ of hinges on another link
        ):
            self.register_buffer(name, constant, persistent=False)
        root = math.sqrt(initial_inertia)
        ends = math.sqrt((1.0 - TURNING) * 2 / (n + 1)) * torch.ones(n, n).triu()
        chain = torch.cat((ends, torch.zeros(n, n)), dim=1).flatten()
        self.points = nn.Parameter(root * (chain + UNLIKE * torch.randn(2 * n * n)))
        self.inertias = nn.Parameter(torch.full((n,), math.sqrt(TURNING) * root))
        self.weights = nn.Parameter(POTENTIAL * initial_inertia * torch.randn(2 * n))
        rotors = torch.full((len(self.joints),), ROTOR * root)
        self.rotors = nn.Parameter(rotors) if len(rotors) else None
        for squared in (self.inertias, self.rotors):
            if squared is not None:
                mark_squares(squared)
        mark(self.parameters(), "coefficient")

    @override
    def mass_matrix(self, q: Float[Tensor, "batch n"]) -> Float[Tensor, "batch n n"]:
        return self.symmetric(self._at(q).mass())

    @override
    def potential(self, q: Float[Tensor, "batch n"]) -> Float[Tensor, " batch"]:
        return self._at(q).potential.sum(1)

    @override
    def gradients(self, q: Float[Tensor, "batch n"], v: Float[Tensor, "batch n"]) -> Gradients:
        dq, dv = self._at(q).gradients(v @ self.turn.T)
        return Gradients(dq @ self.turn, dv @ self.turn)

    @override
    def rates(self, q: Float[Tensor, "batch n"], v: Float[Tensor, "batch n"]) -> Rates:
        mass, changed, dq = self._at(q).rates(v @ self.turn.T)
        return Rates(self.symmetric(mass), changed @ self.turn, dq @ self.turn)

    @override
    @torch.no_grad()
    def expand(self, q: Float[Tensor, "batch n"], v: Float[Tensor, "batch n"]) -> Expansion:
        return PlanarExpansion(self, self._at(q), v @ self.turn.T)

    def products(self) -> Float[Tensor, "n n"]:
        """Return ``Σ_b G_bk · G_bl``, the factors of the cosines in ``H``."""
        points = self.points.view(len(self.inertias), -1)
        return points @ points.T

    def symmetric(self, matrix: Float[Tensor, "batch n n"]) -> Float[Tensor, "batch n n"]:
        """Return a symmetric matrix in the coordinates ``q`` from one in ``s``."""
        found = self.turn.T @ matrix @ self.turn
        return torch.triu(found) + torch.triu(found, 1).mT

    def _at(self, q: Float[Tensor, "batch n"]) -> _Links:
        s = q @ self.turn.T
        (batch, n), hinges = s.shape, self.hinges
        cos, sin = (s * hinges).cos(), (s * hinges).sin()
        points = repeated(self.points, batch).unflatten(1, (n, 2 * n))
        partials = cos.unsqueeze(2) * points + sin.unsqueeze(2) * _quarter(points)
        turning = torch.diag_embed(repeated(self.inertias, batch).square())
        if self.rotors is not None:
            rotors = repeated(self.rotors, batch).square()
            turning = turning + (self.joints.T * rotors.unsqueeze(1)) @ self.joints
        x, y = repeated(self.weights, batch).chunk(2, dim=1)
        turned, across = cos * x - sin * y, -(sin * x + cos * y)
        slid = 1.0 - hinges
        return _Links(
            hinges.expand(batch, n),
            partials,
            turning,
            hinges * turned + slid * x * s,
            hinges * across + slid * x,
        )


class PlanarExpansion(Expansion):
    """``ℒ`` of planar links around ``(q, v)``; ``v`` is that of ``s``."""

    parts = ("_lagrangian", "_links", "_v", "values")
    _lagrangian: PlanarLinks

    def __init__(self, lagrangian: PlanarLinks, links: _Links, v: Tensor) -> None:
        self._lagrangian, self._links, self._v = lagrangian, links, v
        dq, dv = links.gradients(v)
        self.values = Gradients(dq @ lagrangian.turn, dv @ lagrangian.turn)

    @override
    @torch.no_grad()
    def mass(self) -> Tensor:
        return self._lagrangian.symmetric(self._links.mass())

    @override
    @torch.no_grad()
    def curvature(self, before: Expansion | None = None) -> Curvature:
        turn, found = self._lagrangian.turn, self._links.curvature(self._v)
        vq = turn.T @ found.vq @ turn
        return Curvature(self._lagrangian.symmetric(found.qq), vq, vq.mT)


def _quarter(x: Float[Tensor, "*batch xy"]) -> Float[Tensor, "*batch xy"]:
    """Return vectors of the plane turned by 90°."""
    first, second = x.chunk(2, dim=-1)
    return torch.cat((-second, first), dim=-1)
