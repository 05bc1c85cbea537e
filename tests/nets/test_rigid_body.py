"""The learned rigid body: a possible body for any parameters, and recovery."""

from __future__ import annotations

from functools import partial
from typing import Any

import pytest
import torch
from torch import Tensor

from symo_exp.data.noise import add_noise
from symo_exp.errors import ConfigError
from symo_exp.mechanics.galerkin import Galerkin
from symo_exp.mechanics.roots import Newton
from symo_exp.mechanics.types import Coordinates, Trajectories, Trajectory
from symo_exp.mechanics.windows import cut_windows
from symo_exp.models.objectives import PreconditionedResidual
from symo_exp.models.symo import SyMo
from symo_exp.nets.drag import LearnedBodyDrag
from symo_exp.nets.rigid_body import LearnedRigidBody
from symo_exp.optim.levenberg_marquardt import LevenbergMarquardt
from symo_exp.optim.total_least_squares import TotalLeastSquares
from symo_exp.systems.simulation import Solver, simulate
from symo_exp.systems.table import system as stated
from symo_exp.training.learner import Learner
from tests.differences import assert_gradients
from tests.learned import assert_jacobian, double_precision
from tests.models.methods import combinations, make
from tests.nets.test_closed_forms import BODIES, BODY_KINDS, PIVOT
from tests.systems.every import SYSTEMS
from tests.tables import arguments_of

ROOT = Newton(tolerance=1e-12, max_iterations=30)
TURNING = {name: system for name, system in SYSTEMS.items() if system.space.rotations}


@pytest.fixture(params=BODIES.values(), ids=BODIES)
def coordinates(request: pytest.FixtureRequest) -> Coordinates:
    found: Coordinates = request.param
    return found


def body(coordinates: Coordinates, kind: str) -> LearnedRigidBody:
    torch.manual_seed(1)
    return LearnedRigidBody(coordinates=coordinates, **BODY_KINDS[kind]).double()


def points(coordinates: Coordinates, rows: int = 3) -> tuple[Tensor, Tensor, Tensor]:
    generator = torch.Generator().manual_seed(2)
    q, v = torch.randn(2, rows, coordinates.n, generator=generator, dtype=torch.float64)
    u = torch.randn(rows, 2, generator=generator, dtype=torch.float64)
    return coordinates.space.of_vector(q), v, u


@pytest.mark.parametrize("kind", ["inputs", "networks"])
def test_forces_of_learned_inputs_have_derivatives_sample_by_sample(
    coordinates: Coordinates, kind: str
) -> None:
    found, (q, _, u) = body(coordinates, kind), points(coordinates)
    none = torch.zeros(coordinates.n, 2)
    assert_jacobian(lambda: found.input_force(none, q, u), list(found.parameters()))


def test_any_parameters_are_a_possible_body(coordinates: Coordinates) -> None:
    q, _, _ = points(coordinates, 16)
    for seed in range(20):
        found = body(coordinates, "parameters")
        torch.manual_seed(seed)
        with torch.no_grad():
            found.moments.normal_(0.0, 3.0)
        assert torch.linalg.eigvalsh(found.mass_matrix(q)).min() > 0.0
        moments = torch.linalg.eigvalsh(found.rigid_body(q).inertia[0])
        assert moments[2] < moments[0] + moments[1]


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"coordinates": Coordinates(("x",), (False,))}, "lagrangian=rigid_body is for one body"),
        (
            {"coordinates": Coordinates.of(rotations=("A", "B"))},
            "lagrangian=rigid_body is for one body",
        ),
        ({"coordinates": PIVOT, "initial_inertia": 0.0}, r"lagrangian\.initial_inertia=0"),
        ({"coordinates": PIVOT, "radius": -0.1}, r"lagrangian\.radius=-0.1"),
        ({"coordinates": PIVOT, "learned_inputs": -1}, r"lagrangian\.learned_inputs=-1"),
        ({"coordinates": PIVOT, "input_width": 4}, r"set lagrangian\.learned_inputs"),
    ],
)
def test_arguments_of_no_rigid_body_are_refused_in_one_line(
    given: dict[str, Any], text: str
) -> None:
    with pytest.raises(ConfigError, match=text):
        LearnedRigidBody(**given)


def test_another_number_of_inputs_is_refused() -> None:
    found, (q, _, u) = body(PIVOT, "inputs"), points(PIVOT)
    with pytest.raises(ConfigError, match="the system has 1 input"):
        found.input_force(torch.zeros(3, 1), q, u[:, :1])


def test_the_radius_is_the_unit_of_length_of_the_parameters(coordinates: Coordinates) -> None:
    q, v, u = points(coordinates)
    radius, forces, bodies, drags = 0.1, [], [], []
    for unit in (radius, 1.0):
        torch.manual_seed(1)
        found = LearnedRigidBody(coordinates=coordinates, learned_inputs=2, radius=unit).double()
        bodies.append(found.rigid_body(q))
        forces.append(found.input_force(torch.zeros(coordinates.n, 2), q, u))
        drags.append(LearnedBodyDrag(coordinates=coordinates, radius=unit).double().force(q, v))
    small, large = bodies
    torch.testing.assert_close(small.mass, large.mass)
    torch.testing.assert_close(small.moment, radius * large.moment)
    torch.testing.assert_close(small.inertia, radius**2 * large.inertia)
    for one, other in (forces, drags):
        torch.testing.assert_close(one[:, :-3], other[:, :-3])
        torch.testing.assert_close(one[:, -3:], radius**2 * other[:, -3:])


# Recovery


def motions(count: int, nodes: int, strength: float = 4.0) -> list[Trajectory]:
    """Motions of the true rigid body under constant torques, which spin it up in the long run."""
    system = stated("rigid_body")
    q, v, u = system.points(count, seed=0)
    path = simulate(system, q, v, strength * u, nodes - 1, Solver(rtol=1e-12, atol=1e-13))
    return path.each()


def learner(stages: int) -> Learner:
    """SyMo of a rigid body in float64."""
    system = stated("rigid_body")
    torch.manual_seed(0)
    with double_precision():
        model = SyMo(
            LearnedRigidBody, integrator=Galerkin(stages=stages), root=ROOT,
            objective=PreconditionedResidual(), **arguments_of(system),
        )  # fmt: skip
    return Learner(model)


def inertia_error(found: Learner) -> float:
    """Relative error of the inertia and of the weight's moment."""
    true, learned = stated("rigid_body"), found.model.lagrangian
    q, _, _ = true.points(8, seed=3)
    mass = float((learned.mass_matrix(q) - true.mass_matrix(q)).norm() / true.mass_matrix(q).norm())
    slopes = [x.gradients(q, torch.zeros(8, 3).double()).q for x in (learned, true)]
    return max(mass, float((slopes[0] - slopes[1]).norm() / slopes[1].norm()))


@pytest.mark.slow
def test_inertia_and_centre_are_recovered_from_exact_poses() -> None:
    found, windows = learner(3), cut_windows(motions(2, 12))
    optimizer = LevenbergMarquardt(found.parameters())
    for _ in range(25):
        if float(optimizer.epoch(found, [windows])["train_loss"]) < 1e-24:
            break
    assert inertia_error(found) < 1e-6


def pendulum(seed: int) -> SyMo:
    """A body on a pivot with one input to be learned, before training."""
    torch.manual_seed(seed)
    with double_precision():
        return SyMo(
            partial(LearnedRigidBody, learned_inputs=1), coordinates=PIVOT, time_step=0.02,
            input_matrix=torch.zeros(3, 1), integrator=Galerkin(stages=1), root=ROOT,
            objective=PreconditionedResidual(),
        )  # fmt: skip


@pytest.mark.parametrize(
    "seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(2, 5))]
)
@pytest.mark.parametrize("axis", range(3))
def test_a_pendulum_about_any_axis_is_found_from_any_start(axis: int, seed: int) -> None:
    """Large inertias about the other axes must not hide torques about these."""
    truth, across = pendulum(0), (axis + 1) % 3
    with torch.no_grad():
        factor = torch.diag(torch.tensor([0.2, 0.2, 0.2, 1.0]).double())
        factor[3, across] = 0.5
        row, column = torch.tril_indices(4, 4)
        truth.lagrangian.moments.copy_(factor[row, column])
        truth.lagrangian.gravity.zero_()[across] = 9.81
        truth.lagrangian.inputs.zero_()[axis] = 1.0
    phi, rates = torch.zeros(2, 8, 3).double()
    phi[:, axis] = torch.linspace(-3.0, 3.0, 8)
    rates[:, axis] = torch.linspace(1.0, -1.0, 8)
    u = torch.tensor([0.0, 1.5, -2.0, 0.5, -1.0, 2.0, -0.5, 1.0]).double()
    u = u[:, None, None].expand(-1, 12, 1)
    path = truth.for_evaluation().rollout(truth.flow.space.of_vector(phi), rates, u)
    windows = cut_windows(Trajectories(path.q, path.v, u).each())
    found = Learner(pendulum(seed))
    optimizer = LevenbergMarquardt(found.parameters())
    losses = (float(optimizer.epoch(found, [windows])["train_loss"]) for _ in range(20))
    assert any(loss < 1e-20 for loss in losses)


@pytest.mark.slow
def test_inertia_and_centre_are_recovered_from_noisy_poses() -> None:
    """1e-3 rad on 16 motions of 100 nodes, by total least squares."""
    found, noisy = learner(2), add_noise(motions(16, 100, strength=1.0), 1e-3, 5)
    optimizer = TotalLeastSquares(
        found.parameters(), epsilons=(0.1, 0.03), starts=1, start=20, epochs=10
    )
    while not optimizer.finished:
        optimizer.epoch(found, noisy)
    assert inertia_error(found) < 2e-3


# All methods


@pytest.mark.parametrize(
    ("name", "method", "integrator"),
    [pytest.param(name, *pair, marks=[pytest.mark.slow] * ((i - j) % len(TURNING) not in (0, 2)))
     for i, pair in enumerate(combinations()) for j, name in enumerate(TURNING)],
)  # fmt: skip
def test_every_method_has_a_loss_and_its_gradient(name: str, method: str, integrator: str) -> None:
    """Gradients of all parameters, against differences along random directions."""
    system = TURNING[name]
    q, v, u = system.points(4, seed=0)
    path = simulate(system, q, v, u, 2, Solver())
    samples = cut_windows(path.each())
    model = make(method, integrator, system.coordinates.n, **arguments_of(system))
    assert_gradients(
        lambda: model.objective(model.flow, samples).loss, list(model.parameters()), eps=1e-5,
        atol=1e-9, rtol=1e-4,
    )  # fmt: skip
