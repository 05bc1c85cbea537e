"""Ground truth: trajectories of a known system, by SciPy in float64."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from scipy.integrate import DOP853, RK23, RK45
from torch import Tensor

from symo_exp.checks import one_of, real
from symo_exp.errors import ConfigError
from symo_exp.mechanics.types import Trajectories
from symo_exp.systems.base import LagrangianSystem

METHODS = {"RK23": RK23, "RK45": RK45, "DOP853": DOP853}
MOST_STEPS = 5_000
"""Steps of the solver between two nodes, of which ten are usual."""
Slope = Callable[[int, float, np.ndarray], np.ndarray]
"""``ẋ`` of states (batch, N + n), from a node and the time [s] since it."""

Settle = Callable[[np.ndarray], np.ndarray]
"""Puts the states at a node back on the space that they belong to."""


@dataclass(frozen=True)
class Solver:
    """Settings of SciPy's integrators, which integrate all trajectories together.

    Its error norm is a root mean square over all states; tolerances divided by √B make it
    bound every single trajectory as its tolerances would. The integrator stops at every node, which
    therefore has no interpolation error, and continues with its last step size.
    """

    method: str = "DOP853"
    rtol: float = 1e-10
    atol: float = 1e-10

    def __post_init__(self) -> None:
        one_of("data.solver.method", self.method, tuple(METHODS))
        real("data.solver.rtol", self.rtol, low=1e-12, high=0.1)
        real("data.solver.atol", self.atol, low=1e-14, high=0.1)

    def integrate(
        self,
        slope: Slope,
        start: Float[np.ndarray, "batch states"],
        nodes: int,
        h: float,
        settle: Settle,
    ) -> Float[np.ndarray, "nodes batch states"]:
        """Return the states at every node.

        Args:
            slope: ``ẋ``.
            start: States at the first node.
            nodes: Number of nodes.
            h: Time between them [s].
            settle: Applied to the states at every node after the first.

        Raises:
            ConfigError: If the integrator fails.
        """
        states = np.empty((nodes, *start.shape))
        states[0], step = start, None
        for k in range(nodes - 1):
            reached, step = self._advance(slope, k, states[k], h, step)
            states[k + 1] = settle(reached)
        return states

    def _advance(
        self, slope: Slope, k: int, x: np.ndarray, h: float, first_step: float | None
    ) -> tuple[np.ndarray, float | None]:
        """Return the states at node ``k + 1`` and the step size to begin the next with."""
        scale = 1 / math.sqrt(max(len(x), 1))
        stepper = METHODS[self.method](
            lambda t, y: slope(k, t, y.reshape(x.shape)).ravel(), 0.0, x.ravel(), h,
            rtol=self.rtol * scale, atol=self.atol * scale, first_step=first_step,
        )  # fmt: skip
        message = None
        for _ in range(MOST_STEPS):
            message = stepper.step()
            if stepper.status != "running":
                break
        else:
            raise self.failed(k, f"more than {MOST_STEPS} steps")
        if stepper.status == "failed" or not np.isfinite(stepper.y).all():
            raise self.failed(k, message or "not finite")
        return stepper.y.reshape(x.shape), min(stepper.h_abs, h)

    def failed(self, k: int, reason: str) -> ConfigError:
        """Return the error of a step from node ``k`` that failed."""
        return ConfigError(
            f"data.solver={self.method} with rtol={self.rtol:g}, atol={self.atol:g} failed between "
            f"nodes {k} and {k + 1}: {reason}; try larger tolerances or milder parameters"
        )


def simulate(
    system: LagrangianSystem,
    q0: Float[Tensor, "batch N"],
    v0: Float[Tensor, "batch n"],
    u: Float[Tensor, "batch *nodes m"] | Callable[[float], Float[Tensor, "batch m"]],
    steps: int,
    solver: Solver,
) -> Trajectories:
    """Integrate ``v̇ = H⁻¹ (B u + F_d − Ḣ v + ∂ℒ/∂q)`` over so many steps of ``system.time_step``.

    ``u`` is (batch, m), constant along a trajectory, or (batch, steps + 1, m), one value a node,
    held from a node to the next; or a function of time [s], 0 at the first node, whose values at
    the nodes the trajectories hold. Angles are not wrapped. The entries of rotations are
    integrated, ``Ṙ = R [ω]``, and the rotation next to them is taken at every node. float64.
    """
    space, widths = system.space, [system.coordinates.width, system.coordinates.n]
    h, drive = system.time_step, u if callable(u) else None
    if callable(u):
        controls = torch.stack([u(k * h).double() for k in range(steps + 1)], dim=1)
    elif u.dim() == 3:
        controls = u.double()
    else:
        controls = u.double().unsqueeze(1).expand(-1, steps + 1, -1)

    @torch.no_grad()
    def slope(k: int, t: float, x: np.ndarray) -> np.ndarray:
        q, v = torch.from_numpy(x).split(widths, dim=1)
        force = controls[:, k] if drive is None else drive(k * h + t).double()
        return torch.cat([space.push(q, v), system.acceleration(q, v, force)], dim=1).numpy()

    def settle(x: np.ndarray) -> np.ndarray:
        q, v = torch.from_numpy(x).split(widths, dim=1)
        return torch.cat([space.normalised(q), v], dim=1).numpy()

    start = torch.cat([q0, v0], dim=1).double().numpy()
    states = solver.integrate(slope, start, controls.shape[1], h, settle)
    q, v = torch.from_numpy(states).transpose(0, 1).split(widths, dim=2)
    return Trajectories(q.contiguous(), v.contiguous(), controls.contiguous())
