"""Lagrangians, dissipation and states in units of their own.

Parameters, priors and damping of least squares, and initial values are made for numbers of order
one. With the units of coordinates ``ℓᵢ``, that of length or 1 for angles, of time ``T`` and of
energy ``E``

    ℒ(q, v) = E ℒ'(q / ℓ, v T / ℓ)        F_d(q, v) = E F_d'(q / ℓ, v T / ℓ) / ℓ

so that a machine of micrometres is learned as one of metres.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn
from typing_extensions import Self, override

from symo_exp.mechanics.dissipation import Dissipation
from symo_exp.mechanics.lagrangian import Curvature, Expansion, Gradients, Lagrangian, Rates
from symo_exp.mechanics.space import Space
from symo_exp.mechanics.types import Coordinates


class Scale(nn.Module):
    """The units of configurations, of time and of energy, for the coordinates of a system.

    Args:
        coordinates: The coordinates, with their units.
    """

    place: Tensor
    """``ℓ`` of the numbers of a configuration."""
    motion: Tensor
    """``ℓ`` of the degrees of freedom."""

    def __init__(self, coordinates: Coordinates) -> None:
        super().__init__()
        flat, rest = len(coordinates.flat), coordinates.width - len(coordinates.flat)
        self._exact = coordinates.sizes, torch.cat((coordinates.sizes[:flat], torch.ones(rest)))
        for name, exact in zip(("motion", "place"), self._exact, strict=True):
            self.register_buffer(name, exact.to(torch.get_default_dtype()), persistent=False)
        self.time, self.energy = coordinates.units.time, coordinates.units.size("N m")

    @override
    def _apply(self, fn: Callable[..., Any], recurse: bool = True) -> Self:
        # A buffer that was converted to single precision stays rounded in double precision.
        super()._apply(fn, recurse)
        self.motion, self.place = (
            exact.to(x) for exact, x in zip(self._exact, (self.motion, self.place), strict=True)
        )
        return self

    def inside(self, q: Tensor, v: Tensor) -> tuple[Tensor, Tensor]:
        """Return ``q / ℓ`` and ``v T / ℓ``."""
        return q / self.place, v * (self.time / self.motion)

    def outside(self, x: Float[Tensor, "*batch n"], times: int) -> Float[Tensor, "*batch n"]:
        """Return ``ℓ x / T^times``, such as velocities and accelerations."""
        return x * (self.motion / self.time**times)

    def inputs(
        self, u: Float[Tensor, "batch m"], input_matrix: Float[Tensor, "n m"]
    ) -> Float[Tensor, "batch m"]:
        """Return each input as the largest force that it causes, ``E/ℓ`` being the unit."""
        size = (input_matrix.abs() * (self.motion / self.energy).unsqueeze(1)).amax(0)
        return u * size.where(size > 0.0, 1.0)

    def force(self, x: Float[Tensor, "*batch n"]) -> Float[Tensor, "*batch n"]:
        """Return ``E x / ℓ``."""
        return x * (self.energy / self.motion)

    def momentum(self, x: Float[Tensor, "*batch n"]) -> Float[Tensor, "*batch n"]:
        """Return ``E T x / ℓ``."""
        return x * (self.energy * self.time / self.motion)

    def matrix(self, x: Float[Tensor, "*batch n n"], times: int) -> Float[Tensor, "*batch n n"]:
        """Return ``E T^times x_ij / (ℓᵢ ℓⱼ)``."""
        return x * (self.energy * self.time**times / (self.motion.unsqueeze(-1) * self.motion))


class ScaledLagrangian(nn.Module, Lagrangian):
    """A Lagrangian that reads and returns SI units, and whose parameters have others.

    Args:
        lagrangian: ``ℒ'``, of coordinates in the other units.
        coordinates: The coordinates, with the units.
    """

    def __init__(self, lagrangian: Lagrangian, coordinates: Coordinates) -> None:
        super().__init__()
        self.inner, self.scale = lagrangian, Scale(coordinates)

    @property
    @override
    def space(self) -> Space:
        return self.inner.space

    @override
    def input_force(self, input_matrix: Tensor, q: Tensor, u: Tensor) -> Tensor:
        return self.inner.input_force(input_matrix, q, u)

    @override
    def mass_matrix(self, q: Float[Tensor, "batch N"]) -> Float[Tensor, "batch n n"]:
        return self.scale.matrix(self.inner.mass_matrix(q / self.scale.place), 2)

    @override
    def potential(self, q: Float[Tensor, "batch N"]) -> Float[Tensor, " batch"]:
        return self.scale.energy * self.inner.potential(q / self.scale.place)

    @override
    def gradients(self, q: Float[Tensor, "batch N"], v: Float[Tensor, "batch n"]) -> Gradients:
        return _outside(self.inner.gradients(*self.scale.inside(q, v)), self.scale)

    @override
    def rates(self, q: Float[Tensor, "batch N"], v: Float[Tensor, "batch n"]) -> Rates:
        mass, mass_rate_v, dq = self.inner.rates(*self.scale.inside(q, v))
        force = self.scale.force
        return Rates(self.scale.matrix(mass, 2), force(mass_rate_v), force(dq))

    @override
    def expand(self, q: Float[Tensor, "batch N"], v: Float[Tensor, "batch n"]) -> Expansion:
        return ScaledExpansion(self.inner.expand(*self.scale.inside(q, v)), self.scale)


class ScaledExpansion(Expansion):
    """A scaled Lagrangian around ``(q, v)``."""

    parts = ("_at", "_scale", "values")

    def __init__(self, at: Expansion, scale: Scale) -> None:
        self._at, self._scale, self.values = at, scale, _outside(at.values, scale)

    @override
    def mass(self) -> Tensor:
        return self._scale.matrix(self._at.mass(), 2)

    @override
    def curvature(self, before: Expansion | None = None) -> Curvature:
        qq, vq, qv = self._at.curvature()
        matrix = self._scale.matrix
        return Curvature(matrix(qq, 0), matrix(vq, 1), matrix(qv, 1))

    @override
    def gradients(self, q: Tensor, v: Tensor) -> Gradients:
        return _outside(self._at.gradients(*self._scale.inside(q, v)), self._scale)


class ScaledDissipation(nn.Module, Dissipation):
    """A dissipation that reads and returns SI units, and whose parameters have others.

    Args:
        dissipation: ``F_d'``, of coordinates in the other units.
        coordinates: The coordinates, with the units.
    """

    def __init__(self, dissipation: Dissipation, coordinates: Coordinates) -> None:
        super().__init__()
        self.inner, self.scale = dissipation, Scale(coordinates)

    @override
    def force(
        self, q: Float[Tensor, "batch N"], v: Float[Tensor, "batch n"]
    ) -> Float[Tensor, "batch n"]:
        return self.scale.force(self.inner.force(*self.scale.inside(q, v)))

    @override
    def derivatives(
        self, q: Float[Tensor, "batch N"], v: Float[Tensor, "batch n"]
    ) -> tuple[Float[Tensor, "batch n n"], Float[Tensor, "batch n n"]]:
        by_q, by_v = self.inner.derivatives(*self.scale.inside(q, v))
        return self.scale.matrix(by_q, 0), self.scale.matrix(by_v, 1)

    @override
    def damping(
        self, q: Float[Tensor, "batch N"], v: Float[Tensor, "batch n"]
    ) -> Float[Tensor, "batch n n"]:
        return self.scale.matrix(self.inner.damping(*self.scale.inside(q, v)), 1)

    @override
    def chord(
        self, v: Float[Tensor, "batch n"], before: Float[Tensor, "batch n"]
    ) -> Float[Tensor, "batch n n"] | None:
        pace = self.scale.time / self.scale.motion
        found = self.inner.chord(v * pace, before * pace)
        return None if found is None else self.scale.matrix(found, 1)


def _outside(inner: Gradients, scale: Scale) -> Gradients:
    return Gradients(scale.force(inner.q), scale.momentum(inner.v))
