"""Rigid bodies that turn freely: a body on a pivot, a spherical pendulum, a quadrotor."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, final

import torch
from jaxtyping import Float
from torch import Tensor
from typing_extensions import override

from symo_exp.errors import ConfigError
from symo_exp.mechanics.bodies import Vector, pseudo_inertia
from symo_exp.mechanics.rigid_body import BodyParameters, RigidBodyLagrangian
from symo_exp.mechanics.types import Constant, Coordinates
from symo_exp.systems.base import VIEW, LagrangianSystem, Linkage, Skeleton


@dataclass(frozen=True, kw_only=True)
class RigidBodySystem(RigidBodyLagrangian, LagrangianSystem):
    """A rigid body with controls in body axes.

    A subclass gives the pseudo-inertia about the origin of its body axes and, to be drawn, points
    of the body. ``gravity`` is a vector in world axes or a number, downwards.
    """

    gravity: Any

    @property
    @abstractmethod
    def body(self) -> Float[Tensor, "4 4"]:
        """The pseudo-inertia of the body about its origin, float64."""

    @property
    def acceleration_of_gravity(self) -> Float[Tensor, " 3"]:
        """Gravity in world axes [m/s^2], float64."""
        gravity = self.gravity if isinstance(self.gravity, tuple) else (0.0, 0.0, -self.gravity)
        return torch.tensor(gravity, dtype=torch.float64)

    @property
    @abstractmethod
    def frame(self) -> tuple[Float[Tensor, "points 3"], tuple[tuple[int, int], ...], float]:
        """Points of the body with the origin first [m], bars between them, and the reach."""

    @override
    def rigid_body(self, like: Float[Tensor, "batch N"]) -> BodyParameters:
        body, gravity = self.body.to(like), self.acceleration_of_gravity.to(like)
        return BodyParameters.of_pseudo_inertia(body.unsqueeze(0), gravity.unsqueeze(0))

    @property
    @override
    def constants(self) -> Mapping[str, Constant]:
        return {"body": Constant(self.body, "kg")}

    @property
    @override
    def linkage(self) -> Linkage:
        return Linkage.of_body(self.coordinates, self.body, self.acceleration_of_gravity)

    @override
    def skeleton(self, q: Float[Tensor, " N"]) -> Skeleton:
        points, links, reach = self.frame
        turn = q[-9:].view(3, 3)
        there = points.to(q) @ turn.T + (q[:3] if len(q) > 9 else 0.0)
        view = torch.tensor(VIEW).to(q)
        return Skeleton(there @ view.T, links, reach=reach * float(view.norm(dim=1).max()))


@final
@dataclass(frozen=True, kw_only=True)
class RigidBody(RigidBodySystem):
    """A rigid body on a pivot without friction, torques about its three axes.

    ``inertia`` are the principal moments about the centre of mass, along the body axes. Without
    gravity or with the centre at the pivot it is a free body, with both a heavy top; fast about its
    axis it is a gyroscope.
    """

    gravity: Annotated[Vector, "m/s^2"]
    mass: Annotated[float, "kg"]
    centre: Annotated[Vector, "m"]
    inertia: Annotated[Vector, "kg m^2"]

    coordinates = Coordinates.of(rotations=("R",))
    input_matrix = torch.eye(3, dtype=torch.float64)

    def __post_init__(self) -> None:
        super().__post_init__()
        check_moments(self.inertia)

    @cached_property
    @override
    def body(self) -> Tensor:
        return body_of(self.mass, self.centre, self.inertia)

    @property
    @override
    def frame(self) -> tuple[Tensor, tuple[tuple[int, int], ...], float]:
        centre = torch.tensor(self.centre, dtype=torch.float64)
        size = max(float(centre.norm()), float(torch.tensor(self.inertia).max() / self.mass) ** 0.5)
        axes = 0.6 * size * torch.eye(3, dtype=torch.float64)
        points = torch.cat((torch.zeros(1, 3).double(), centre.unsqueeze(0), centre + axes))
        return points, ((0, 1), (1, 2), (1, 3), (1, 4)), 2.0 * size


@final
@dataclass(frozen=True, kw_only=True)
class SphericalPendulum(RigidBodySystem):
    """A uniform cylindrical rod on a ball joint, torques about two axes across it.

    The rod hangs along its ``−z`` axis where ``R`` is the identity. Its inertia about the joint is
    ``⅓ m l² + ¼ m r²`` across and ``½ m r²`` along it.
    """

    gravity: Annotated[float, "m/s^2"]
    mass: Annotated[float, "kg"]
    length: Annotated[float, "m"]
    radius: Annotated[float, "m"]

    coordinates = Coordinates.of(rotations=("R",))
    input_matrix = torch.eye(3, 2, dtype=torch.float64)

    @cached_property
    @override
    def body(self) -> Tensor:
        across = self.mass * (self.length**2 / 12 + self.radius**2 / 4)
        along = self.mass * self.radius**2 / 2
        return body_of(self.mass, (0.0, 0.0, -self.length / 2), (across, across, along))

    @property
    @override
    def frame(self) -> tuple[Tensor, tuple[tuple[int, int], ...], float]:
        points = torch.zeros(2, 3, dtype=torch.float64)
        points[1, 2] = -self.length
        return points, ((0, 1),), self.length


@final
@dataclass(frozen=True, kw_only=True)
class Quadrotor(RigidBodySystem):
    """A rigid body with four rotors on arms along its x and y axes.

    Inputs are the squared speeds ``s`` of the rotors [(1000 rad/s)²], in front, left, behind and
    right. Rotor i lifts with ``k_T sᵢ`` along the body's z axis, those in front and behind turn it
    about that axis with ``k_Q sᵢ``, the others with ``−k_Q sᵢ``::

        f = k_T (s₁ + s₂ + s₃ + s₄) e₃      τ = (l k_T (s₂ − s₄), l k_T (s₃ − s₁),
                                                  k_Q (s₁ − s₂ + s₃ − s₄))

    ``inertia`` are the principal moments about the centre of mass, along the body axes.
    """

    gravity: Annotated[float, "m/s^2"]
    mass: Annotated[float, "kg"]
    inertia: Annotated[Vector, "kg m^2"]
    arm: Annotated[float, "m"]
    thrust: Annotated[float, "N"]
    drag: Annotated[float, "N m"]

    coordinates = Coordinates.of(("x", "y", "z"), (False,) * 3, ("R",), [(0, 0)])
    inputs = ("front", "left", "behind", "right")

    def __post_init__(self) -> None:
        super().__post_init__()
        check_moments(self.inertia)

    @cached_property
    @override
    def input_matrix(self) -> Tensor:
        lift, lever, turn = self.thrust, self.arm * self.thrust, self.drag
        torques = [0.0, lever, 0.0, -lever], [-lever, 0.0, lever, 0.0], [turn, -turn, turn, -turn]
        forces = [0.0] * 4, [0.0] * 4, [lift] * 4
        return torch.tensor([*forces, *torques], dtype=torch.float64)

    @cached_property
    @override
    def body(self) -> Tensor:
        return body_of(self.mass, (0.0, 0.0, 0.0), self.inertia)

    @property
    @override
    def frame(self) -> tuple[Tensor, tuple[tuple[int, int], ...], float]:
        arm = self.arm
        points = [(0, 0, 0), (arm, 0, 0), (0, arm, 0), (-arm, 0, 0), (0, -arm, 0), (0, 0, arm / 2)]
        return torch.tensor(points, dtype=torch.float64), ((1, 3), (2, 4), (0, 5)), 3.0 * arm


def body_of(mass: float, centre: Vector, moments: Vector) -> Float[Tensor, "4 4"]:
    """Return the pseudo-inertia of a body with principal moments along its axes."""
    m, c, inertia = (torch.tensor(x, dtype=torch.float64) for x in (mass, centre, moments))
    return pseudo_inertia(m, c, torch.diag(inertia), float(c.norm()))


def check_moments(moments: Vector) -> None:
    """Refuse principal moments that no body has: each is at most the sum of the others.

    Raises:
        ConfigError: If they are not those of a body.
    """
    largest = max(moments)
    if min(moments) > 0.0 and 2.0 * largest <= sum(moments) * (1.0 + 1e-12):
        return
    raise ConfigError(
        f"system.inertia={list(moments)}: expected three positive moments, each at most the sum "
        "of the other two"
    )
