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

from symo_exp.errors import ConfigError
from symo_exp.mechanics.types import Trajectories
from symo_exp.systems.base import LagrangianSystem
from symo_exp.systems.checks import one_of, real

METHODS = {"RK23": RK23, "RK45": RK45, "DOP853": DOP853}


@dataclass(frozen=True)
class Solver:
    """How SciPy integrates, with its names; the defaults of its ``solve_ivp`` are RK45, 1e-3, 1e-6.

    ``warm`` starts from a node with the step size proposed at the end of the step before. Without
    it every node begins with SciPy's cautious search for a first step, as repeated calls of
    ``solve_ivp`` do; at loose tolerances that makes the result more accurate.
    """

    method: str = "DOP853"
    rtol: float = 1e-10
    atol: float = 1e-10
    warm: bool = True

    def __post_init__(self) -> None:
        one_of("data.solver.method", self.method, tuple(METHODS))
        real("data.solver.rtol", self.rtol, low=1e-12, high=0.1)
        real("data.solver.atol", self.atol, low=1e-14, high=0.1)


def simulate(
    system: LagrangianSystem,
    q0: Float[Tensor, "batch n"],
    v0: Float[Tensor, "batch n"],
    u: Float[Tensor, "batch *nodes m"],
    steps: int,
    solver: Solver,
) -> Trajectories:
    """Integrate ``v̇ = H⁻¹ (B u − Ḣ v + ∂ℒ/∂q)`` over ``steps`` steps of ``system.time_step``.

    ``u`` is (batch, m), constant along a trajectory, or (batch, steps + 1, m), one value a node;
    the input is held from a node to the next. Angles are not wrapped. float64.

    All trajectories are integrated together. SciPy's error norm is a root mean square over all
    B·2n states; tolerances divided by √B make it bound every single trajectory as its tolerances
    would. The integrator stops at every node, which therefore has no interpolation error.
    """
    u = u.double()
    controls = u if u.dim() == 3 else u.unsqueeze(1).expand(-1, steps + 1, -1)
    return _integrate(system, q0, v0, controls, lambda k, _: controls[:, k], solver)


def simulate_driven(
    system: LagrangianSystem,
    q0: Float[Tensor, "batch n"],
    v0: Float[Tensor, "batch n"],
    drive: Callable[[float], Float[Tensor, "batch m"]],
    steps: int,
    solver: Solver,
) -> Trajectories:
    """The same under an input that is a function of time [s], the first node being at zero.

    The trajectories hold its values at the nodes.
    """
    h = system.time_step
    controls = torch.stack([drive(k * h).double() for k in range(steps + 1)], dim=1)
    return _integrate(system, q0, v0, controls, lambda k, t: drive(k * h + t).double(), solver)


def _integrate(
    system: LagrangianSystem,
    q0: Tensor,
    v0: Tensor,
    controls: Tensor,
    control: Callable[[int, float], Tensor],
    solver: Solver,
) -> Trajectories:
    """From node to node; ``control`` takes a node and the time [s] since it."""
    (batch, n), nodes, h = q0.shape, controls.shape[1], system.time_step
    scale = 1 / math.sqrt(max(batch, 1))
    rtol, atol = solver.rtol * scale, solver.atol * scale
    states = np.empty((nodes, 2 * n * batch))
    states[0] = torch.cat([q0, v0], dim=1).double().flatten().numpy()
    first_step = None
    for k in range(nodes - 1):

        @torch.no_grad()
        def slope(t: float, x: np.ndarray, k: int = k) -> np.ndarray:
            q, v = torch.from_numpy(x).view(batch, 2 * n).split(n, dim=1)
            rate = system.acceleration(q, v, control(k, t))
            return torch.cat([v, rate], dim=1).view(-1).numpy()

        stepper = METHODS[solver.method](
            slope, 0.0, states[k], h, rtol=rtol, atol=atol, first_step=first_step
        )
        message = None
        while stepper.status == "running":
            message = stepper.step()
        if stepper.status == "failed" or not np.isfinite(stepper.y).all():
            raise ConfigError(
                f"data.solver={solver.method} with rtol={solver.rtol:g}, atol={solver.atol:g} "
                f"failed between nodes {k} and {k + 1} of {type(system).__name__}: "
                f"{message or 'not finite'}; try larger tolerances or milder parameters"
            )
        states[k + 1] = stepper.y
        first_step = min(stepper.h_abs, h) if solver.warm else None
    path = torch.from_numpy(states).view(nodes, batch, 2 * n).transpose(0, 1)
    q, v = path.split(n, dim=2)
    return Trajectories(q.contiguous(), v.contiguous(), controls.contiguous())
