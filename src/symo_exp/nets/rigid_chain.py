"""The learned Lagrangian of a chain of rigid bodies, each on a joint of the previous one."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn
from typing_extensions import override

from symo_exp.checks import real
from symo_exp.errors import ConfigError
from symo_exp.mechanics.composites import BodiesExpansion, ChainOrder, Composites
from symo_exp.mechanics.lagrangian import Expansion, Gradients, Lagrangian, Rates, matvec
from symo_exp.mechanics.space import cross
from symo_exp.mechanics.types import Coordinates
from symo_exp.nets.affine import repeated
from symo_exp.nets.embedding import require_flat
from symo_exp.nets.triangle import Triangle

PLACE = 0.1
"""Distances of joints at the start of training [m]."""
CHAIN = ChainOrder()


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

    Derivatives are those of ``mechanics.composites``.

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
        return at.gradients(v, at.motion(v))

    @override
    @torch.no_grad()
    def expand(self, q: Float[Tensor, "batch n"], v: Float[Tensor, "batch n"]) -> Expansion:
        at = self._at(q)
        return BodiesExpansion(self, at, at.motion(v), v)

    @override
    def rates(self, q: Float[Tensor, "batch n"], v: Float[Tensor, "batch n"]) -> Rates:
        at = self._at(q)
        motion = at.motion(v)
        return Rates(at.mass(), at.mass_rate(v, motion), at.gradients(v, motion).q)

    def factors(self) -> Float[Tensor, "n 4 4"]:
        """Return ``Λ`` of each body."""
        return self._triangle.square(self.moments.view(len(self.rotors), -1))

    def _at(self, q: Tensor) -> Composites:
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
        return Composites(CHAIN, twists, bodies, own, repeated(self.gravity, batch))


def _directions(given: Any, n: int) -> Float[Tensor, "n 3"]:
    """Return the given axes, or random ones."""
    if given is None:
        return torch.randn(n, 3)
    rows = given if isinstance(given, Sequence) else ()
    listed = [list(row) if isinstance(row, Sequence) else [] for row in rows]
    numbers = all(isinstance(x, int | float) for row in listed for x in row)
    if len(listed) == n and numbers and all(len(row) == 3 for row in listed):
        found = torch.tensor(listed, dtype=torch.get_default_dtype())
        if bool(found.isfinite().all()) and bool(found.norm(dim=1).min() > 0.0):
            return found
    raise ConfigError(
        f"lagrangian.axes={given}: expected {n} rows of three numbers, one of them not 0, "
        "as [[0,0,1],[0,1,0]]"
    )


def _rotation(
    axes: Float[Tensor, "batch n 3"], angles: Float[Tensor, "batch n"]
) -> Float[Tensor, "batch n 3 3"]:
    """Return rotations by Rodrigues' formula."""
    across, angle = cross(axes), angles[..., None, None]
    return torch.eye(3).to(axes) + angle.sin() * across + (1.0 - angle.cos()) * (across @ across)
