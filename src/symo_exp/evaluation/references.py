"""Baselines and reference models."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import torch
from jaxtyping import Float
from torch import Tensor

from symo_exp.errors import ConfigError, first_line
from symo_exp.mechanics.explicit import RK4
from symo_exp.mechanics.space import FLAT, Space
from symo_exp.mechanics.types import Trajectories
from symo_exp.words import counted

SUBSTEPS = 10
"""Integration steps of a reference in a time step, so that the integrator's error is negligible."""


class Reference(Protocol):
    """A model in continuous time (``conf/reference``)."""

    def acceleration(
        self, q: Float[Tensor, "batch n"], v: Float[Tensor, "batch n"], u: Float[Tensor, "batch m"]
    ) -> Float[Tensor, "batch n"]:
        """Return ``v̇`` of a batch of states under the controls ``u``."""


def check_fit(reference: Reference, n: int, m: int) -> None:
    """Raise ``ConfigError`` unless a reference has ``n`` coordinates and ``m`` inputs."""
    q, u = torch.zeros(1, n, dtype=torch.float64), torch.zeros(1, m, dtype=torch.float64)
    reason = "it gives no finite acceleration at rest"
    try:
        found = reference.acceleration(q, q, u)
        if found.shape == q.shape and found.isfinite().all():
            return
    except (AttributeError, RuntimeError, ValueError, TypeError, IndexError) as error:
        reason = first_line(error)
    raise ConfigError(
        f"reference: {type(reference).__name__} does not fit a system of "
        f"{counted(n, 'coordinate')} and {counted(m, 'input')} ({reason}); choose the one of "
        "this machine, or reference=none"
    )


@dataclass(frozen=True)
class ConstantVelocity:
    """Motion at constant velocity, ``q_k = q_0 + k h v_0``: the baseline without any model."""

    time_step: float
    space: Space = FLAT

    def rollout(self, q0: Tensor, v0: Tensor, u: Tensor) -> Trajectories:
        """Return the motion from a start over as many nodes as ``u`` has."""
        t = self.time_step * torch.arange(u.shape[1]).to(q0)
        v = v0[:, None].expand(-1, len(t), -1)
        start = q0[:, None].expand(-1, len(t), -1)
        return Trajectories(self.space.retract(start, t[:, None] * v), v, u)


@dataclass(frozen=True)
class Continuous:
    """A reference over time steps: Runge-Kutta of order 4, the input linear between nodes."""

    reference: Reference
    time_step: float
    substeps: int = SUBSTEPS
    space: Space = FLAT

    def rollout(self, q0: Tensor, v0: Tensor, u: Tensor) -> Trajectories:
        """Return the motion from a start over as many nodes as ``u`` has."""
        method, h = RK4(), self.time_step / self.substeps
        q, v = [q0], [v0]
        for before, after in zip(u[:, :-1].unbind(1), u[:, 1:].unbind(1), strict=True):
            state, slope = (q[-1], v[-1]), (after - before) / self.substeps
            for i in range(self.substeps):
                ends = before + i * slope, before + (i + 1) * slope
                state = method.step(self.reference.acceleration, *state, *ends, h, self.space)
            q.append(state[0])
            v.append(state[1])
        return Trajectories(torch.stack(q, 1), torch.stack(v, 1), u)
