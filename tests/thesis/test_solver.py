"""The published trajectories: each equals that of ``solve_ivp`` alone."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from scipy.integrate import solve_ivp

from symo_exp.errors import ConfigError
from symo_exp.evaluation.evaluate import evaluate
from symo_exp.job.parts import build
from symo_exp.runs.folder import RunFolder
from symo_exp.systems.simulation import simulate
from symo_exp.thesis.solver import SolveIvp
from tests.jobs import job_of, settings_of
from tests.systems.every import SYSTEMS, points

NODES = 5


@pytest.mark.parametrize(
    "tolerances", [(1e-3, 1e-6), pytest.param((1e-1, 1e-2), marks=pytest.mark.slow)], ids=str
)
@pytest.mark.parametrize("name", SYSTEMS)
def test_a_trajectory_is_that_of_solve_ivp_node_by_node(name, tolerances) -> None:
    system, (rtol, atol) = SYSTEMS[name], tolerances
    q, v, u = points(system, 4)
    path = simulate(system, q, v, u, NODES, SolveIvp(rtol=rtol, atol=atol))
    n, space = system.coordinates.width, system.space
    for row in range(4):

        def slope(_: float, x: np.ndarray, row: int = row) -> np.ndarray:
            at = torch.from_numpy(x).view(1, -1)
            rate = system.acceleration(at[:, :n], at[:, n:], u[row : row + 1])
            return np.concatenate([space.push(at[:, :n], at[:, n:])[0].numpy(), rate[0].numpy()])

        x = torch.cat([q[row], v[row]]).numpy()
        for k in range(1, NODES + 1):
            x = solve_ivp(slope, (0, system.time_step), x, rtol=rtol, atol=atol).y[:, -1]
            x[:n] = space.normalised(torch.from_numpy(x[None, :n]))[0].numpy()
            found = torch.cat([path.q[row, k], path.v[row, k]]).numpy()
            np.testing.assert_allclose(found, x, rtol=1e-9, atol=1e-9)


def test_a_motion_that_overflows_is_refused() -> None:
    system = dataclasses.replace(SYSTEMS["pendulum"], gravity=1e300)
    one = torch.ones(2, 1)
    with pytest.raises(ConfigError, match="nodes 0 and 1: not finite"), np.errstate(all="ignore"):
        simulate(system, one, one, one, 3, SolveIvp())


def test_rest_stays_at_rest() -> None:
    system, zero = SYSTEMS["pendulum"], torch.zeros(1, 1)
    assert not simulate(system, zero, zero, zero, 2, SolveIvp()).q.any()


@pytest.mark.parametrize(
    "words", ["draws=published system=pendulum", "preset=thesis system=cartpole"]
)
def test_published_trajectories_are_those_of_the_experiments(words, workplace):
    pairs = ["-m", "model=l_node", "integrator=rk4,midpoint"]
    rk4, midpoint = settings_of(*words.split(), *pairs)
    assert rk4.system.gravity == midpoint.system.gravity == 9.81
    assert rk4.data.solver._target_.endswith("SolveIvp")
    assert rk4.model.rollout_integrator._target_.endswith("ClassicalRK4")
    assert midpoint.model.rollout_integrator is None
    (moon, _) = settings_of(*words.split(), *pairs, "system.gravity=1.62")
    assert moon.system.gravity == 1.62


@pytest.mark.slow
@pytest.mark.parametrize(("rollouts", "error"), [("ClassicalRK4", 0.735), ("RK4", 1.24)])
def test_the_true_pendulum_along_the_published_rollouts(rollouts, error, workplace):
    """The smallest error that L-NODE with RK4 can have, which depends on the rollout rule."""
    job = job_of(
        "draws=published", "system=pendulum", "model=true_ode", "integrator=rk4",
        f"integrator.rollout._target_=symo_exp.mechanics.explicit.{rollouts}",
        "data.n_traj=1", "data.n_train_max=1", "data.n_val=1", "data.n_test=1",
        "data.monitor_trajectories=null",
    )  # fmt: skip
    parts = build(job.values, RunFolder(workplace / "run"))
    parts.data.setup()
    found = evaluate(parts.model, parts.system, parts.data).measures
    assert found["integration_mse"] == pytest.approx(error, rel=0.01)
