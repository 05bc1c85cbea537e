"""A forced motion of a chain of pendulums, and the order of a method along it."""

import functools
import math
from collections.abc import Callable

import pytest
import torch
from scipy.integrate import solve_ivp
from torch import Tensor

from symo_exp.mechanics.euler_lagrange import acceleration
from symo_exp.mechanics.lagrangian import Lagrangian
from symo_exp.mechanics.roots import Newton
from symo_exp.mechanics.variational import DiscreteLagrangian, Forces, VariationalIntegrator

DURATION = 0.4


def force_at(n: int, t: float, *, forced: bool) -> Tensor:
    """A generalised force that varies linearly in time: the first-order hold is exact for it."""
    if not forced:
        return torch.zeros(1, n, dtype=torch.float64)
    return torch.linspace(1.0, 2.0, n, dtype=torch.float64).unsqueeze(0) * (0.5 - 2.0 * t)


def start(n: int) -> tuple[Tensor, Tensor]:
    """A state far from equilibrium."""
    q = torch.linspace(0.7, 1.9, n, dtype=torch.float64).unsqueeze(0)
    return q, torch.linspace(1.0, -1.5, n, dtype=torch.float64).unsqueeze(0)


@functools.cache
def reference(
    lagrangian: Lagrangian, n: int, *, forced: bool, duration: float = DURATION
) -> Tensor:
    """The configuration after ``duration`` by SciPy's DOP853, an independent method."""

    def field(t: float, x: Tensor) -> Tensor:
        q, v = torch.as_tensor(x).reshape(2, 1, n)
        return torch.cat((v, acceleration(lagrangian, q, v, force_at(n, t, forced=forced)))).ravel()

    x0 = torch.cat(start(n)).ravel()
    solution = solve_ivp(field, (0, duration), x0, method="DOP853", rtol=1e-13, atol=1e-13)
    return torch.as_tensor(solution.y[:n, -1]).unsqueeze(0)


TIGHT = Newton(tolerance=1e-13, max_iterations=50)


def roll(
    method: VariationalIntegrator,
    lagrangian: Lagrangian,
    q: Tensor,
    p: Tensor,
    steps: int,
    h: float,
    *,
    forced: bool = False,
) -> tuple[Tensor, Tensor]:
    """Configurations and momenta of a rollout, from node 0."""
    n, discrete = q.shape[1], DiscreteLagrangian(method, lagrangian, h)
    configurations, momenta = [q], [p]
    for k in range(steps):
        forces = Forces(*(force_at(n, i * h, forced=forced) for i in (k, k + 1)))
        q, p, _ = discrete.step(TIGHT, q, p, forces, q + h * lagrangian.velocity(q, p))
        configurations.append(q)
        momenta.append(p)
    return torch.stack(configurations), torch.stack(momenta)


ROUNDING = 2e-13
"""Errors below this tell nothing of the order."""


def refinement(order: int, n: int) -> tuple[float, tuple[int, ...]]:
    """Duration and numbers of steps at which errors of ``order`` are asymptotic, above rounding.

    Beyond order 6 that leaves a single pendulum: with more links, errors of double precision are
    still those of their first terms.
    """
    if order <= 4:
        return DURATION, (16, 24, 32)
    if order <= 6:
        return DURATION, (8, 10, 12)
    if n > 1:
        pytest.skip("errors are at rounding before they are asymptotic")
    return 5 * DURATION, (11, 12, 13)


def order(integrate: Callable[[int], Tensor], exact: Tensor, steps: tuple[int, ...]) -> float:
    """Slope of log error against log step, over the three finest steps above rounding."""
    finest: list[tuple[float, float]] = []
    for count in sorted(steps, reverse=True):
        error = (integrate(count) - exact).norm().item()
        finest += [(error, 1.0 / count)] if error > ROUNDING else []
        if len(finest) == 3:
            break
    assert len(finest) == 3
    errors, sizes = ([math.log(x) for x in column] for column in zip(*finest, strict=True))
    mean_x, mean_y = sum(sizes) / len(sizes), sum(errors) / len(errors)
    slope = sum((x - mean_x) * (y - mean_y) for x, y in zip(sizes, errors, strict=True))
    return slope / sum((x - mean_x) ** 2 for x in sizes)
