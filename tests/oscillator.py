"""Oscillators whose motion is known in closed form, and models of them that are right or wrong."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from torch import Tensor

from symo_exp.mechanics.lagrangian import Lagrangian
from symo_exp.mechanics.types import Coordinates, Trajectories, Trajectory, Windows
from symo_exp.models.flows import Rollout, Step


@dataclass(frozen=True)
class Oscillator(Lagrangian):
    """``H = diag(m)``, ``V = ½ Σ k q²``: ``q(t) = q₀ cos ωt + v₀/ω sin ωt``, ``ω² = k/m``."""

    mass: Tensor
    stiffness: Tensor

    @property
    def lagrangian(self) -> Oscillator:
        return self

    def mass_matrix(self, q: Tensor) -> Tensor:
        return torch.diag(self.mass).to(q).expand(len(q), -1, -1) + 0.0 * q[:, :1, None]

    def potential(self, q: Tensor) -> Tensor:
        return 0.5 * (self.stiffness.to(q) * q.square()).sum(-1)

    def flow(self, q: Tensor, v: Tensor, t: float) -> tuple[Tensor, Tensor]:
        w = (self.stiffness / self.mass).sqrt().to(q)
        c, s = torch.cos(w * t), torch.sin(w * t)
        return q * c + v / w * s, v * c - w * q * s


def oscillator(n: int) -> Oscillator:
    i = torch.arange(1.0, n + 1, dtype=torch.float64)
    return Oscillator(mass=i, stiffness=3.0 / i)


class Data(NamedTuple):
    integration: Trajectories
    recorded = False

    def trajectories(self, part: str) -> list[Trajectory]:
        return self.integration.each()


def data(system: Oscillator, h: float, steps: int = 30, batch: int = 3) -> Data:
    n = len(system.mass)
    generator = torch.Generator().manual_seed(n)
    q, v = torch.randn(2, batch, n, dtype=torch.float64, generator=generator)
    nodes = [system.flow(q, v, h * k) for k in range(steps + 2)]
    q, v = (torch.stack(x, dim=1) for x in zip(*nodes, strict=True))
    return Data(Trajectories(q, v, torch.zeros_like(q[..., :1])))


@dataclass(frozen=True)
class Exact:
    """A model that steps by the exact flow of its Lagrangian, plus a constant ``bias``."""

    lagrangian: Oscillator | None
    system: Oscillator
    time_step: float
    reads_velocity: bool = True
    bias: float = 0.0
    fails_from: int | None = None
    """The step from which predictions are NaN and no root is found."""
    float64: bool = False

    @property
    def coordinates(self) -> Coordinates:
        n = len(self.system.mass)
        return Coordinates(tuple(f"q{i}" for i in range(n)), (False,) * n)

    @property
    def input_matrix(self) -> Tensor:
        return torch.zeros(len(self.system.mass), 1, dtype=torch.float64)

    def for_evaluation(self) -> Exact:
        return replace(self, float64=True)

    def initial_velocity(self, samples: Windows) -> Tensor:
        return samples.v

    def step(self, q: Tensor, v: Tensor, u: Tensor, u_next: Tensor) -> Step:
        assert self.float64, "evaluation must ask for the float64 copy"
        q, v = self.system.flow(q, v, self.time_step)
        return Step(q + self.bias, v, torch.ones(len(q), dtype=torch.bool), torch.ones(len(q)))

    def predict(self, samples: Windows) -> Step:
        v = self.initial_velocity(samples)
        return self.step(samples.q, v, samples.u, samples.u_next)

    def rollout(self, q0: Tensor, v0: Tensor, u: Tensor, steps: int | None = None) -> Rollout:
        q, v, converged = [q0], [v0], []
        for k in range(u.shape[1] - 1):
            step = self.step(q[-1], v[-1], u[:, k], u[:, k + 1])
            fails = self.fails_from is not None and k >= self.fails_from
            q.append(torch.where(torch.tensor(fails), torch.nan, step.q))
            v.append(step.v)
            converged.append(step.converged & (not fails))
        return Rollout(torch.stack(q, 1), torch.stack(v, 1), torch.stack(converged, 1))


class Midpoint(Exact):
    """The implicit midpoint rule, which is what the variational midpoint is: closed form here.

    ``(1 + a²) v⁺ = (1 − a²) v − 2 (a ω) q`` with ``a = ωh/2``; it conserves quadratic energies.
    """

    def initial_velocity(self, samples: Windows) -> Tensor:
        w2 = (self.system.stiffness / self.system.mass).to(samples.q)
        h = self.time_step
        return (samples.q - samples.q_prev) / h - h / 4 * w2 * (samples.q + samples.q_prev)

    def step(self, q: Tensor, v: Tensor, u: Tensor, u_next: Tensor) -> Step:
        w = (self.system.stiffness / self.system.mass).sqrt().to(q)
        a = w * self.time_step / 2
        v_next = ((1 - a**2) * v - 2 * a * w * q) / (1 + a**2)
        q_next = q + self.time_step / 2 * (v + v_next)
        return Step(q_next, v_next, torch.ones(len(q), dtype=torch.bool), torch.ones(len(q)))
