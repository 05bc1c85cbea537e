"""What every true system declares, and what follows from it."""

from __future__ import annotations

import hashlib
import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from symo_exp.errors import ConfigError
from symo_exp.mechanics.euler_lagrange import acceleration, generalised_force
from symo_exp.mechanics.lagrangian import Lagrangian, Rates
from symo_exp.mechanics.types import Coordinates
from symo_exp.systems import complex_step
from symo_exp.systems.checks import real

Range = tuple[float, float]


class SamplingBox(NamedTuple):
    """Where trajectories start and how they are driven: ``(low, high)`` of uniform draws.

    One range for each coordinate of ``q`` [m or rad], of ``v`` [m/s or rad/s] and for each
    control of ``u`` [N or N m], which is constant along a trajectory.
    """

    q: tuple[Range, ...]
    v: tuple[Range, ...]
    u: tuple[Range, ...]


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


class System(Lagrangian, ABC):
    """A mechanical system whose Lagrangian is known: ``d/dt ∂ℒ/∂v − ∂ℒ/∂q = B u``.

    A subclass gives the inertia, the potential and the skeleton, and hands the rest to this
    constructor. Units are SI throughout.

    ``coordinates`` name the degrees of freedom; ``input_matrix`` is ``B`` (n, m);
    ``time_step`` is the distance ``h`` [s] of the nodes of a trajectory; ``parameters`` maps each
    physical parameter to ``(value, unit)``; ``box`` is where trajectories start.
    """

    def __init__(
        self,
        *,
        coordinates: Coordinates,
        input_matrix: Sequence[Sequence[float]],
        time_step: float,
        parameters: Mapping[str, tuple[float, str]],
        box: SamplingBox,
    ) -> None:
        for name, (value, _) in parameters.items():
            real(f"system.{name}", value, above=0)
        real("system.time_step", time_step, above=0)
        self.coordinates = coordinates
        self.input_matrix: Float[Tensor, "n m"] = torch.tensor(input_matrix, dtype=torch.float64)
        self.time_step = float(time_step)
        self.parameters = {name: (float(x), unit) for name, (x, unit) in parameters.items()}
        n, m = self.input_matrix.shape
        self.sampling_box = SamplingBox(
            q=_ranges("q", box.q, n), v=_ranges("v", box.v, n), u=_ranges("u", box.u, m)
        )

    @abstractmethod
    def skeleton(self, q: Float[Tensor, " n"]) -> Skeleton:
        """Forward kinematics of one configuration, as a figure to draw."""

    def acceleration(
        self,
        q: Float[Tensor, "batch n"],
        v: Float[Tensor, "batch n"],
        u: Float[Tensor, "batch m"],
    ) -> Float[Tensor, "batch n"]:
        """``v̇ = H⁻¹ (B u − Ḣ v + ∂ℒ/∂q)``."""
        return acceleration(self, q, v, generalised_force(self.input_matrix.to(u), u))

    def rates(self, q: Float[Tensor, "batch n"], v: Float[Tensor, "batch n"]) -> Rates:
        """The terms of the equations of motion; without a graph where none is wanted."""
        tracked = torch.is_grad_enabled() and (q.requires_grad or v.requires_grad)
        if tracked or not self._analytic:
            return super().rates(q, v)
        return complex_step.rates(self, q, v)

    def _points(self, count: int) -> tuple[Tensor, Tensor, Tensor]:
        """Fixed points ``(q, v, u)`` spread over the box."""
        generator = torch.Generator().manual_seed(0)
        points = []
        for ranges in self.sampling_box:
            low, high = torch.tensor(ranges, dtype=torch.float64).T
            share = torch.rand(count, len(ranges), dtype=torch.float64, generator=generator)
            points.append(low + share * (high - low))
        return points[0], points[1], points[2]

    def _fingerprint(self) -> str:
        """Hash of accelerations, so that edited equations do not pass for the old ones."""
        with torch.no_grad():
            values = self.acceleration(*self._points(64)).flatten().tolist()
        return hashlib.sha256(" ".join(f"{x:.9e}" for x in values).encode()).hexdigest()[:16]

    @cached_property
    def _analytic(self) -> bool:
        """Whether this system's functions allow the complex step, tried at points of the box."""
        q, v, _ = self._points(8)
        return complex_step.applies(self, q, v)

    def identity(self) -> dict[str, object]:
        """Everything that decides how this system moves, as plain values."""
        kind = type(self)
        return {
            "class": f"{kind.__module__}.{kind.__qualname__}",
            "parameters": {name: list(pair) for name, pair in self.parameters.items()},
            "coordinates": list(self.coordinates.names),
            "angular": list(self.coordinates.angular),
            "input_matrix": self.input_matrix.tolist(),
            "time_step": self.time_step,
            "box": {k: [list(r) for r in v] for k, v in self.sampling_box._asdict().items()},
            "accelerations": self._fingerprint(),
        }


def _ranges(field: str, ranges: Sequence[Sequence[float]], count: int) -> tuple[Range, ...]:
    key = f"system.box.{field}"
    try:
        pairs = tuple((float(low), float(high)) for low, high in ranges)
    except (TypeError, ValueError):
        raise ConfigError(f"{key}={ranges}: expected a list of {count} [low, high] pairs") from None
    ordered = all(math.isfinite(low) and low <= high < math.inf for low, high in pairs)
    if len(pairs) != count or not ordered:
        raise ConfigError(
            f"{key}={[list(pair) for pair in pairs]}: expected {count} pair(s) [low, high] "
            "with low <= high"
        )
    return pairs
