"""Fits of a machine in other units take the same steps."""

from functools import partial

import pytest
import torch

from symo_exp.mechanics.explicit import RK4
from symo_exp.mechanics.galerkin import Galerkin
from symo_exp.mechanics.roots import Newton
from symo_exp.mechanics.scaled import ScaledLagrangian
from symo_exp.mechanics.types import Coordinates, Trajectory
from symo_exp.mechanics.units import SI, Units
from symo_exp.mechanics.variational import VariationalMidpoint
from symo_exp.mechanics.windows import cut_windows
from symo_exp.models.e2e_symo import E2ESyMo
from symo_exp.models.l_node import LNODE
from symo_exp.models.objectives import PreconditionedResidual, Residual
from symo_exp.models.symo import SyMo
from symo_exp.nets.dissipation import MachineFriction
from symo_exp.nets.lagrangians import NetworkLagrangian, PlanarLagrangian
from symo_exp.nets.springs import LinearSprings
from symo_exp.optim.levenberg_marquardt import LevenbergMarquardt
from symo_exp.optim.total_least_squares import TotalLeastSquares
from symo_exp.training.learner import Learner

CASES = [
    (VariationalMidpoint(), (False, True)),
    (VariationalMidpoint(), (True, False, True)),
    (Galerkin(stages=2), (False, True)),
]
UNITS = [
    Units(2.0**-20, 2.0**-10, 2.0**10),
    Units(2.0**10, 1.0, 2.0**-10),
    Units(1.0, 1.0, 2.0**-30),
]
"""Powers of two, exact in single precision, in which models are made here."""
STEP = 0.02


def motions(units, angular):
    """Smooth motions with noise, the same in any units; and the inputs' matrix."""
    generator = torch.Generator().manual_seed(len(angular))
    t = STEP * torch.arange(30, dtype=torch.float64).unsqueeze(1)
    waves = torch.rand(2, len(angular), generator=generator, dtype=torch.float64)
    noise = torch.randn(30, len(angular), generator=generator, dtype=torch.float64)
    q = torch.sin((1.0 + 3.0 * waves[0]) * t + 6.0 * waves[1]) + 1e-3 * noise
    sizes = _coordinates(units, angular).sizes
    trajectory = Trajectory(q * sizes, torch.zeros_like(q), torch.cos(3.0 * t))
    return [trajectory], (units.size("N m") / sizes).unsqueeze(1)


def fitted(units, angular, integrator, lagrangian):
    """Return the noise and a rollout of a model after some steps in some units."""
    torch.manual_seed(0)
    data, input_matrix = motions(units, angular)
    coordinates = _coordinates(units, angular)
    model = SyMo(
        lagrangian,
        coordinates=coordinates,
        input_matrix=input_matrix,
        time_step=STEP * units.time,
        integrator=integrator,
        root=Newton(tolerance=1e-10, max_iterations=50),
        dissipation=partial(MachineFriction, stribeck=True, constant=True),
        springs=LinearSprings,
        objective=PreconditionedResidual(),
    ).double()
    optimizer = TotalLeastSquares(
        model.parameters(), epsilons=(1.0,), starts=1, start=1, epochs=2, input_weight=1e-2,
        damping=1e-2,  # the least one depends on the units of parameters, but not where steps end
    )  # fmt: skip
    while not optimizer.finished:
        metrics = optimizer.epoch(Learner(model), data)
    q = data[0].q[:2] / coordinates.sizes
    start = q[:1] * coordinates.sizes, (q[1:] - q[:1]) / STEP * coordinates.sizes / units.time
    path = model.for_evaluation().rollout(*start, data[0].u[None, :6])
    return float(metrics["noise_estimate"]), path.q / coordinates.sizes


LAGRANGIANS = [partial(PlanarLagrangian, relative=True), partial(NetworkLagrangian, width=3)]


@pytest.mark.parametrize(
    ("lagrangian", "integrator", "angular", "units"),
    [pytest.param(lagrangian, *case, units, marks=[pytest.mark.slow] * ((i + j - k) % 3 != 0))
     for i, lagrangian in enumerate(LAGRANGIANS)
     for j, case in enumerate(CASES) for k, units in enumerate(UNITS)],
)  # fmt: skip
def test_a_fit_in_other_units_has_the_same_predictions(lagrangian, integrator, angular, units):
    expected = fitted(SI, angular, integrator, lagrangian)
    found = fitted(units, angular, integrator, lagrangian)
    torch.testing.assert_close(found, expected, rtol=1e-4, atol=1e-5)


VARIATIONAL = {
    "integrator": VariationalMidpoint(),
    "root": Newton(tolerance=1e-10, max_iterations=50),
}
METHODS = {
    "residual": partial(SyMo, objective=Residual(), **VARIATIONAL),
    "preconditioned": partial(SyMo, objective=PreconditionedResidual(), **VARIATIONAL),
    "root error": partial(E2ESyMo, **VARIATIONAL),
    "state error": partial(LNODE, integrator=RK4()),
}


@pytest.mark.parametrize(
    "units", [UNITS[1], pytest.param(Units(2.0**-40, 1.0, 2.0**20), marks=pytest.mark.slow)]
)
@pytest.mark.parametrize("method", METHODS)
def test_lengths_and_angles_have_the_same_weight_in_any_unit_of_length(method, units):
    """Also of outliers, which count linearly, however small a motion is in metres."""
    angular, found = (False, True), []
    for given in (SI, units):
        torch.manual_seed(0)
        coordinates = _coordinates(given, angular)
        (motion,), input_matrix = motions(given, angular)
        motion.q[15] += 0.1 * coordinates.sizes
        v = torch.gradient(motion.q, spacing=STEP, dim=0)[0]
        model = METHODS[method](
            partial(NetworkLagrangian, width=3), coordinates=coordinates,
            input_matrix=input_matrix, time_step=STEP,
        ).double()  # fmt: skip
        optimizer = LevenbergMarquardt(model.parameters(), huber=3.0, force_epochs=1)
        samples, losses = cut_windows([motion._replace(v=v)]), []
        for _ in range(5):
            losses.append(float(optimizer.epoch(Learner(model), [samples])["train_loss"]))
        found.append(losses)
    assert found[1] == pytest.approx(found[0], rel=1e-4, abs=0.0)


@pytest.mark.parametrize("angular", [(False, False), (False, True)])
@pytest.mark.parametrize("integrator", [VariationalMidpoint(), Galerkin(stages=2)])
def test_a_step_in_other_units_takes_as_many_iterations(integrator, angular):
    """Also in single precision, whose roundings of metres are larger than a small machine."""
    generator = torch.Generator().manual_seed(1)
    q, v = torch.randn(2, 6, 2, generator=generator)
    found = []
    for units in (SI, Units(2.0**-20, 1.0, 1.0)):
        torch.manual_seed(0)
        coordinates = _coordinates(units, angular)
        model = SyMo(
            partial(NetworkLagrangian, width=8),
            coordinates=coordinates,
            input_matrix=torch.zeros(2, 1),
            time_step=0.3,
            integrator=integrator,
            root=Newton(tolerance=1e-5, max_iterations=20),
        )
        step = model.step(q * coordinates.sizes, v * coordinates.sizes)
        found.append((step.q / coordinates.sizes, step.iterations, step.converged))
    torch.testing.assert_close(found[1], found[0])
    assert found[0][1].max() > 1


@pytest.mark.parametrize("angular", [(False,), (False, True), (True, False, True)])
def test_units_are_exact_in_double_precision_after_single_precision(angular):
    coordinates = _coordinates(Units(1e-6, 1e-3, 1e-5), angular)
    model = ScaledLagrangian(NetworkLagrangian(coordinates=coordinates, width=3), coordinates)
    x = torch.ones(1, len(angular)).double()
    for found in (model.double(), model.float().double()):
        torch.testing.assert_close(
            found.scale.inside(x, x)[0], x / coordinates.sizes, rtol=1e-15, atol=0.0
        )
        expected = coordinates.units.size("N m") / coordinates.sizes * x
        torch.testing.assert_close(found.scale.force(x), expected, rtol=1e-15, atol=0.0)
    assert model.float().scale.place.dtype == torch.float32


def _coordinates(units, angular):
    return Coordinates(tuple(map(str, range(len(angular)))), angular, units=units)
