"""The Lagrangian of one rigid body, on a pivot or moving freely.

A configuration is a rotation ``R`` from body to world axes, or a position ``x`` of the body's
origin [m] and a rotation. With mass m, first moment ``μ`` (mass times centre) and inertia ``J``
about the origin, all in body axes, gravity ``γ`` in world axes and ``w = Rᵀẋ``

    T = ½ m |ẋ|² + w · (ω × μ) + ½ ω · J ω        V = −γ · (m x + R μ)

On a pivot ``x`` is zero.
"""

from __future__ import annotations

from abc import abstractmethod
from functools import cached_property
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from typing_extensions import override

from symo_exp.mechanics.lagrangian import (
    Curvature,
    Expansion,
    Gradients,
    Lagrangian,
    Rates,
    matvec,
    vecmat,
)
from symo_exp.mechanics.space import Space, cross


class BodyParameters(NamedTuple):
    """A rigid body in rows that broadcast over a batch."""

    mass: Float[Tensor, "#batch 1"]
    moment: Float[Tensor, "#batch 3"]
    """``μ``."""
    inertia: Float[Tensor, "#batch 3 3"]
    """``J``."""
    gravity: Float[Tensor, "#batch 3"]
    """``γ``."""

    @staticmethod
    def of_pseudo_inertia(
        body: Float[Tensor, "#batch 4 4"], gravity: Float[Tensor, "#batch 3"]
    ) -> BodyParameters:
        """Return the body of a pseudo-inertia about its origin."""
        second = body[..., :3, :3]
        trace = second.diagonal(dim1=-2, dim2=-1).sum(-1)[..., None, None]
        one = torch.eye(3, dtype=body.dtype, device=body.device)
        return BodyParameters(body[..., 3, 3:], body[..., :3, 3], trace * one - second, gravity)


class RigidBodyLagrangian(Lagrangian):
    """The Lagrangian of a rigid body, with its derivatives in closed form.

    Methods take its parameters as ``body`` where these are known already.
    """

    @abstractmethod
    def rigid_body(self, like: Float[Tensor, "batch N"]) -> BodyParameters:
        """Return the body for a batch of configurations, in their precision."""

    @property
    @override
    def space(self) -> Space:
        return Space(rotations=1)

    @override
    def mass_matrix(
        self, q: Float[Tensor, "batch N"], body: BodyParameters | None = None
    ) -> Float[Tensor, "batch n n"]:
        body, (turn, free) = body or self.rigid_body(q), _place(q)
        inertia = body.inertia.expand(q.shape[0], 3, 3)
        if not free:
            return inertia
        one = torch.eye(3, dtype=q.dtype, device=q.device)
        mixed = -turn @ cross(body.moment)
        above = torch.cat(((body.mass.unsqueeze(-1) * one).expand(q.shape[0], 3, 3), mixed), dim=2)
        return torch.cat((above, torch.cat((mixed.mT, inertia), dim=2)), dim=1)

    @override
    def potential(self, q: Float[Tensor, "batch N"]) -> Float[Tensor, " batch"]:
        body, (turn, free) = self.rigid_body(q), _place(q)
        centre = (turn @ body.moment.unsqueeze(-1)).squeeze(-1)  # of complex numbers, too
        return -(body.gravity * (body.mass * q[:, :3] + centre if free else centre)).sum(-1)

    @override
    def momentum(self, q: Float[Tensor, "batch N"], v: Float[Tensor, "batch n"]) -> Tensor:
        return _Motion.of(self.rigid_body(q), q, v).momentum()

    @override
    def gradients(
        self,
        q: Float[Tensor, "batch N"],
        v: Float[Tensor, "batch n"],
        body: BodyParameters | None = None,
    ) -> Gradients:
        at = _Motion.of(body or self.rigid_body(q), q, v)
        return Gradients(at.slope(), at.momentum())

    @override
    def rates(self, q: Float[Tensor, "batch N"], v: Float[Tensor, "batch n"]) -> Rates:
        at = _Motion.of(self.rigid_body(q), q, v)
        return Rates(self.mass_matrix(q), at.turned_momentum(), at.slope())

    def curvature(
        self,
        q: Float[Tensor, "batch N"],
        v: Float[Tensor, "batch n"],
        body: BodyParameters | None = None,
    ) -> Curvature:
        """Return the second derivatives."""
        return _Motion.of(body or self.rigid_body(q), q, v).curvature()

    @override
    def expand(self, q: Float[Tensor, "batch N"], v: Float[Tensor, "batch n"]) -> Expansion:
        return RigidBodyExpansion(self, q.detach(), v.detach())


class RigidBodyExpansion(Expansion):
    """The Lagrangian of a rigid body around ``(q, v)``.

    Args:
        lagrangian: ``ℒ``.
        q: Configurations.
        v: Velocities.
    """

    parts = ("_lagrangian", "_q", "_v", "values")
    _lagrangian: RigidBodyLagrangian

    def __init__(self, lagrangian: RigidBodyLagrangian, q: Tensor, v: Tensor) -> None:
        self._lagrangian, self._q, self._v = lagrangian, q, v
        with torch.no_grad():
            self.values = lagrangian.gradients(q, v, self._body)

    @cached_property
    @torch.no_grad()
    def _body(self) -> BodyParameters:
        return self._lagrangian.rigid_body(self._q)

    @override
    @torch.no_grad()
    def mass(self) -> Tensor:
        return self._lagrangian.mass_matrix(self._q, self._body)

    @override
    @torch.no_grad()
    def curvature(self, before: Expansion | None = None) -> Curvature:
        return self._lagrangian.curvature(self._q, self._v, self._body)


class _Motion(NamedTuple):
    """A moving rigid body. ``w`` and ``c`` are ``None`` on a pivot."""

    body: BodyParameters
    turn: Float[Tensor, "batch 3 3"]
    omega: Float[Tensor, "batch 3"]
    gravity: Float[Tensor, "batch 3"]
    """``Rᵀγ``."""
    velocity: Float[Tensor, "batch 3"] | None
    """``ẋ``."""
    w: Float[Tensor, "batch 3"] | None
    """``Rᵀẋ``."""
    c: Float[Tensor, "batch 3"] | None
    """``ω × μ``."""

    @staticmethod
    def of(body: BodyParameters, q: Tensor, v: Tensor) -> _Motion:
        turn, free = _place(q)
        gravity = vecmat(body.gravity.expand(q.shape[0], 3), turn)
        if not free:
            return _Motion(body, turn, v, gravity, None, None, None)
        velocity, omega = v[:, :3], v[:, 3:]
        c = torch.linalg.cross(omega, body.moment.expand_as(omega))
        return _Motion(body, turn, omega, gravity, velocity, vecmat(velocity, turn), c)

    def momentum(self) -> Tensor:
        """Return ``m ẋ + R (ω × μ)`` and ``J ω + μ × w``."""
        spin = matvec(self.body.inertia.expand(self.omega.shape[0], 3, 3), self.omega)
        if self.velocity is None or self.w is None or self.c is None:
            return spin
        linear = self.body.mass * self.velocity + matvec(self.turn, self.c)
        moment = self.body.moment.expand_as(self.w)
        return torch.cat((linear, spin + torch.linalg.cross(moment, self.w)), dim=1)

    def slope(self) -> Tensor:
        """Return ``m γ`` and ``(ω × μ) × w + μ × Rᵀγ``."""
        torque = torch.linalg.cross(self.body.moment.expand_as(self.gravity), self.gravity)
        if self.w is None or self.c is None:
            return torque
        weight = (self.body.mass * self.body.gravity).expand_as(torque)
        return torch.cat((weight, torque + torch.linalg.cross(self.c, self.w)), dim=1)

    def turned_momentum(self) -> Tensor:
        """Return ``Ḣ v``: ``R (ω × (ω × μ))`` and ``−μ × (ω × w)``."""
        if self.w is None or self.c is None:
            return torch.zeros_like(self.omega)
        linear = matvec(self.turn, torch.linalg.cross(self.omega, self.c))
        moment = self.body.moment.expand_as(self.w)
        turned = torch.linalg.cross(moment, torch.linalg.cross(self.omega, self.w))
        return torch.cat((linear, -turned), dim=1)

    def curvature(self) -> Curvature:
        """Return the second derivatives."""
        moment = cross(self.body.moment)
        lean = moment @ cross(self.gravity)
        if self.w is None or self.c is None:
            zero = torch.zeros_like(lean)
            return Curvature(lean, zero, zero)
        c, w, zero = cross(self.c), cross(self.w), torch.zeros_like(lean)
        above = torch.cat((zero, zero), dim=2)
        qq = torch.cat((above, torch.cat((zero, lean + c @ w), dim=2)), dim=1)
        right = torch.cat((-self.turn @ c, moment @ w), dim=1)
        vq = torch.cat((torch.zeros_like(right), right), dim=2)
        return Curvature(qq, vq, vq.mT)


def in_world(
    q: Float[Tensor, "batch N"], wrench: Float[Tensor, "batch n"]
) -> Float[Tensor, "batch n"]:
    """Return a force and a torque in body axes as a generalised force, ``(R f, τ)``."""
    turn, free = _place(q)
    if not free:
        return wrench
    return torch.cat((matvec(turn, wrench[:, :3]), wrench[:, 3:]), dim=1)


def in_body(q: Float[Tensor, "batch N"], v: Float[Tensor, "batch n"]) -> Float[Tensor, "batch n"]:
    """Return the velocity of the origin, if it moves, and the rates in body axes."""
    turn, free = _place(q)
    return torch.cat((vecmat(v[:, :3], turn), v[:, 3:]), dim=1) if free else v


def _place(q: Tensor) -> tuple[Tensor, bool]:
    """Return the rotation, and whether there is a position before it."""
    return q[:, -9:].unflatten(1, (3, 3)), q.shape[1] > 9
