"""Mechanical systems: coordinates, inputs, time step and, where known, the Lagrangian."""

# Annotations are not postponed here: fields are inherited by classes of other modules, which need
# not know the names of their types.

import copy
import hashlib
import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Annotated, Any, NamedTuple, get_origin, get_type_hints

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from typing_extensions import Self, override

from symo_exp.checks import real
from symo_exp.errors import ConfigError
from symo_exp.mechanics.bodies import Joint, turning_body, vector
from symo_exp.mechanics.dissipation import Dissipation, DissipativeLagrangian, Friction
from symo_exp.mechanics.euler_lagrange import acceleration
from symo_exp.mechanics.lagrangian import Lagrangian, Rates
from symo_exp.mechanics.space import Space
from symo_exp.mechanics.types import Constant, Coordinates
from symo_exp.systems import complex_step
from symo_exp.systems.box import Range, SamplingBox
from symo_exp.systems.box import checked as checked_box
from symo_exp.systems.equations import check_equations
from symo_exp.words import counted

VIEW = ((1.0, 0.35, 0.0), (0.0, 0.3, 1.0))
"""Right and up of a picture in world axes: bodies from the front, a little from above."""


class Skeleton(NamedTuple):
    """A stick figure of one configuration, in metres; x points right and y up.

    ``points[links[i][0]]`` and ``points[links[i][1]]`` are joined by a bar. ``carts`` are points
    that ride on the horizontal rail through the origin. ``reach`` is the farthest that any point
    gets from the first one, for the size of the picture.
    """

    points: Float[Tensor, "points 2"]
    links: tuple[tuple[int, int], ...]
    carts: tuple[int, ...] = ()
    reach: float = 1.0


class Linkage(NamedTuple):
    """A system as rigid bodies on joints.

    Attributes:
        joints: The joints with what they carry.
        gravity: Acceleration of gravity [m/s^2] in the axes of the joints.
        matrix: ``A`` in the joint coordinates ``A q``.
        free: Free bodies, each the first of three slides and the ball joint after them.
    """

    joints: Sequence[Joint]
    gravity: tuple[float, float, float]
    matrix: Float[Tensor, "n n"]
    free: Sequence[tuple[int, int]] = ()

    @staticmethod
    def of_body(
        coordinates: Coordinates, body: Float[Tensor, "4 4"], gravity: Float[Tensor, " 3"]
    ) -> "Linkage":
        """Return one rigid body that turns about the origin or moves freely.

        Args:
            coordinates: Its lengths, none on a pivot, and its rotation.
            body: Its pseudo-inertia about the origin in body axes.
            gravity: Acceleration of gravity [m/s^2].
        """
        joints = turning_body((*coordinates.flat, *coordinates.rotations), body)
        free = [(0, len(joints) - 1)] if len(joints) > 1 else []
        return Linkage(joints, vector(gravity), torch.eye(coordinates.n).double(), free)


@dataclass(frozen=True, kw_only=True)
class System(ABC):
    """A mechanical system as far as it is known, in SI units.

    A system is a frozen dataclass; ``conf/system`` holds the values of its fields. A physical
    parameter names its unit, ``mass: Annotated[float, "kg"]``, and is positive; a vector,
    ``Annotated[Vector, "m"]``, has three finite entries. ``time_step`` is the distance ``h`` [s] of
    the nodes of a trajectory, ``box`` the ranges of initial states and inputs. Unknown parts are
    ``None``; measures and pictures that need them are left out.
    """

    time_step: float
    box: SamplingBox | None = None

    @property
    @abstractmethod
    def coordinates(self) -> Coordinates:
        """The degrees of freedom."""

    @property
    @abstractmethod
    def input_matrix(self) -> Float[Tensor, "n m"]:
        """``B`` in the generalised force ``B u``, float64."""

    @property
    def inputs(self) -> Sequence[str]:
        """Names of the inputs."""
        return tuple(map(str, range(self.input_matrix.shape[1])))

    @property
    def lagrangian(self) -> Lagrangian | None:
        """The true Lagrangian."""
        return None

    @property
    def dissipation(self) -> Dissipation | None:
        """The known dissipation, ``None`` if there is none."""
        return None

    @property
    def ends(self) -> Sequence[Range] | None:
        """Range of each coordinate beyond which a motion ends, ``None`` for no limits."""
        return None

    @property
    def notes(self) -> Sequence[str]:
        """Lines to log before a training."""
        return ()

    def skeleton(self, q: Float[Tensor, " n"]) -> Skeleton | None:
        """Return the forward kinematics of a configuration as a figure, ``None`` if unknown."""
        return None

    def picture(
        self, q: Float[Tensor, " N"], size: int, middle: Float[Tensor, " N"] | None = None
    ) -> np.ndarray | None:
        """Return a picture (size, size, 3), uint8, ``None`` where the skeleton is drawn.

        A camera that follows a body follows that of ``middle``; ``None``: of ``q``.
        """
        return None

    @classmethod
    def units(cls) -> dict[str, str]:
        """Return the units of the physical parameters by name."""
        return {name: hint.__metadata__[0] for name, hint in cls._physical_hints().items()}

    @classmethod
    def _physical_hints(cls) -> dict[str, Any]:
        hints = get_type_hints(cls, include_extras=True)
        given = {f.name: hints[f.name] for f in fields(cls)}
        return {name: hint for name, hint in given.items() if get_origin(hint) is Annotated}

    def points(self, count: int, seed: int) -> tuple[Tensor, Tensor, Tensor]:
        """Return ``count`` draws of ``(q, v, u)`` from the box in float64."""
        assert self.box is not None
        x, v, u = self.box.points(count, seed)
        return self.coordinates.space.of_vector(x), v, u

    def __post_init__(self) -> None:
        vars(self)["time_step"] = real("system.time_step", self.time_step, above=0)
        for name, hint in self._physical_hints().items():
            vars(self)[name] = _physical(f"system.{name}", getattr(self, name), hint.__origin__)
        self._check_dimensions()
        if self.box is not None:
            vars(self)["box"] = checked_box(self.box, *self.input_matrix.shape)

    def _check_dimensions(self) -> None:
        """Refuse coordinates and an input matrix that do not fit each other."""
        kind, names, matrix = type(self).__name__, self.coordinates, self.input_matrix
        if not isinstance(names, Coordinates):
            raise ConfigError(f"{kind}.coordinates={names!r}: expected Coordinates(names, angular)")
        if not _fit(names.names, names.angular):
            raise ConfigError(
                f"{kind}.coordinates has names={names.names} and angular={names.angular}: "
                "expected different names and, for each, True or False"
            )
        if not _bodies_fit(names):
            raise ConfigError(
                f"{kind}.coordinates has names={names.names}, rotations={names.rotations} and "
                f"free={names.free}: expected Coordinates.of(lengths and angles, which are angles, "
                "rotations, free), in free the indices of the first of three lengths and of the "
                "rotation of a body, as [(0, 0)]"
            )
        shape = tuple(matrix.shape) if isinstance(matrix, Tensor) else type(matrix).__name__
        if not isinstance(matrix, Tensor) or matrix.ndim != 2 or len(matrix) != names.n:
            raise ConfigError(
                f"{kind}.input_matrix is {shape}: expected a tensor with a row for each of "
                f"{counted(names.n, 'coordinate')} and a column for each input"
            )


@dataclass(frozen=True, kw_only=True)
class LagrangianSystem(System, Lagrangian):
    """A system whose Lagrangian is known: ``d/dt ∂ℒ/∂v − ∂ℒ/∂q = F_d + B u``.

    A subclass gives ``mass_matrix`` and ``potential`` and, to be drawn, ``skeleton``. Friction is
    ``F_d = −d ∘ v − c ∘ tanh(v / ε_v)`` with coefficients for every coordinate: ``viscous`` d
    [N m s, N s/m], ``coulomb`` c [N m, N] and ``rest_velocity`` ε_v [rad/s, m/s]; without them
    there is none.
    """

    box: SamplingBox = field()  # without it there is nothing to simulate
    viscous: tuple[float, ...] | None = None
    coulomb: tuple[float, ...] | None = None
    rest_velocity: float = 0.05

    def __post_init__(self) -> None:
        super().__post_init__()
        n = self.coordinates.n
        for name in ("viscous", "coulomb"):
            given = getattr(self, name)
            if given is not None:
                vars(self)[name] = _coefficients(name, given, n)
        vars(self)["rest_velocity"] = real("system.rest_velocity", self.rest_velocity, above=0)

    @property
    def closed_form(self) -> bool:
        """Whether ``gradients`` and ``rates`` need no automatic differentiation."""
        return False

    @property
    @override
    def space(self) -> Space:
        return self.coordinates.space

    @override
    def input_force(self, input_matrix: Tensor, q: Tensor, u: Tensor) -> Tensor:
        return self.coordinates.input_force(input_matrix, q, u)

    @cached_property
    def lagrangian(self) -> Lagrangian:
        """The true Lagrangian, with the friction where there is any."""
        count = self.coordinates.n + 16  # no number of coordinates
        x, _, _ = self.box.points(count, seed=0)
        check_equations(self, self.space.of_vector(x), x - x.roll(1, 0))
        return DissipativeLagrangian(self, self.dissipation) if self.dissipation else self

    @cached_property
    def dissipation(self) -> Dissipation | None:
        """The friction, if there is any."""
        if not self._friction:
            return None
        none = (0.0,) * self.coordinates.n
        d, c = (torch.tensor(x or none, dtype=torch.float64) for x in (self.viscous, self.coulomb))
        return Friction(torch.diag(d), c, self.rest_velocity)

    @property
    def _friction(self) -> dict[str, object]:
        """The coefficients that are not zero."""
        given = {"viscous": self.viscous, "coulomb": self.coulomb}
        found: dict[str, object] = {name: list(x) for name, x in given.items() if x and any(x)}
        return found | ({"rest_velocity": self.rest_velocity} if "coulomb" in found else {})

    @property
    def linkage(self) -> Linkage | None:
        """Its rigid bodies, where it is described by them."""
        return None

    @property
    def constants(self) -> Mapping[str, Constant]:
        """The constants of the inertia and the potential, by name."""
        return {
            name: Constant(torch.tensor(getattr(self, name), dtype=torch.float64), unit)
            for name, unit in self.units().items()
        }

    def with_constants(self, values: Mapping[str, Tensor]) -> Self:
        """Return a copy whose inertia and potential are differentiable in ``values``.

        Args:
            values: A tensor of the shape of ``constants[name].value`` for some or all names.
        """
        twin = copy.copy(self)
        kept = {f.name: vars(self)[f.name] for f in fields(self) if f.name in vars(self)}
        vars(twin).clear()  # of what was computed from the constants of this one
        vars(twin).update(kept | dict(values))
        return twin

    def acceleration(
        self,
        q: Float[Tensor, "batch n"],
        v: Float[Tensor, "batch n"],
        u: Float[Tensor, "batch m"],
    ) -> Float[Tensor, "batch n"]:
        """Return ``v̇ = H⁻¹ (B u + F_d − Ḣ v + ∂ℒ/∂q)`` [rad/s², m/s²]."""
        force = self.input_force(self.input_matrix.to(u), q, u)
        return acceleration(self.lagrangian, q, v, force)

    def rates(self, q: Float[Tensor, "batch n"], v: Float[Tensor, "batch n"]) -> Rates:
        """Return the terms of the equations of motion, without a graph unless one is needed."""
        tracked = torch.is_grad_enabled() and (q.requires_grad or v.requires_grad)
        if tracked or not self._analytic:
            return super().rates(q, v)
        return complex_step.rates(self, q, v)

    @cached_property
    def _analytic(self) -> bool:
        """True if this system's functions allow the complex step, tried at points of the box."""
        q, v, _ = self.points(8, seed=0)
        return complex_step.applies(self, q, v)

    def identity(self) -> dict[str, object]:
        """Return everything that decides how this system moves, as plain values."""
        kind, units = type(self), self.units()
        shared = {f.name for f in fields(LagrangianSystem)}
        own = [f.name for f in fields(self) if f.name not in shared]
        return {
            **self._friction,
            "class": f"{kind.__module__}.{kind.__qualname__}",
            "parameters": {name: [getattr(self, name), units.get(name, "")] for name in own},
            "coordinates": list(self.coordinates.names),
            "angular": list(self.coordinates.angular),
            **({"rotations": list(names)} if (names := self.coordinates.rotations) else {}),
            "input_matrix": self.input_matrix.tolist(),
            "time_step": self.time_step,
            "box": {k: [list(r) for r in v] for k, v in self.box._asdict().items()},
            "accelerations": self._fingerprint(),
        }

    def _fingerprint(self) -> str:
        """Return a hash of accelerations, so that edited equations do not pass for the old ones."""
        with torch.no_grad():
            values = self.acceleration(*self.points(64, seed=0)).flatten().tolist()
        return hashlib.sha256(" ".join(f"{x:.9e}" for x in values).encode()).hexdigest()[:16]


def _fit(names: Any, angular: Any) -> bool:
    """Return whether these are different names and as many truth values."""
    if not all(isinstance(given, tuple | list) for given in (names, angular)):
        return False
    kinds = all(isinstance(x, str) for x in names) and all(isinstance(x, bool) for x in angular)
    return kinds and len(set(names)) == len(names) == len(angular)


def _bodies_fit(coordinates: Coordinates) -> bool:
    """Return whether rotations have the last names, and free bodies lengths and a rotation."""
    flat, rotations = coordinates.flat, coordinates.rotations
    angular = coordinates.angular[: len(flat)]
    own = [(x, y) for x, y in coordinates.free if x in range(len(flat) - 2)]
    own = [(x, y) for x, y in own if not any(angular[x : x + 3]) and y in range(len(rotations))]
    named = Coordinates.of(flat, angular, rotations)
    return len(own) == len(coordinates.free) and tuple(coordinates.names) == named.names


def _physical(key: str, value: object, kind: Any) -> object:
    """Return a positive number or, where ``kind`` is none of a number, a vector of three."""
    if kind in (float, int):
        return real(key, value, above=0)
    if not isinstance(value, Sequence) or len(value) != 3:
        raise ConfigError(f"{key}={value}: expected three numbers")
    return tuple(real(key, x) for x in value)


def _coefficients(name: str, given: Sequence[float], n: int) -> tuple[float, ...]:
    try:
        values = tuple(float(x) for x in given)
    except (TypeError, ValueError):
        values = ()
    if len(values) != n or not all(0.0 <= x < math.inf for x in values):
        raise ConfigError(
            f"system.{name}={given}: expected a list of {counted(n, 'number')}, 0 or more: one "
            "a coordinate"
        )
    return values
