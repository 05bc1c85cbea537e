"""Models of systems with rotations: derivatives of a step, the control behind a motion, fits."""

from __future__ import annotations

from functools import partial

import pytest
import torch

from symo_exp.errors import ConfigError
from symo_exp.mechanics.explicit import RK4
from symo_exp.mechanics.galerkin import Galerkin
from symo_exp.mechanics.roots import Newton
from symo_exp.mechanics.types import Coordinates
from symo_exp.models.base import DynamicsModel
from symo_exp.models.flows import ExplicitFlow
from symo_exp.models.horizon import HorizonError
from symo_exp.models.starts import Fit, fitted_start
from symo_exp.models.true import TrueOde, TrueVariational
from symo_exp.nets.drag import LearnedBodyDrag
from symo_exp.nets.rigid_body import LearnedRigidBody
from symo_exp.systems.base import LagrangianSystem
from symo_exp.systems.table import system as stated
from symo_exp.use.environments import environment
from tests.models.methods import make
from tests.models.test_horizon import assert_gradient, motions
from tests.tables import arguments_of

ROOT = Newton(tolerance=1e-12, max_iterations=30)
NAMES = ["rigid_body", "quadrotor"]
PIVOT = Coordinates.of(rotations=("R",))
FREE = Coordinates.of(("x", "y", "z"), (False,) * 3, ("R",))
PAIRS = {"explicit": ("l_node", "rk4"), "variational": ("e2e_symo", "galerkin4")}


def model_of(system: LagrangianSystem, kind: str) -> DynamicsModel:
    shared = arguments_of(system)
    if kind == "explicit":
        return TrueOde(system, integrator=RK4(), **shared).double()
    return TrueVariational(system, integrator=Galerkin(stages=2), root=ROOT, **shared).double()


@pytest.mark.parametrize("kind", ["explicit", "variational"])
@pytest.mark.parametrize("name", NAMES)
def test_linearisation_is_along_rotations(name: str, kind: str) -> None:
    system = stated(name)
    model, space = model_of(system, kind), system.space
    q, v, u = system.points(2, seed=0)
    found, n, eps = model.linearize(q, v, u), system.coordinates.n, 1e-6
    for i in range(2 * n + u.shape[1]):
        unit = torch.zeros(2 * n + u.shape[1], dtype=torch.float64)
        unit[i] = eps
        place, rate, control = unit.split((n, n, u.shape[1]))
        ends = [
            model.step(space.retract(q, s * place.expand_as(v)), v + s * rate, u + s * control)
            for s in (1.0, -1.0)
        ]
        moved = space.difference(ends[1].q, ends[0].q) / (2 * eps)
        expected = torch.cat((moved, (ends[0].v - ends[1].v) / (2 * eps)), dim=1)
        column = torch.cat((found.A, found.B), dim=2)[:, :, i]
        torch.testing.assert_close(column, expected, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("kind", ["explicit", "variational"])
@pytest.mark.parametrize("name", NAMES)
def test_inverse_dynamics_finds_the_control_behind_a_motion(name: str, kind: str) -> None:
    system = stated(name)
    model = model_of(system, kind)
    q, v, u = system.points(3, seed=1)
    path = model.rollout(q, v, u.unsqueeze(1).expand(-1, 3, -1))
    found = model.inverse_dynamics(*path.q.unbind(1))
    torch.testing.assert_close(found, u, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("kind", ["explicit", "variational"])
@pytest.mark.parametrize("name", NAMES)
def test_no_motions_have_no_steps(name: str, kind: str) -> None:
    system = stated(name)
    q, v, u = (x[:0] for x in system.points(2, seed=0))
    path = model_of(system, kind).rollout(q, v, u.unsqueeze(1).expand(-1, 3, -1))
    assert path.q.shape == (0, 3, q.shape[1])


def test_a_fitted_start_is_that_of_the_motion() -> None:
    system = stated("quadrotor")
    model = model_of(system, "variational")
    q, v, u = system.points(3, seed=1)
    controls = u.unsqueeze(1).expand(-1, 6, -1)
    path = model.rollout(q, v, controls)
    start = fitted_start(model, path.q, controls, space=system.space)
    torch.testing.assert_close(start.q, q, rtol=0, atol=1e-6)
    torch.testing.assert_close(start.v, v, rtol=0, atol=1e-4)


def test_a_start_is_fitted_to_turns_beyond_a_whole_one() -> None:
    system = stated("rigid_body", gravity=(0.0, 0.0, 0.0))
    model = model_of(system, "explicit")
    q, _, u = system.points(1, seed=1)
    v = torch.tensor([[0.5, 30.0, -0.3]]).double()
    controls = 0.0 * u.unsqueeze(1).expand(-1, round(7.0 / 30.0 / system.time_step) + 1, -1)
    path = model.rollout(q, v, controls)
    start = fitted_start(model, path.q, controls, space=system.space)
    torch.testing.assert_close(start.v, v, rtol=1e-6, atol=1e-6)


class OnlyRollsOut:
    """A model that does not know the derivatives of its rollouts."""

    def __init__(self, model: DynamicsModel) -> None:
        self.rollout = model.rollout


@pytest.mark.parametrize("kind", ["explicit", "variational"])
@pytest.mark.parametrize("name", NAMES)
def test_derivatives_of_a_fit_are_those_of_differences(name: str, kind: str) -> None:
    system = stated(name)
    model, space = model_of(system, kind), system.space
    q, v, u = system.points(3, seed=1)
    controls = u.unsqueeze(1).expand(-1, 6, -1)
    measured = model.rollout(q, v, controls).q
    x = torch.cat((space.origin(q), v), dim=1) + 0.3 * torch.sin(torch.arange(2.0 * v.shape[1]))
    weight = torch.ones(*measured.shape[:2], v.shape[1], dtype=torch.float64)
    found, expected = (
        Fit(one, measured, controls, weight, space).at(x) for one in (model, OnlyRollsOut(model))
    )
    torch.testing.assert_close(found.residual, expected.residual, rtol=0, atol=1e-10)
    torch.testing.assert_close(found.slopes, expected.slopes, rtol=1e-6, atol=1e-7)


def test_features_that_rotations_lack_are_refused_in_one_line() -> None:
    system = stated("rigid_body")
    model = model_of(system, "variational")
    q, v, _ = system.points(2, seed=0)
    with pytest.raises(ConfigError, match="intervals are computed for lengths and angles"):
        model.rollout_interval(q, v, steps=2)
    field = model_of(system, "explicit").flow.field  # type: ignore[union-attr]
    with pytest.raises(ConfigError, match=r"model\.sensitivity=adjoint"):
        ExplicitFlow(field, RK4(), 0.1, sensitivity="adjoint")
    with pytest.raises(ConfigError, match=r"q0 has shape|q has shape"):
        model.rollout(v, v, steps=1)


@pytest.mark.parametrize("name", NAMES)
def test_a_motion_does_not_start_from_a_matrix_that_is_no_rotation(name: str) -> None:
    system = stated(name)
    model, flat = model_of(system, "explicit"), system.coordinates.n - 3
    q, v, _ = system.points(2, seed=0)
    mirror = torch.eye(3, dtype=torch.float64) * torch.tensor([1.0, 1.0, -1.0])
    for wrong in (torch.zeros(3, 3), 1.1 * torch.eye(3), mirror):
        bad = q.clone()
        bad[1, flat:] = wrong.flatten()
        with pytest.raises(ConfigError, match="q0 has no rotation matrix in row 1") as caught:
            model.rollout(bad, v, steps=1)
        assert "\n" not in str(caught.value)
        env = environment(model, system=system)
        with pytest.raises(ConfigError, match="expected rotation matrices"):
            env.reset(options={"q": bad[1].numpy()})
    assert model.rollout(q.float(), v, steps=1).converged.all()


def learned(kind: str, free: bool) -> DynamicsModel:
    """A model of a heavy body with drag, learned in all parameters."""
    coordinates, pair = FREE if free else PIVOT, PAIRS[kind]
    model: DynamicsModel = make(
        *pair, coordinates.n, coordinates=coordinates, input_matrix=torch.zeros(coordinates.n, 1),
        time_step=0.1, lagrangian=partial(LearnedRigidBody, learned_inputs=1),
        dissipation=LearnedBodyDrag,
    )  # fmt: skip
    return model


@pytest.mark.parametrize("free", [False, True], ids=["pivot", "free"])
@pytest.mark.parametrize("kind", ["explicit", "variational"])
def test_the_error_over_many_steps_vanishes_at_the_truth(kind: str, free: bool) -> None:
    model = learned(kind, free)
    residuals = HorizonError(horizon=4)(model.flow, motions(model))
    assert float(residuals.values.detach().abs().max()) < 1e-9


@pytest.mark.parametrize(
    "free", [False, pytest.param(True, marks=pytest.mark.slow)], ids=["pivot", "free"]
)
@pytest.mark.parametrize("kind", ["explicit", "variational"])
def test_gradients_over_many_steps_are_those_of_the_loss_with_noise(kind: str, free: bool) -> None:
    model = learned(kind, free)
    assert_gradient(model, motions(model, noise=0.02))
