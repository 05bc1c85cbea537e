"""Simulation: accuracy, conservation, inputs."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from scipy.integrate import solve_ivp

from symo_exp.errors import ConfigError
from symo_exp.evaluation.rollouts import along
from symo_exp.systems.base import LagrangianSystem
from symo_exp.systems.chain import ChainPendulum
from symo_exp.systems.simulation import Solver, simulate
from tests.systems.every import SYSTEMS, points

every_system = pytest.mark.parametrize("name", SYSTEMS)
TIGHT = Solver("DOP853", rtol=1e-12, atol=1e-13)


@every_system
def test_work_of_the_input_is_the_energy_gained(name: str) -> None:
    """Under a constant input ``ΔE = (B u)ᵀ Δq``; without one, energy is conserved.

    A constant torque in body axes has no potential.
    """
    system = SYSTEMS[name]
    q, v, u = points(system, 2)
    u[: None if system.space.rotations else 1] = 0.0
    path = simulate(system, q, v, u, 10, Solver())
    energy = along(system.energy, path.q, path.v)
    kinetic = along(system.kinetic, path.q, path.v)
    way = system.space.along(path.q) - system.space.along(path.q)[:, :1]
    work = ((u @ system.input_matrix.T).unsqueeze(1) * way).sum(-1)
    torch.testing.assert_close(energy - energy[:, :1], work, rtol=1e-7, atol=1e-7)
    assert (kinetic - kinetic[:, :1]).abs().amax(1).min() > 1e-2  # they did move


def alone(system: LagrangianSystem, q: torch.Tensor, v: torch.Tensor, u: torch.Tensor, steps: int):
    """One trajectory by ``solve_ivp``, much more accurately, never stopping at the nodes."""
    n = system.coordinates.n

    def slope(_: float, x: np.ndarray) -> np.ndarray:
        state = torch.from_numpy(x).view(1, -1)
        acceleration = system.acceleration(state[:, :n], state[:, n:], u.view(1, -1))
        return np.concatenate([x[n:], acceleration[0].numpy()])

    times = system.time_step * np.arange(steps + 1)
    start = torch.cat([q, v]).numpy()
    solution = solve_ivp(
        slope, (0, times[-1]), start, t_eval=times, method="DOP853", rtol=1e-11, atol=1e-12
    )
    return torch.from_numpy(solution.y.T)


@pytest.mark.parametrize("name", ["pendulum", "chain_2"])
def test_every_trajectory_of_a_batch_meets_the_tolerance(name: str) -> None:
    system = SYSTEMS[name]
    q, v, u = points(system, 4)
    steps = 4
    path = simulate(system, q, v, u, steps, Solver("RK45", rtol=1e-6, atol=1e-6))
    for row in range(4):
        exact = alone(system, q[row], v[row], u[row], steps)
        found = torch.cat([path.q[row], path.v[row]], 1)
        assert ((found - exact).abs() / (1 + exact.abs())).max() < 1e-4
    reference = alone(system, q[0], v[0], u[0], steps)
    tight = simulate(system, q[:1], v[:1], u[:1], steps, TIGHT)
    torch.testing.assert_close(
        torch.cat([tight.q[0], tight.v[0]], 1), reference, rtol=1e-9, atol=1e-9
    )


@pytest.mark.parametrize("method", ["RK45", "DOP853"])
def test_smaller_tolerances_give_smaller_errors(method: str) -> None:
    system = SYSTEMS["pendulum"]
    q, v, u = points(system, 8)
    exact = simulate(system, q, v, u, 5, TIGHT)
    errors = [
        (simulate(system, q, v, u, 5, Solver(method, tol, tol)).q - exact.q).abs().max()
        for tol in (1e-4, 1e-10)
    ]
    assert errors[1] < errors[0] / 20
    assert errors[1] < 1e-8


def test_inputs_are_held_from_node_to_node() -> None:
    system = ChainPendulum(2)
    q, v, _ = points(system, 3)
    u = torch.randn(3, 6, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    whole = simulate(system, q, v, u, 5, TIGHT)
    for k in range(5):
        one = simulate(system, whole.q[:, k], whole.v[:, k], u[:, k], 1, TIGHT)
        torch.testing.assert_close(one.q[:, 1], whole.q[:, k + 1], rtol=1e-10, atol=1e-10)
    torch.testing.assert_close(whole.u, u)


def test_angles_are_not_wrapped() -> None:
    zero = torch.zeros(1, 1)
    spinning = simulate(SYSTEMS["pendulum"], zero, zero + 20.0, zero, 20, Solver())
    assert spinning.q[0, -1, 0] > 30
    assert (spinning.q[0].diff(dim=0) > 0).all()


def test_a_failed_simulation_names_solver_and_nodes() -> None:
    system = dataclasses.replace(SYSTEMS["pendulum"], gravity=1e300)
    with (
        pytest.raises(ConfigError, match=r"data\.solver=DOP853.*nodes 0 and 1"),
        np.errstate(all="ignore"),
    ):
        simulate(system, torch.ones(1, 1), torch.ones(1, 1), torch.ones(1, 1), 3, Solver())


def test_a_simulation_ends_that_would_take_too_many_steps(monkeypatch) -> None:
    monkeypatch.setattr("symo_exp.systems.simulation.MOST_STEPS", 50)
    system = dataclasses.replace(SYSTEMS["pendulum"], time_step=1e30)
    with pytest.raises(ConfigError, match=r"nodes 0 and 1: more than .* steps"):
        simulate(system, torch.ones(1, 1), torch.ones(1, 1), torch.ones(1, 1), 3, Solver("RK23"))


@pytest.mark.parametrize(
    ("arguments", "key"),
    [({"method": "Euler"}, "method"), ({"rtol": 0.0}, "rtol"), ({"atol": -1.0}, "atol")],
)
def test_bad_solvers_are_refused(arguments: dict, key: str) -> None:
    with pytest.raises(ConfigError, match=rf"data\.solver\.{key}.*expected"):
        Solver(**arguments)
