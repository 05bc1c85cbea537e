"""The error over many steps: zero at the truth, its derivatives, robustness and recovery."""

from functools import cache, partial

import pytest
import torch
from torch.nn.utils import parameters_to_vector, vector_to_parameters

from symo_exp.errors import ConfigError
from symo_exp.mechanics.explicit import RK4
from symo_exp.mechanics.roots import Newton
from symo_exp.mechanics.types import Stretches, Trajectories, Trajectory
from symo_exp.mechanics.variational import VariationalMidpoint
from symo_exp.models.e2e_symo import E2ESyMo
from symo_exp.models.horizon import HorizonError
from symo_exp.models.l_node import LNODE
from symo_exp.nets.known import KnownLagrangian
from symo_exp.optim.lbfgs import LBFGS
from symo_exp.optim.levenberg_marquardt import LevenbergMarquardt
from symo_exp.optim.robust import huber_weights
from symo_exp.systems.table import system as stated
from symo_exp.training.learner import Learner
from tests.jobs import refusal
from tests.models.methods import flows, make, make_small, pairwise
from tests.tables import arguments_of

STEPS = 4
EVERY = pytest.mark.parametrize(("method", "integrator", "n"), pairwise(flows()))


def motions(model, noise: float = 0.0) -> Stretches:
    """Motions of a model from small random states under smooth inputs, with noise."""
    generator, space = torch.Generator().manual_seed(7), model.flow.space
    x, v = 0.3 * torch.randn(2, 4, model.coordinates.n, dtype=torch.float64, generator=generator)
    t = torch.arange(STEPS + 1, dtype=torch.float64)[:, None]
    u = torch.sin(t + torch.randn(4, 1, 1, dtype=torch.float64, generator=generator))
    path = model.flow.rollout(space.of_vector(x), v, u)
    moved = torch.randn(path.v.shape, dtype=torch.float64, generator=generator)
    unknown = torch.full_like(v, torch.nan).repeat(1, 2)
    return Stretches(space.retract(path.q, noise * moved), u, unknown, 0.2 + moved.abs())


def slope(model, way, value, size=1e-4):
    """``value()`` along a direction of the parameters, by central differences."""
    place, ends = parameters_to_vector(model.parameters()).detach(), []
    for step in (size, -size):
        with torch.no_grad():
            vector_to_parameters(place + step * way, model.parameters())
            ends.append(value())
    return (ends[0] - ends[1]) / (2.0 * size)


def gradient_of(residuals, model):
    return parameters_to_vector(torch.autograd.grad(residuals.loss, list(model.parameters())))


def direction(model):
    generator = torch.Generator().manual_seed(1)
    size = sum(p.numel() for p in model.parameters())
    return torch.randn(size, dtype=torch.float64, generator=generator)


@EVERY
def test_the_error_vanishes_at_the_truth_and_has_the_derivatives_of_fitted_motions(
    method, integrator, n
):
    model, objective = make(method, integrator, n), HorizonError(horizon=STEPS)
    samples, way = motions(model), direction(model)
    found = objective.linearised(model.flow, samples, list(model.parameters()))
    assert found.residuals.abs().max() < 1e-9
    difference = slope(model, way, lambda: objective(model.flow, samples).values)
    assert difference.abs().max() > 1e-4
    torch.testing.assert_close(
        found.parameters @ way, difference, rtol=1e-3, atol=1e-3 * float(difference.abs().max())
    )


def assert_gradient(model, samples):
    """The gradient of the loss is the same backwards, forwards as ``Jᵀr``, and as a difference."""
    objective, way = HorizonError(horizon=STEPS), direction(model)
    flat = gradient_of(objective(model.flow, samples), model)
    found = objective.linearised(model.flow, samples, list(model.parameters()))
    forwards = 2.0 * (found.parameters.flatten(0, 1).T @ found.residuals.flatten())
    torch.testing.assert_close(
        forwards / found.residuals.numel(), flat, rtol=1e-6, atol=1e-8 * float(flat.abs().max())
    )
    difference = slope(model, way, lambda: objective(model.flow, samples).loss)
    assert float(flat @ way) == pytest.approx(float(difference), rel=2e-2)


@EVERY
def test_gradients_are_those_of_the_loss_with_noise(method, integrator, n):
    model = make(method, integrator, n)
    assert_gradient(model, motions(model, noise=0.01))


OPTIMIZERS = {"gauss_newton": (LevenbergMarquardt, 8), "gradients": (LBFGS, 5)}
METHODS = {
    "e2e_symo": (E2ESyMo, {"integrator": VariationalMidpoint(), "root": Newton(tolerance=1e-12)}),
    "l_node": (LNODE, {"integrator": RK4()}),
}


@cache
def identified(method, optimizer, *, outliers=0.0, huber=1.345):
    """Mass and length of a driven pendulum, from a start off by a third, of noisy configurations.

    The motions are the model's own with a mass and a length of one. The angle of one node in fifty
    is wrong by ``outliers`` [rad].
    """

    def pendulum(**constants):
        system = stated("pendulum", time_step=0.05, **constants)
        kind, arguments = METHODS[method]
        return system, kind(
            partial(KnownLagrangian, system=system, fixed=["gravity"]),
            **arguments_of(system),
            **arguments,
        ).double()

    system, truth = pendulum()
    q, v, u = system.box.points(5, 3)
    u = u[:, None].expand(-1, 21, -1)
    q = truth.flow.rollout(q, v, u).q
    generator = torch.Generator().manual_seed(1)
    noise = 3e-4 * torch.randn(q.shape, dtype=torch.float64, generator=generator)
    wrong = torch.rand(q.shape, dtype=torch.float64, generator=generator) < 0.02
    trajectories = Trajectories(q + noise + outliers * wrong, q, u).each()
    _, model = pendulum(mass=1.3, length=0.8)
    make_optimizer, epochs = OPTIMIZERS[optimizer]
    objective = HorizonError(horizon=10, huber=huber, grow=1)
    learner = Learner(model, objective=objective, optimizer=make_optimizer)
    steps, samples = learner.configure_optimizers()[0][0], objective.cut(trajectories)
    for epoch in range(epochs):
        steps.epoch(learner, objective.prepare(model.flow, [samples], epoch))
    constants = model.lagrangian.constants()
    return torch.stack([constants["mass"], constants["length"]]).detach()


@pytest.mark.slow
@pytest.mark.parametrize("optimizer", ["gauss_newton", "gradients"])
@pytest.mark.parametrize("method", METHODS)
def test_a_pendulum_is_recovered_from_noisy_configurations(method, optimizer):
    found = identified(method, optimizer)
    assert (found - 1.0).abs().max() < 3e-3


@pytest.mark.slow
def test_outliers_hardly_change_the_estimate():
    """Least squares are misled by them."""
    without, robust, squares = (
        identified("e2e_symo", "gauss_newton", **kind)
        for kind in ({}, {"outliers": 0.3}, {"outliers": 0.3, "huber": None})
    )
    assert (robust - without).abs().max() < 0.2 * (squares - without).abs().max()


def test_weighted_squares_have_the_gradient_of_hubers_loss():
    e = torch.linspace(-1.0, 1.0, 21, dtype=torch.float64)[:, None] * torch.tensor([1.0, 5.0])
    weight = huber_weights(e, 1.345)
    c = 1.345 * 1.4826 * e.abs().median(0).values
    assert 0.5 < (weight == 1.0).double().mean() < 1.0
    torch.testing.assert_close(2.0 * weight * e, 2.0 * e.clamp(-c, c))
    assert (huber_weights(torch.zeros(3, 1).double(), 1.345) == 1.0).all()


def test_the_threshold_of_two_errors_lies_between_them():
    e = torch.tensor([[1.0], [9.0]], dtype=torch.float64)
    assert huber_weights(e, 1.0)[:, 0].tolist() == pytest.approx([1.0, 1.4826 * 5.0 / 9.0])


def test_a_motion_that_is_lost_has_constant_residuals():
    """One stretch jumps further than any motion; the others keep their derivatives."""
    model, objective = make("l_node", "rk4", 2), HorizonError(horizon=STEPS)
    samples = motions(model, noise=0.01)
    samples.q[1, 2] += 1e3
    assert float(objective(model.flow, samples).statistics["lost"]) == 0.25
    found = objective.linearised(model.flow, samples, list(model.parameters()))
    assert found.residuals.isfinite().all()
    assert (found.parameters[1] == 0.0).all()
    assert_gradient(model, samples)


@pytest.mark.parametrize(("method", "integrator"), [("l_node", "rk4"), ("e2e_symo", "midpoint")])
@pytest.mark.parametrize("n", [2, pytest.param(3, marks=pytest.mark.slow)])
def test_a_small_machine_has_the_same_residuals_weights_and_lost_motions(method, integrator, n):
    """Each in the units of its coordinates; one length jumps, and its motion is lost."""
    objective, found = HorizonError(horizon=STEPS), []
    model, (small, sizes) = make(method, integrator, n), make_small(method, integrator, n)
    samples, kept = motions(model, noise=0.01), [0, 2, 3]
    samples.q[1, -1, 1] += 30.0
    samples.weight[1, -1, 1] = 0.0
    for one, unit in ((model, torch.ones(n).double()), (small, sizes)):
        given = samples._replace(q=samples.q * unit)
        (robust,) = objective.prepare(one.flow, [given], 100)
        residuals = objective(one.flow, given)
        linear = objective.linearised(one.flow, given, list(one.parameters()))
        assert float(residuals.statistics["lost"]) == 0.25
        found.append((
            robust.weight[kept], linear.residuals, linear.parameters, residuals.values,
            gradient_of(residuals, one),
        ))  # fmt: skip
    torch.testing.assert_close(found[1], found[0], rtol=1e-5, atol=1e-8)


def test_stretches_grow_and_end_with_their_trajectories():
    objective = HorizonError(horizon=5, stride=2, grow=3)
    assert [objective.steps(epoch) for epoch in (0, 2, 3, 6, 100)] == [2, 2, 4, 5, 5]
    nodes = torch.arange(9.0, dtype=torch.float64)[:, None]
    whole = [Trajectory(k + nodes[:count], nodes[:count], -nodes[:count]) for k, count in
             ((0, 9), (50, 5), (100, 6))]  # fmt: skip
    found = objective.cut(whole)
    assert found.q[:, 0, 0].tolist() == [0.0, 2.0, 100.0]
    assert all((row.diff() == 1.0).all() for row in found.q[..., 0])
    assert torch.equal(found.u[1, :, 0], -nodes[2:8, 0])
    with pytest.raises(ConfigError, match=r"longest .* has 4 steps"):
        objective.cut(whole[1:2])


HORIZON = ["objective=horizon", "system=pendulum"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["model=symo"], "choose model=e2e_symo"),
        (["model=node", "objective.horizon=1"], "expected 2 steps or more"),
        (["model=node", "objective.stride=0"], "objective.stride=0"),
        (["model=node", "objective.huber=-1"], "objective.huber=-1"),
        (["model=node", "objective.grow=-1"], "objective.grow=-1"),
        (["model=node", "dtype=float32", "optimizer=adam"], "dtype=float64"),
        (["model=l_node", "optimizer=total_least_squares"], "optimizer=levenberg_marquardt"),
    ],
)
def test_settings_that_cannot_work_are_refused(words, said):
    assert said in refusal(*HORIZON, *words)
