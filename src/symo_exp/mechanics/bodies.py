"""Rigid bodies in a tree of hinges, slides and ball joints: poses, Jacobians and fluid drag.

A joint moves the bodies after it by a rotation about its axis, a translation along it or a rotation
about its anchor; the composition of these motions from the root takes a body from the reference
configuration to its pose. A body that moves freely is on three slides and a ball joint.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property
from typing import Any, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from typing_extensions import override

from symo_exp.mechanics.composites import TreeOrder
from symo_exp.mechanics.dissipation import Dissipation
from symo_exp.mechanics.space import cross

Vector = tuple[float, float, float]
Axes = tuple[Vector, Vector, Vector]
"""A rotation matrix: directions of the axes of a frame, in columns."""


class Joint(NamedTuple):
    """A hinge, a slide or a ball joint and the rigid body that it moves.

    Vectors are in world axes, with all coordinates at their ``reference`` values. The coordinate of
    a ball joint is the rotation ``R`` of the axes ``A`` of its body, counted from axes ``L``: the
    joint turns the body by ``L R Aᵀ``, nothing where ``R = Lᵀ A``.

    Attributes:
        name: Name of the joint.
        slides: Whether it is a slide.
        parent: Index of the previous joint, −1 for none.
        axis: Unit vector of the joint.
        anchor: A point of the axis, the centre of a ball joint [m].
        reference: Reference value of the coordinate [rad, m].
        mass: Mass of the body [kg].
        centre: Its centre of mass [m].
        inertia: Its inertia about the centre of mass [kg m²].
        armature: Inertia of a rotor that turns with the coordinate [kg m², kg].
        stiffness: Stiffness of a spring [N m/rad, N/m].
        rest: Coordinate at which the spring is at rest [rad, m].
        damping: Viscous friction [N m s, N s/m].
        friction: Dry friction [N m, N].
        limits: Range of the coordinate [rad, m].
        axes: ``A`` of a ball joint; ``None`` of the others.
        base: ``L`` of a ball joint.
    """

    name: str
    slides: bool
    parent: int
    axis: Vector
    anchor: Vector
    reference: float
    mass: float
    centre: Vector
    inertia: tuple[Vector, Vector, Vector]
    armature: float = 0.0
    stiffness: float = 0.0
    rest: float = 0.0
    damping: float = 0.0
    friction: float = 0.0
    limits: tuple[float, float] | None = None
    axes: Axes | None = None
    base: Axes | None = None


def freedoms(joints: Sequence[Joint]) -> list[tuple[int, int | None]]:
    """Return the joint and, of a ball joint, the axis of each degree of freedom, balls last."""
    flat = [(i, None) for i, joint in enumerate(joints) if joint.axes is None]
    balls = [(i, k) for i, joint in enumerate(joints) if joint.axes is not None for k in range(3)]
    return [*flat, *balls]


def freedoms_of(joints: Sequence[Joint]) -> list[list[int]]:
    """Return the places of each joint among the degrees of freedom."""
    ours = freedoms(joints)
    return [[k for k, (owner, _) in enumerate(ours) if owner == i] for i in range(len(joints))]


def joint_order(joints: Sequence[Joint]) -> list[int]:
    """Return the place of each degree of freedom where they are in the order of the joints."""
    ours = freedoms(joints)
    ordered = sorted(ours, key=lambda freedom: (freedom[0], freedom[1] or 0))
    return [ordered.index(freedom) for freedom in ours]


def link(
    name: str,
    mass: float,
    centre: Vector = (0.0, 0.0, 0.0),
    moments: Vector = (0.0, 0.0, 0.0),
    *,
    anchor: Vector = (0.0, 0.0, 0.0),
    axis: Vector = (0.0, -1.0, 0.0),
    parent: int = -1,
    slides: bool = False,
) -> Joint:
    """Return a joint whose coordinate is zero at the reference, with a body on principal axes."""
    a, b, c = moments
    inertia = (a, 0.0, 0.0), (0.0, b, 0.0), (0.0, 0.0, c)
    return Joint(name, slides, parent, axis, anchor, 0.0, mass, centre, inertia)


def turning_body(names: Sequence[str], body: Float[Tensor, "4 4"]) -> list[Joint]:
    """Return the joints of one rigid body that turns about the origin or moves freely.

    Args:
        names: Names of its lengths, none on a pivot, and of its rotation.
        body: Its pseudo-inertia about the origin in body axes.
    """
    mass, centre, inertia = of_pseudo_inertia(body.detach().double().cpu())
    one: Axes = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
    *lengths, turn = names
    joints = [
        link(name, 0.0, axis=axis, slides=True, parent=i - 1)
        for i, (name, axis) in enumerate(zip(lengths, one, strict=False))
    ]
    ball = link(turn, float(mass), vector(centre), axis=one[2], parent=len(lengths) - 1)
    x, y, z = map(vector, inertia)
    return [*joints, ball._replace(inertia=(x, y, z), axes=one, base=one)]


def vector(x: Float[Tensor, " 3"]) -> Vector:
    """Return three numbers without their tensor."""
    a, b, c = x.tolist()
    return a, b, c


class Hull(NamedTuple):
    """A box with fluid drag, at the reference.

    Attributes:
        joint: Index of the joint that moves it.
        centre: Its centre [m].
        axes: Directions of its sides.
        sides: Lengths of its sides [m].
    """

    joint: int
    centre: Vector
    axes: Axes
    sides: Vector


class Poses(NamedTuple):
    """Poses of bodies: a point ``x`` of the reference configuration is at ``R_i x + t_i``."""

    turn: Float[Tensor, "batch n 3 3"]
    """``R_i``."""
    shift: Float[Tensor, "batch n 3"]
    """``t_i``."""

    def of(self, points: Float[Tensor, "n 3"]) -> Float[Tensor, "batch n 3"]:
        """Return the positions of a point of each body."""
        return (self.turn @ points.unsqueeze(-1)).squeeze(-1) + self.shift


class Tree:
    """Kinematics of the bodies of a tree of joints."""

    def __init__(self, joints: Sequence[Joint]) -> None:
        self._joints = joints
        axis, anchor, reference = (column(joints, x) for x in ("axis", "anchor", "reference"))
        flat = [i for i, joint in enumerate(joints) if joint.axes is None]
        self._balls = [i for i, joint in enumerate(joints) if joint.axes is not None]
        self._rank = {i: k for k, i in enumerate(flat)}  # among the flat coordinates
        balls = [joints[i] for i in self._balls]
        own, base = (column(balls, name).reshape(-1, 3, 3) for name in ("axes", "base"))
        owners, along = [], []
        for i, k in freedoms(joints):
            owners.append(i)
            along.append(axis[i] if k is None else own[self._balls.index(i)][:, k])
        self._owners = owners
        turned = torch.stack(along)
        hinge = 1 - column([joints[i] for i in owners], "slides")[:, None]
        before = torch.zeros(len(joints), len(joints), dtype=torch.float64)
        for i, joint in enumerate(joints):
            before[i] = before[joint.parent] if joint.parent >= 0 else 0.0
            before[i, i] = 1.0
        across = cross(axis[flat])
        self._constants = (
            axis, anchor, reference[flat], across, across @ across, own, base,
            turned, anchor[owners], hinge, before[:, owners],
        )  # fmt: skip
        self._converted: dict[tuple[torch.dtype, torch.device], tuple[Tensor, ...]] = {}

    def _as(self, q: Tensor) -> tuple[Tensor, ...]:
        key = (q.dtype, q.device)
        if key not in self._converted:
            self._converted[key] = tuple(x.to(q) for x in self._constants)
        return self._converted[key]

    @cached_property
    def branches(self) -> TreeOrder:
        """Which bodies each hinge or slide carries; there are no ball joints."""
        return TreeOrder(self._constants[-1])

    def twists(self, at: Poses) -> Float[Tensor, "batch n 3 4"]:
        """Return ``Ξᵢ`` of hinges and slides, where there are no ball joints."""
        *_, axis, anchor, hinge, _ = self._as(at.shift)
        about = (at.turn @ axis.unsqueeze(-1)).squeeze(-1)
        moved = hinge * torch.linalg.cross(at.of(anchor), about) + (1 - hinge) * about
        return torch.cat((cross(hinge * about), moved.unsqueeze(-1)), dim=-1)

    def poses(self, q: Float[Tensor, "batch N"]) -> Poses:
        """Return the poses of all bodies."""
        axis, anchor, reference, across, square, own, base, *_ = self._as(q)
        theta = q[:, : len(reference)] - reference
        sin, cos = theta.sin()[..., None, None], theta.cos()[..., None, None]
        one = torch.eye(3, dtype=q.dtype, device=q.device)
        hinges = one + sin * across + (1 - cos) * square
        turned = base @ q[:, len(reference) :].unflatten(1, (len(self._balls), 3, 3)) @ own.mT
        turns: list[Tensor] = []
        shifts: list[Tensor] = []
        for i, joint in enumerate(self._joints):
            root = joint.parent < 0
            before = one.expand(q.shape[0], 3, 3) if root else turns[joint.parent]
            shift = torch.zeros_like(before[:, 0]) if root else shifts[joint.parent]
            if joint.slides:
                turns.append(before)
                shifts.append(shift + theta[:, self._rank[i], None] * (before @ axis[i]))
                continue
            ball = joint.axes is not None
            turn = turned[:, self._balls.index(i)] if ball else hinges[:, self._rank[i]]
            turns.append(turn if root else before @ turn)
            shifts.append(shift + (before - turns[-1]) @ anchor[i])
        return Poses(torch.stack(turns, 1), torch.stack(shifts, 1))

    def jacobians(
        self, at: Poses, of: Sequence[int], points: Float[Tensor, "points 3"]
    ) -> tuple[Float[Tensor, "batch points n 3"], Float[Tensor, "batch points n 3"]]:
        """Return ``∂ċ/∂v`` of points in world axes, and ``∂ω/∂v`` of their bodies in body axes.

        Args:
            at: Poses of all bodies.
            of: The body of each point.
            points: The points in the reference configuration.
        """
        *_, axis, anchor, hinge, moves = self._as(at.shift)
        joints = Poses(at.turn[:, self._owners], at.shift[:, self._owners])
        about = (joints.turn @ axis.unsqueeze(-1)).squeeze(-1).unsqueeze(1)
        own = Poses(at.turn[:, of], at.shift[:, of])
        arms = own.of(points).unsqueeze(2) - joints.of(anchor).unsqueeze(1)
        about = about.expand_as(arms)
        linear = hinge * torch.linalg.cross(about, arms) + (1 - hinge) * about
        moved = moves[of].unsqueeze(-1)
        return moved * linear, (moved * hinge * about) @ own.turn


class Drag(Dissipation):
    """Drag of a fluid at rest on boxes, and friction of the joints.

    With sides s, mean side d and velocity w and angular velocity ω in a box's own axes, density ρ
    and viscosity β (MuJoCo's inertia model)::

        f_i = −3π β d w_i − ½ ρ s_j s_k |w_i| w_i
        τ_i = −π β d³ ω_i − ρ s_i (s_j⁴ + s_k⁴) |ω_i| ω_i / 64
    """

    def __init__(
        self, tree: Tree, hulls: Sequence[Hull], density: float, viscosity: float,
        friction: Dissipation | None,
    ) -> None:  # fmt: skip
        self._tree, self._friction = tree, friction
        self._of = [hull.joint for hull in hulls]
        self._centre, self._axes, sides = (column(hulls, x) for x in ("centre", "axes", "sides"))
        next_, last = sides.roll(-1, -1), sides.roll(-2, -1)
        mean = sides.mean(-1, keepdim=True)
        self._slow = 3 * math.pi * viscosity * mean, math.pi * viscosity * mean**3
        self._fast = (
            0.5 * density * next_ * last, density * sides * (next_**4 + last**4) / 64
        )  # fmt: skip

    @override
    def force(self, q: Tensor, v: Tensor) -> Tensor:
        at, axes = self._tree.poses(q), self._axes.to(q)
        linear, turning = self._tree.jacobians(at, self._of, self._centre.to(q))
        found = torch.zeros_like(v) if self._friction is None else self._friction.force(q, v)
        parts = (linear @ (at.turn[:, self._of] @ axes), turning @ axes)
        for jacobian, slow, fast in zip(parts, self._slow, self._fast, strict=True):
            speed = torch.einsum("bjik,bi->bjk", jacobian, v)
            drag = -(slow.to(q) + fast.to(q) * speed.abs()) * speed
            found = found + torch.einsum("bjik,bjk->bi", jacobian, drag)
        return found


def column(rows: Sequence[Any], name: str) -> Tensor:
    """Return a field of all rows as a float64 tensor."""
    return torch.tensor([getattr(row, name) for row in rows], dtype=torch.float64)


THINNEST, ROUNDING = 1e-6, 1e-13
"""The least second moments of a body, relative to all of its moment about its joint, and to its
mass times the square of the distance from the origin."""
POINT = 1e-12
"""Second moments of a point mass at the origin, relative to its mass [m²]."""


def pseudo_inertia(
    mass: Tensor, centre: Float[Tensor, 3], inertia: Float[Tensor, "3 3"], lever: float
) -> Float[Tensor, "4 4"]:
    """Return the pseudo-inertia of a rigid body (Wensing, Kim and Slotine 2018, equation 10).

    Second moments of thin bodies and of point masses are made slightly positive, by a share of the
    body's own size, however small it is.

    Args:
        mass: Mass [kg].
        centre: Centre of mass [m].
        inertia: Inertia about the centre [kg m^2].
        lever: Distance of the centre from the joint [m].
    """
    second = 0.5 * inertia.diagonal().sum() * torch.eye(3).to(inertia) - inertia
    values, vectors = torch.linalg.eigh(second)
    size = float(values.clamp_min(0.0).sum() + mass * lever**2)
    least = max(THINNEST * size, ROUNDING * float(mass * centre.square().sum()))
    values = values.clamp_min(least or POINT * float(mass))
    second = vectors @ torch.diag(values) @ vectors.T + mass * torch.outer(centre, centre)
    edge = (mass * centre).unsqueeze(0)
    top = torch.cat((second, edge.T), dim=1)
    return torch.cat((top, torch.cat((edge, mass.reshape(1, 1)), dim=1)), dim=0)


def of_pseudo_inertia(body: Float[Tensor, "4 4"]) -> tuple[Tensor, Tensor, Tensor]:
    """Return mass, centre of mass and inertia about it of a pseudo-inertia."""
    mass = body[3, 3]
    centre = body[3, :3] / mass
    second = body[:3, :3] - mass * torch.outer(centre, centre)
    return mass, centre, second.diagonal().sum() * torch.eye(3).to(body) - second
