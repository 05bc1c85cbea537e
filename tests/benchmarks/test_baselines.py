"""The baselines are right (finite differences, float64), and JAX agrees with PyTorch."""

import functools
import itertools

import numpy as np
import pytest
import torch

from benchmarks.agreement import exact
from benchmarks.baseline_autograd import CLASSES, LNODE, E2ESyMo, SyMo
from benchmarks.cases import (
    CASES,
    METHODS,
    calm_weights,
    chain,
    random_windows,
    training_batch,
)
from benchmarks.contenders import Autograd, Jax, jax_is_installed
from benchmarks.project import Project, whole_fit
from benchmarks.run import hard_contenders

SMALL = [chain(1, 12), chain(2, 12), chain(3, 12)]
PAIRS = [
    pytest.param(method, case, id=f"{method}-{case.name}")
    for method, case in zip(METHODS, itertools.cycle(SMALL), strict=False)
]
"""Each method with one of the systems."""
TIGHT = {"symo": {"tolerance": 1e-11}, "e2e_symo": {"tolerance": 1e-11}}

needs_jax = pytest.mark.skipif(not jax_is_installed(), reason="JAX is not installed")


def reference(method, case):
    """Baseline (a) in float64, its roots converged, its gradient that of the step."""
    options = exact(method) | TIGHT.get(method, {})
    return Autograd(method, case, calm_weights(case, method), dtype=torch.float64, **options)


def windows(case, method, rows=6):
    """Windows; with three independent inputs for the methods that read them."""
    return random_windows(case, rows, hold_input=method in ("node", "l_node"))


@pytest.mark.parametrize(("method", "case"), PAIRS)
def test_gradient_is_that_of_the_loss(method, case):
    contender = reference(method, case)
    batch = windows(case, method)
    _, slope = contender.loss_and_gradient(batch)
    generator = torch.Generator().manual_seed(1)
    parameters = list(contender.model.parameters())
    direction = [torch.randn(p.shape, generator=generator, dtype=p.dtype) for p in parameters]
    pairs = list(zip(parameters, direction, strict=True))
    expected = sum((torch.from_numpy(g) * d).sum() for g, d in zip(slope, direction, strict=True))

    def move(distance):
        with torch.no_grad():
            for p, d in pairs:
                p.add_(distance * d)

    def loss_at(distance):
        move(distance)
        value = contender.model.loss(batch).item()
        move(-distance)
        return value

    finite = (loss_at(1e-5) - loss_at(-1e-5)) / 2e-5
    assert finite == pytest.approx(expected.item(), rel=1e-6)


@pytest.mark.parametrize("case", SMALL, ids=lambda case: case.name)
def test_residual_is_the_slope_of_the_discrete_action(case):
    """g = d/dq_k [L_d(q_{k-1}, q_k) + L_d(q_k, q_{k+1})] + h/4 B (u_{k-1} + 2 u_k + u_{k+1})."""
    model = SyMo(case, calm_weights(case, "symo"), torch.float64)
    w = windows(case, "symo")
    g = model.residuals(w).detach()
    for i in range(case.n):
        e = 1e-5 * torch.eye(case.n, dtype=torch.float64)[i]

        def action(q):
            return model.discrete_lagrangian(w.q_prev, q) + model.discrete_lagrangian(q, w.q_next)

        finite = (action(w.q + e) - action(w.q - e)).detach() / 2e-5
        matrix = torch.tensor(case.input_matrix, dtype=torch.float64)
        force = case.time_step / 4 * (w.u_prev + 2 * w.u + w.u_next) @ matrix[i]
        torch.testing.assert_close(g[:, i], finite + force, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("case", SMALL, ids=lambda case: case.name)
def test_root_solves_the_discrete_equations(case):
    model = E2ESyMo(case, calm_weights(case, "symo"), torch.float64, tolerance=1e-11)
    w = windows(case, "symo")
    g = model.discrete_euler_lagrange(w, model.predict(w))
    assert g.abs().max() < 1e-9
    assert 1 <= model.iterations < 10


@pytest.mark.parametrize("case", SMALL, ids=lambda case: case.name)
def test_energy_changes_by_the_power_of_the_input(case):
    """dE/dt = v . B u along the acceleration of L-NODE, E = 1/2 v^T H v + V."""
    model = LNODE(case, calm_weights(case, "l_node"), torch.float64)
    w = windows(case, "symo")
    a = model.acceleration(w.q, w.v, w.u).detach()

    def energy(q, v):
        mass, potential = model.mass_and_potential(q)
        return (0.5 * torch.einsum("bi,bij,bj->b", v, mass, v) + potential).detach()

    d = 1e-5
    rate = (energy(w.q + d * w.v, w.v + d * a) - energy(w.q - d * w.v, w.v - d * a)) / (2 * d)
    torch.testing.assert_close(rate, (w.v * model.force(w.u)).sum(1), rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("method", ["node", "l_node"])
def test_adjoint_tends_to_the_exact_gradient(method):
    """The adjoint of a step is another discretisation: it differs, and less at small steps."""
    from dataclasses import replace

    errors = []
    for h in (0.2, 0.05):
        case = replace(chain(2, 12), time_step=h)
        layers, w = calm_weights(case, method), random_windows(case, 6)
        exact, adjoint = (
            Autograd(method, case, layers, dtype=torch.float64, adjoint=a).loss_and_gradient(w)
            for a in (False, True)
        )
        assert exact[0] == adjoint[0]
        a, b = (np.concatenate([g.ravel() for g in x[1]]) for x in (exact, adjoint))
        errors.append(np.linalg.norm(a - b) / np.linalg.norm(a))
    assert 0 < errors[1] < errors[0] / 4 < 0.1


@pytest.mark.parametrize("method", METHODS)
def test_rollout_repeats_the_prediction(method):
    case = chain(2, 12)
    contender = reference(method, case)
    w = random_windows(case, 3)
    configurations = contender.rollout(w, 3)
    assert configurations.shape == (3, 3, 2)
    np.testing.assert_allclose(configurations[:, 0], contender.predict(w), rtol=1e-12)


def same_numbers(contender, method, case):
    """Loss, gradient, prediction and rollout are those of the reference."""
    truth, w = reference(method, case), windows(case, method)
    batch = contender.prepare(w)
    (loss, slope), (true_loss, true_slope) = (
        contender.loss_and_gradient(batch),
        truth.loss_and_gradient(w),
    )
    assert loss == pytest.approx(true_loss, rel=1e-9)
    for got, expected in zip(slope, true_slope, strict=True):
        np.testing.assert_allclose(got, expected, rtol=1e-7, atol=1e-10)
    np.testing.assert_allclose(contender.predict(batch), truth.predict(w), atol=1e-9)
    held = random_windows(case, 4)
    steps = contender.rollout(contender.prepare(held), 5)
    np.testing.assert_allclose(steps, truth.rollout(held, 5), atol=1e-8)


@needs_jax
@pytest.mark.parametrize(("method", "case"), PAIRS)
def test_jax_computes_the_same_numbers(method, case):
    import jax

    with jax.enable_x64(True):
        contender = Jax(method, case, calm_weights(case, method), **TIGHT.get(method, {}))
        same_numbers(contender, method, case)


@needs_jax
def test_jax_takes_the_optimiser_step_of_pytorch():
    import jax

    case = chain(2, 12)
    layers, w = calm_weights(case, "symo"), random_windows(case, 8)
    with jax.enable_x64(True):
        peer, truth = Jax("symo", case, layers), reference("symo", case)
        batch = peer.prepare(w)
        for _ in range(5):
            peer.train_step(batch)
            truth.train_step(w)
        got = peer.module.to_arrays(peer.parameters)
    for a, b in zip(got, truth.model.parameters(), strict=True):
        np.testing.assert_allclose(a, b.detach().numpy(), rtol=1e-9, atol=1e-10)


@pytest.mark.parametrize(("method", "case"), [*PAIRS, ("e2e_symo", CASES["cartpole"])])
def test_project_computes_the_same_numbers(method, case):
    layers = calm_weights(case, method)
    options = TIGHT.get(method, {})
    same_numbers(Project(method, case, layers, dtype=torch.float64, **options), method, case)


def test_contenders_take_steps_where_training_starts():
    windows = training_batch("pendulum", 8)
    for contender in hard_contenders("pendulum").values():
        batch = contender.prepare(windows)
        contender.train_step(batch)
        assert contender.iterations(batch, training=True) >= 1


def test_every_method_has_a_baseline():
    assert set(CLASSES) == set(METHODS)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["symo", "l_node"])
def test_the_time_of_a_fit_is_split_into_its_steps_and_the_rest(method):
    """By a clock that ticks once whenever it is read: twice around each epoch and around all."""
    case, clock = CASES["pendulum"], itertools.count()
    layers = calm_weights(case, method)
    tick = functools.partial(next, clock)
    with whole_fit(method, case, layers, 8, epochs=3, seconds=0.0, clock=tick) as fit:
        in_steps, whole = fit()
    assert (24 * in_steps, 24 * whole) == (3, 7)
