"""The error of an integrator with the true Lagrangian."""

import dataclasses
import functools

import pytest
import torch

from symo_exp.data.datamodule import TrajectoryData
from symo_exp.evaluation.evaluate import evaluate
from symo_exp.evaluation.measures import squared
from symo_exp.mechanics.explicit import RK4
from symo_exp.mechanics.galerkin import Galerkin
from symo_exp.mechanics.roots import Newton
from symo_exp.mechanics.variational import VariationalMidpoint
from symo_exp.models.true import TrueOde, TrueVariational
from symo_exp.systems.base import System
from tests.tables import arguments_of, systems

# test MSE over the sampling box of the thesis: variational midpoint, order 4, RK4
FLOORS = {
    "pendulum": (1.9e-5, 3.9e-8, 1.8e-8),
    "cartpole": (1.1e-8, 3.5e-13, 2.9e-12),
    "acrobot": (3.1e-8, 3.0e-12, 3.3e-12),
}
ROOT = Newton(tolerance=1e-10, max_iterations=20)


@functools.cache
def data(name: str) -> TrajectoryData:
    sets = TrajectoryData(
        system=systems()[name], n_traj=1, n_val=1, n_test=96, n_train_max=1, n_integration=2,
        integration_steps=40, dtype="float64",
    )  # fmt: skip
    sets.setup("test")
    return sets


def given(system: System) -> dict:
    return {"lagrangian": system, **arguments_of(system)}


@pytest.mark.parametrize(
    "name",
    ["pendulum", *(pytest.param(n, marks=pytest.mark.slow) for n in ("cartpole", "acrobot"))],
)
def test_the_true_lagrangian_has_the_known_error_of_the_integrator(name: str):
    system = systems()[name]
    sets = data(name)
    symo = TrueVariational(integrator=VariationalMidpoint(), root=ROOT, **given(system))
    l_node = TrueOde(integrator=RK4(), **given(system))
    midpoint, rk4 = evaluate(symo, system, sets).measures, evaluate(l_node, system, sets).measures

    assert midpoint["test_mse"] == pytest.approx(FLOORS[name][0], rel=0.5)
    assert rk4["test_mse"] == pytest.approx(FLOORS[name][2], rel=0.5)
    for found in (midpoint, rk4):
        assert found["inertia_mse_aligned"] == 0.0
        assert found["integration_diverged"] == 0.0
    assert midpoint["test_newton_failed"] == midpoint["integration_newton_failed"] == 0.0
    # finite differences measure a mismatch of half a step, not the motion
    assert midpoint["energy_mse"] < 0.1 * midpoint["energy_mse_fd"]
    assert torch.get_default_dtype() == torch.float32


@pytest.mark.slow
def test_a_true_system_with_friction_has_a_small_error_and_loses_energy():
    system = dataclasses.replace(systems()["cartpole"], viscous=[0.3, 0.01], coulomb=[0.1, 0.0])
    sets = TrajectoryData(
        system=system, n_traj=1, n_val=1, n_test=8, n_train_max=1, n_integration=2,
        integration_steps=60, dtype="float64",
    )  # fmt: skip
    sets.setup("test")
    frictionless = dict(given(system), lagrangian=systems()["cartpole"])
    found, without = (
        evaluate(TrueVariational(integrator=Galerkin(stages=2), root=ROOT, **one), system, sets)
        for one in (given(system), frictionless)
    )
    assert found.measures["test_mse"] < 1e-3 * without.measures["test_mse"]
    assert found.measures["energy_mse"] < 1e-4 * without.measures["energy_mse"]
    energy = found.rollouts.energy_true
    assert (energy[:, -1] < energy[:, 0]).all()


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.slow] * (n == "acrobot")) for n in FLOORS]
)
def test_the_error_falls_with_the_order(name: str):
    system = systems()[name]
    model = TrueVariational(integrator=Galerkin(stages=2), root=ROOT, **given(system))
    assert not model.learns
    samples = data(name).test
    predicted = model.for_evaluation().predict(samples)
    assert predicted.converged.all()
    assert squared(predicted.q - samples.q_next).mean().item() == pytest.approx(
        FLOORS[name][1], rel=0.5
    )
