"""Reference models of machines, as identified by their makers.

A machine's Lagrangian with its friction, all parameters given; angles [rad] are zero hanging down.
``acceleration`` is what a reference needs (``symo_exp.evaluation.references``).
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property

import torch
from jaxtyping import Float
from torch import Tensor
from typing_extensions import override

from symo_exp.checks import real
from symo_exp.errors import ConfigError
from symo_exp.mechanics.lagrangian import Lagrangian, solve
from symo_exp.systems import complex_step
from symo_exp.words import counted

SHARP = 100.0
"""The slope [s/rad] of dry friction ``c atan(100 v)`` about standstill."""


@dataclass(frozen=True, kw_only=True)
class Rig(Lagrangian):
    """``d/dt ∂ℒ/∂v − ∂ℒ/∂q = F(v, u)``: a Lagrangian, and forces of motors and friction.

    A subclass gives ``mass_matrix``, ``potential`` and ``force``, the first two in analytic
    functions. Parameters are finite numbers or lists of them, one for each link.
    """

    gravity: float = 9.81

    def __post_init__(self) -> None:
        for field in fields(self):
            key, value = f"reference.{field.name}", getattr(self, field.name)
            many = isinstance(value, Sequence) and not isinstance(value, str)
            checked = tuple(real(key, x) for x in value) if many else real(key, value)
            vars(self)[field.name] = checked

    @abstractmethod
    def force(
        self, v: Float[Tensor, "batch n"], u: Float[Tensor, "batch m"]
    ) -> Float[Tensor, "batch n"]:
        """Return the generalised force [N m] of the motors and of friction."""

    def acceleration(
        self, q: Float[Tensor, "batch n"], v: Float[Tensor, "batch n"], u: Float[Tensor, "batch m"]
    ) -> Float[Tensor, "batch n"]:
        """Return ``v̇ = H⁻¹ (F − Ḣ v + ∂ℒ/∂q)`` [rad/s²]."""
        rates = complex_step.rates(self, q, v)
        return solve(rates.mass, self.force(v, u) - rates.mass_rate_v + rates.q)


@dataclass(frozen=True, kw_only=True)
class FreeChain(Rig):
    """A chain of n links that swings freely, in absolute angles, with viscous friction in joints.

    With ``Mᵢ = Σ_{k>i} m_k``, what link i carries::

        Hᵢᵢ = Iᵢ + mᵢ aᵢ² + Mᵢ Lᵢ²,   Hᵢⱼ = (mⱼ aⱼ + Mⱼ Lⱼ) Lᵢ cos(qᵢ − qⱼ) for i < j
        V = −g Σᵢ (mᵢ aᵢ + Mᵢ Lᵢ) cos qᵢ,   F = −Aᵀ diag(k) A v,   A v = (v₁, v₂ − v₁, …)

    ``mass`` [kg], ``centre`` a [m] (of mass, from the joint above), ``inertia`` I [kg m²] (about
    it) and ``friction`` k [N m s] have a value for each link, ``length`` L [m] (from joint to
    joint) for each but the last. There is no input; one that is given has no effect.
    """

    mass: tuple[float, ...]
    centre: tuple[float, ...]
    length: tuple[float, ...]
    inertia: tuple[float, ...]
    friction: tuple[float, ...]

    def __post_init__(self) -> None:
        super().__post_init__()
        n = len(self.mass)
        wanted = {"centre": n, "length": n - 1, "inertia": n, "friction": n}
        for name, count in wanted.items():
            if len(getattr(self, name)) != count:
                raise ConfigError(
                    f"reference.{name}={list(getattr(self, name))}: expected "
                    f"{counted(count, 'value')} for {counted(n, 'link')} of reference.mass"
                )

    @cached_property
    def _carried(self) -> Tensor:
        mass = _numbers(self.mass)
        return mass.flip(0).cumsum(0).flip(0) - mass

    @cached_property
    def _moment(self) -> Tensor:
        length = _numbers((*self.length, 0.0))
        return _numbers(self.mass) * _numbers(self.centre) + self._carried * length

    @cached_property
    def _coupling(self) -> Tensor:
        length = _numbers((*self.length, 0.0))
        own = _numbers(self.inertia) + _numbers(self.mass) * _numbers(self.centre) ** 2
        upper = torch.triu(length[:, None] * self._moment, 1)
        return upper + upper.T + torch.diag(own + self._carried * length**2)

    @cached_property
    def _damping(self) -> Tensor:
        friction = _numbers(self.friction)
        below = torch.diag(friction.new_ones(len(friction) - 1), -1)
        joints = torch.eye(len(friction), dtype=friction.dtype) - below
        return joints.T @ torch.diag(friction) @ joints

    @override
    def mass_matrix(self, q: Float[Tensor, "batch n"]) -> Float[Tensor, "batch n n"]:
        return self._coupling.to(q) * (q.unsqueeze(-1) - q.unsqueeze(-2)).cos()

    @override
    def potential(self, q: Float[Tensor, "batch n"]) -> Float[Tensor, " batch"]:
        return -self.gravity * (self._moment.to(q) * q.cos()).sum(-1)

    @override
    def force(self, v: Tensor, u: Tensor) -> Tensor:
        return -v @ self._damping.to(v)


@dataclass(frozen=True, kw_only=True)
class MotorPendulum(Rig):
    """A pendulum on a geared motor, ``J v̇ + c g sin q + d v + f atan(100 v) + o = u``.

    ``inertia`` J [kg m²] about the joint, ``moment`` c [kg m] (mass times distance of its centre),
    ``viscous`` d [N m s], ``dry`` f [N m] and ``offset`` o [N m] of the torque.
    """

    inertia: float
    moment: float
    viscous: float
    dry: float
    offset: float

    @override
    def mass_matrix(self, q: Float[Tensor, "batch 1"]) -> Float[Tensor, "batch 1 1"]:
        return torch.full_like(q, self.inertia).unsqueeze(-1)

    @override
    def potential(self, q: Float[Tensor, "batch 1"]) -> Float[Tensor, " batch"]:
        return -self.gravity * self.moment * q.cos().sum(-1)

    @override
    def force(self, v: Tensor, u: Tensor) -> Tensor:
        return u - self.viscous * v - self.dry * (SHARP * v).atan() - self.offset


@dataclass(frozen=True, kw_only=True)
class MotorDoublePendulum(Rig):
    """Two links on geared motors at shoulder and elbow, ``q₂`` relative to link 1.

    With gear ratio G and rotor inertia R, and links' inertia I about their joints::

        H₁₁ = I₁ + I₂ + m₂ l₁² + 2 m₂ l₁ r₂ cos q₂ + G² R + R
        H₁₂ = I₂ + m₂ l₁ r₂ cos q₂ − G R,   H₂₂ = I₂ + G² R
        V = −g ((m₁ r₁ + m₂ l₁) cos q₁ + m₂ r₂ cos(q₁ + q₂))
        F = u − diag(d) v − diag(f) atan(100 v)

    ``mass`` m [kg], ``inertia`` I [kg m²], ``centre`` r [m], ``viscous`` d [N m s], ``dry`` f
    [N m] for each link, ``length`` l₁ [m], ``rotor`` R [kg m²].
    """

    mass: tuple[float, float]
    inertia: tuple[float, float]
    centre: tuple[float, float]
    length: float
    rotor: float
    gear: float
    viscous: tuple[float, float]
    dry: tuple[float, float]

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("mass", "inertia", "centre", "viscous", "dry"):
            if len(getattr(self, name)) != 2:
                raise ConfigError(f"reference.{name}={getattr(self, name)}: expected two values")

    @override
    def mass_matrix(self, q: Float[Tensor, "batch 2"]) -> Float[Tensor, "batch 2 2"]:
        coupling = self.mass[1] * self.length * self.centre[1] * q[:, 1].cos()
        rotor, geared = self.rotor, self.gear**2 * self.rotor
        links = sum(self.inertia) + self.mass[1] * self.length**2
        first = links + 2 * coupling + geared + rotor
        both = self.inertia[1] + coupling - self.gear * rotor
        second = torch.full_like(both, self.inertia[1] + geared)
        return torch.stack([first, both, both, second], -1).unflatten(-1, (2, 2))

    @override
    def potential(self, q: Float[Tensor, "batch 2"]) -> Float[Tensor, " batch"]:
        shoulder = self.mass[0] * self.centre[0] + self.mass[1] * self.length
        elbow = self.mass[1] * self.centre[1]
        return -self.gravity * (shoulder * q[:, 0].cos() + elbow * q.sum(-1).cos())

    @override
    def force(self, v: Tensor, u: Tensor) -> Tensor:
        viscous, dry = (_numbers(x).to(v) for x in (self.viscous, self.dry))
        return u - viscous * v - dry * (SHARP * v).atan()


def _numbers(values: Sequence[float]) -> Tensor:
    return torch.tensor(tuple(values), dtype=torch.float64)
