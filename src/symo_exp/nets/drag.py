"""Learned drag of a fluid: on links that move in a plane, and on a body that turns freely."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor, nn
from typing_extensions import override

from symo_exp.checks import real, whole_number
from symo_exp.mechanics.dissipation import Dissipation
from symo_exp.mechanics.lagrangian import matvec, vecmat
from symo_exp.mechanics.rigid_body import in_body, in_world
from symo_exp.mechanics.types import Coordinates
from symo_exp.nets.affine import linear, repeated
from symo_exp.nets.embedding import Features, require_flat, require_one_body
from symo_exp.nets.harmonics import Harmonics
from symo_exp.nets.roles import mark, mark_squares
from symo_exp.nets.triangle import Triangle


class LearnedDrag(nn.Module, Dissipation):
    """``F_d = −Σ_k (ν_k + |s_k|) s_k a_k(q)`` with the speeds ``s_k = a_k(q) · v``, ``ν_k ≥ 0``.

    A body in a fluid at rest is subject to forces linear and quadratic in its speeds along and
    about its axes. In body axes, speeds of points of links in a plane are sums of ``cos`` and
    ``sin`` of directions and of their differences, times velocities: ``a_k`` is affine in the
    harmonics of at most two directions. Coefficients are part of ``a_k``, and a speed ``s_k`` has
    the unit ∛N m^⅓ s^-⅓.

    Args:
        coordinates: The coordinates.
        speeds: Number of speeds, ``2n`` if null; three for each link are enough.
        relative: Whether each angle is relative to the one before.
    """

    def __init__(
        self, *, coordinates: Coordinates, speeds: int | None = None, relative: bool = True
    ) -> None:
        super().__init__()
        require_flat(coordinates, "dissipation=drag", "dissipation=viscous")
        n = coordinates.n
        count = 2 * n if speeds is None else whole_number("dissipation.speeds", speeds)
        self.harmonics = Harmonics(angular=coordinates.angular, order=2, relative=relative)
        self.weight = nn.Parameter(0.1 * torch.randn(count * n, self.harmonics.size))
        self.bias = nn.Parameter(0.3 * torch.randn(count * n))
        self.viscous = nn.Parameter(torch.full((count,), -2.0))
        self._shape = (count, n)
        mark((self.weight, self.bias, self.viscous), "late")

    @override
    def force(
        self, q: Float[Tensor, "batch N"], v: Float[Tensor, "batch n"]
    ) -> Float[Tensor, "batch n"]:
        along = self._along(self.harmonics(q))
        speed = matvec(along, v)
        rate = nn.functional.softplus(repeated(self.viscous, v.shape[0])) + speed.abs()
        return -vecmat(rate * speed, along)

    @torch.no_grad()
    def damping(
        self, q: Float[Tensor, "batch N"], v: Float[Tensor, "batch n"]
    ) -> Float[Tensor, "batch n n"]:
        """Return ``∂F_d/∂v``."""
        along = self._along(self.harmonics(q))
        slope = nn.functional.softplus(self.viscous) + 2.0 * matvec(along, v).abs()
        return -(along.mT * slope.unsqueeze(1)) @ along

    @torch.no_grad()
    def derivatives(
        self, q: Float[Tensor, "batch N"], v: Float[Tensor, "batch n"]
    ) -> tuple[Float[Tensor, "batch n n"], Float[Tensor, "batch n n"]]:
        """Return ``∂F_d/∂q`` and ``∂F_d/∂v`` in closed form."""
        features = self.harmonics(q)
        along = self._along(features)
        turned = self.harmonics.basis_tangents(features) @ self.weight.T
        turned = turned.unflatten(2, self._shape)  # ∂a_k/∂q_i
        speed, viscous = matvec(along, v), nn.functional.softplus(self.viscous)
        slope = viscous + 2.0 * speed.abs()
        by_v = -(along.mT * slope.unsqueeze(1)) @ along
        bent = vecmat(((viscous + speed.abs()) * speed).unsqueeze(1), turned)
        moved = matvec(turned, v.unsqueeze(1)) * slope.unsqueeze(1)
        return -(bent + moved @ along).mT, by_v

    def _along(self, features: Features) -> Float[Tensor, "batch speeds n"]:
        """Return ``a_k``."""
        return linear(features.x, self.weight, self.bias).unflatten(1, self._shape)


class LearnedBodyDrag(nn.Module, Dissipation):
    """``f = −(D + |w| E) w`` of a rigid body, and the same for its torque and body rates.

    ``w`` is the velocity of the body's origin in body axes. The four matrices are positive
    semidefinite, ``U diag(d²) Uᵀ`` with ``U`` unit lower triangular.

    Args:
        coordinates: A rotation, or a position of three lengths and a rotation.
        start: Initial diagonal of the matrices of the force [N s/m, N s²/m²]; those of the torque
            begin with ``start radius²`` [N m s, N m s²].
        radius: Unit of length of the parameters [m], as in ``LearnedRigidBody``.
    """

    units: Tensor

    def __init__(
        self, *, coordinates: Coordinates, start: float = 0.01, radius: float = 1.0
    ) -> None:
        super().__init__()
        require_one_body(coordinates, "dissipation=body_drag", "dissipation=viscous")
        real("dissipation.start", start, above=0)
        real("dissipation.radius", radius, above=0)
        self._triangle = Triangle(3)
        units = torch.ones(coordinates.n // 3, 1, 1)
        units[-1] = radius**2
        self.register_buffer("units", units, persistent=False)
        root = self._triangle.flat(math.sqrt(start) * torch.eye(3))
        root = root.repeat(2 * len(units))
        self.roots = nn.Parameter(root)
        mark([self.roots], "coefficient")
        mark_squares(self.roots, root.bool())

    @override
    def force(
        self, q: Float[Tensor, "batch N"], v: Float[Tensor, "batch n"]
    ) -> Float[Tensor, "batch n"]:
        linear, quadratic = self._matrix(repeated(self.roots, v.shape[0])).unbind(1)
        rate = in_body(q, v).unflatten(1, (-1, 3))
        speed = torch.linalg.vector_norm(rate, dim=-1, keepdim=True)
        wrench = matvec(linear, rate) + speed * matvec(quadratic, rate)
        return -in_world(q, wrench.flatten(1))

    def coefficients(self) -> Float[Tensor, "2 parts 3 3"]:
        """Return the linear and the quadratic matrices, of the force, if any, and the torque."""
        return self._matrix(self.roots)

    def _matrix(self, roots: Tensor) -> Float[Tensor, "*batch 2 parts 3 3"]:
        each = roots.unflatten(-1, (2, len(self.units), -1))
        return self.units * self._triangle.semidefinite(each)
