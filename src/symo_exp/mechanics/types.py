"""Named tuples that the packages exchange."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from symo_exp.mechanics.space import Space
from symo_exp.mechanics.units import SI, Units

AXES = ("x", "y", "z")
ENTRIES = ("11", "12", "13", "21", "22", "23", "31", "32", "33")


class Coordinates(NamedTuple):
    """Degrees of freedom of a system: lengths and angles, then rotations in space.

    Attributes:
        names: Their names; a rotation ``R`` has three, ``R_x``, ``R_y`` and ``R_z``, those of its
            body rates.
        angular: Which are angles [rad]; those of a rotation are not.
        rotations: Names of the rotations, whose degrees of freedom are the last ones.
        free: For each body that moves freely, the index of the first of the three lengths and of
            the rotation that are its pose. Forces of inputs on it are in body axes.
        units: Those in which learned parts of a model have their parameters; configurations,
            velocities and forces are in SI units.
    """

    names: tuple[str, ...]
    angular: tuple[bool, ...]
    rotations: tuple[str, ...] = ()
    free: tuple[tuple[int, int], ...] = ()
    units: Units = SI

    @staticmethod
    def of(
        flat: Sequence[str] = (),
        angular: Sequence[bool] = (),
        rotations: Sequence[str] = (),
        free: Sequence[tuple[int, int]] = (),
    ) -> Coordinates:
        """Return coordinates of some flat ones and rotations."""
        turning = [f"{name}_{axis}" for name in rotations for axis in AXES]
        still = (False for _ in turning)
        return Coordinates((*flat, *turning), (*angular, *still), tuple(rotations), tuple(free))

    @property
    def n(self) -> int:
        """Number of degrees of freedom."""
        return len(self.names)

    @property
    def turning(self) -> tuple[bool, ...]:
        """Which degrees of freedom are angles or belong to a rotation."""
        flat = len(self.flat)
        return (*self.angular[:flat], *(True for _ in self.names[flat:]))

    @property
    def units_of_errors(self) -> tuple[str, ...]:
        """Units of errors of the degrees of freedom: ``m``, ``rad`` or both."""
        return tuple(sorted({"rad" if turns else "m" for turns in self.turning}))

    @property
    def sizes(self) -> Float[Tensor, " n"]:
        """Unit of each degree of freedom [m], 1 of those that turn."""
        units = [1.0 if turns else self.units.length for turns in self.turning]
        return torch.tensor(units, dtype=torch.float64)

    @property
    def measured(self) -> tuple[str, ...]:
        """Names of the numbers that a recording has, unit quaternions with the scalar first."""
        parts = ("w", *AXES)
        return (*self.flat, *(f"{name}_{part}" for name in self.rotations for part in parts))

    @property
    def width(self) -> int:
        """Number of numbers that a configuration consists of."""
        return len(self.stored)

    @property
    def space(self) -> Space:
        """The space of configurations."""
        return Space(len(self.rotations))

    def input_force(
        self,
        input_matrix: Float[Tensor, "n m"],
        q: Float[Tensor, "batch N"],
        u: Float[Tensor, "batch m"],
    ) -> Float[Tensor, "batch n"]:
        """Return the generalised force ``B u``, the forces on free bodies turned to world axes."""
        force = u @ input_matrix.T
        for place, turn in self.free:
            axes, end = self.space.rotation_matrices(q)[:, turn], place + 3
            pushed = (axes @ force[:, place:end, None]).squeeze(-1)
            force = torch.cat((force[:, :place], pushed, force[:, end:]), dim=1)
        return force

    @property
    def flat(self) -> tuple[str, ...]:
        """Names of the lengths and angles."""
        return self.names[: self.n - 3 * len(self.rotations)]

    @property
    def stored(self) -> tuple[str, ...]:
        """Names of the numbers that a configuration consists of."""
        return (*self.flat, *(f"{name}_{entry}" for name in self.rotations for entry in ENTRIES))


class Constant(NamedTuple):
    """A physical constant of known equations.

    Attributes:
        value: A positive number, or the positive definite 4 x 4 pseudo-inertia of a body about the
            ``origin``, float64.
        unit: Its unit; that of the mass for a pseudo-inertia.
        origin: The joint that a pseudo-inertia's centre of mass is counted from [m].
    """

    value: Tensor
    unit: str
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)


class Windows(NamedTuple):
    """Samples of three consecutive nodes ``k-1, k, k+1``, one time step apart.

    ``v`` belongs to node ``k`` and ``v_next`` to node ``k+1``. Every method sees these samples:
    SyMo and E2E-SyMo read the configurations, NODE and L-NODE the states at ``k`` and ``k+1``.
    """

    q_prev: Float[Tensor, "samples N"]
    q: Float[Tensor, "samples N"]
    q_next: Float[Tensor, "samples N"]
    v: Float[Tensor, "samples n"]
    v_next: Float[Tensor, "samples n"]
    u_prev: Float[Tensor, "samples m"]
    u: Float[Tensor, "samples m"]
    u_next: Float[Tensor, "samples m"]

    def rows(self, index: Tensor | slice) -> Windows:
        """Return the given samples."""
        return Windows(*(field[index] for field in self))


class Trajectories(NamedTuple):
    """Trajectories of ``nodes`` nodes each, one time step apart."""

    q: Float[Tensor, "trajectories nodes N"]
    v: Float[Tensor, "trajectories nodes n"]
    u: Float[Tensor, "trajectories nodes m"]

    def each(self) -> list[Trajectory]:
        """Return the trajectories one by one."""
        return [Trajectory(*fields) for fields in zip(*self, strict=True)]


class Trajectory(NamedTuple):
    """One motion: its nodes are one time step apart."""

    q: Float[Tensor, "nodes N"]
    v: Float[Tensor, "nodes n"]
    u: Float[Tensor, "nodes m"]


class Stretches(NamedTuple):
    """Samples of many consecutive nodes of configurations and controls, one time step apart."""

    q: Float[Tensor, "samples nodes N"]
    u: Float[Tensor, "samples nodes m"]
    start: Float[Tensor, "samples 2*n"]
    """``(q, v)`` near that at the first node, in the chart there, from where a fit begins; not
    finite if unknown."""
    weight: Float[Tensor, "samples nodes n"]
    """Weight of each squared error."""

    def rows(self, index: Tensor | slice) -> Stretches:
        """Return the given samples."""
        return Stretches(*(field[index] for field in self))


TrainingSamples = Windows | Stretches
