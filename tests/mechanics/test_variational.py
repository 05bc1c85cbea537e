"""Variational integrators: order, symplecticity, momentum, energy, and their derivatives."""

from functools import cache, partial
from itertools import cycle

import pytest
import torch

from symo_exp.mechanics.euler_lagrange import acceleration
from symo_exp.mechanics.variational import DiscreteLagrangian, Forces
from symo_exp.systems.chain import ChainPendulum
from tests.differences import assert_gradients, slopes
from tests.dissipative import DISSIPATIVE, dissipative_chain
from tests.learned import learned_lagrangian
from tests.mechanics.motions import TIGHT, force_at, order, reference, refinement, roll, start
from tests.tables import explicit_integrators, systems, variational_integrators

METHODS = variational_integrators()
MOTIONS = {
    "free": (ChainPendulum, False),
    "forced": (ChainPendulum, True),
    "with friction": (cache(partial(dissipative_chain, rest_velocity=4.0)), True),
}
USUAL = [("forced", 1), ("free", 2), ("with friction", 3)]
"""Kinds of motion at numbers of coordinates; the others are tested among the long proofs."""


@pytest.mark.parametrize(
    ("kind", "n"),
    [pytest.param(kind, n, marks=[pytest.mark.slow] * ((kind, n) not in USUAL))
     for kind in MOTIONS for n in (1, 2, 3)],
)  # fmt: skip
@pytest.mark.parametrize("name", METHODS)
@torch.no_grad()
def test_order_of_convergence(name, kind, n):
    make, forced = MOTIONS[kind]
    method, lagrangian = METHODS[name], make(n)
    q, v = start(n)
    duration, counts = refinement(method.order, n)

    def integrate(steps):
        p = lagrangian.momentum(q, v)
        return roll(method, lagrangian, q, p, steps, duration / steps, forced=forced)[0][-1]

    slope = order(integrate, reference(lagrangian, n, forced=forced, duration=duration), counts)
    assert slope == pytest.approx(method.order, abs=0.3)


@pytest.mark.parametrize("n", [1, 2, 3])
@pytest.mark.parametrize("name", METHODS)
def test_steps_are_symplectic(name, n):
    """``Mᵀ Ω M = Ω`` for the derivative M of one step in ``(q, p)`` (thesis (3.28))."""
    method, chain, h = METHODS[name], ChainPendulum(n), 0.2
    q, v = start(n)
    x = torch.cat((q, chain.momentum(q, v)), dim=1)
    discrete, free = DiscreteLagrangian(method, chain, h), Forces(*torch.zeros(2, 1, n).to(q))

    def step(x):
        q, p = x[:, :n], x[:, n:]
        moved = discrete.step(TIGHT, q, p, free, q + h * chain.velocity(q, p))
        return torch.cat((moved.q, moved.p), dim=1)

    jacobian = torch.autograd.functional.jacobian(step, x).reshape(2 * n, 2 * n)
    eye = torch.eye(n, dtype=torch.float64)
    omega = torch.block_diag(eye, eye).roll(n, 0) * torch.tensor([[1.0]] * n + [[-1.0]] * n)
    torch.testing.assert_close(jacobian.T @ omega @ jacobian, omega, atol=1e-10, rtol=0)


def cyclic_coordinates():
    """Pairs (system, i) where coordinate i enters neither the inertia nor the potential."""
    found = []
    for name, system in systems().items():
        if system.coordinates.rotations:
            continue  # their body axes are no coordinates
        q = torch.linspace(0.3, 1.1, system.coordinates.n, dtype=torch.float64).unsqueeze(0)
        for i in range(q.shape[1]):
            moved = q.clone()
            moved[:, i] += 0.7
            same = (torch.equal(f(q), f(moved)) for f in (system.mass_matrix, system.potential))
            if all(same):
                found.append((name, i))
    return found


def test_there_is_a_cyclic_coordinate():
    assert ("cartpole", 0) in cyclic_coordinates()


@pytest.mark.parametrize(("system", "i"), cyclic_coordinates())
@pytest.mark.parametrize("name", METHODS)
@torch.no_grad()
def test_momentum_of_a_cyclic_coordinate_is_kept(name, system, i):
    """Without a force the momentum of a coordinate that does not enter ``ℒ`` is constant."""
    system = systems()[system]
    q, v = start(system.coordinates.n)
    momenta = roll(METHODS[name], system, q, system.momentum(q, v), 10, 0.05)[1][:, 0, i]
    assert (momenta - momenta[0]).abs().max() < 1e-11


@pytest.mark.parametrize(("system", "i"), cyclic_coordinates())
@pytest.mark.parametrize("name", explicit_integrators())
@torch.no_grad()
def test_explicit_steps_do_not_keep_the_momentum_of_a_cyclic_coordinate(name, system, i):
    system, method = systems()[system], explicit_integrators()[name]
    q, v = start(system.coordinates.n)
    u, before = torch.zeros_like(q), system.momentum(q, v)[0, i]
    for _ in range(100):
        q, v = method.step(lambda *x: acceleration(system, *x), q, v, u, u, 0.1)
    assert (system.momentum(q, v)[0, i] - before).abs() > 1e-9


@pytest.mark.parametrize("steps", [60, pytest.param(3000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", METHODS)
@torch.no_grad()
def test_energy_stays_bounded_over_long_times(name, steps):
    """The error oscillates: it is no larger at the end than at the beginning. Steps are as long as
    it takes to see it: in a tenth of a second order 10 errs by roundings alone."""
    chain, h = ChainPendulum(1), 0.1 if METHODS[name].order < 10 else 0.3
    q, v = start(1)
    configurations, momenta = roll(METHODS[name], chain, q, chain.momentum(q, v), steps, h)
    q, p = configurations[:, 0], momenta[:, 0]
    error = (chain.energy(q, chain.velocity(q, p)) - chain.energy(q, chain.velocity(q, p))[0]).abs()
    assert error[-steps // 3 :].max() < 1.05 * error[: steps // 3].max()


@torch.no_grad()
def test_energy_drifts_under_the_explicit_midpoint_rule():
    chain, h, drift = ChainPendulum(1), 0.1, []
    midpoint = explicit_integrators()["midpoint"]
    q, v = start(1)
    u = torch.zeros_like(q)
    for _ in range(300):
        q, v = midpoint.step(lambda *x: acceleration(chain, *x), q, v, u, u, h)
        drift.append(chain.energy(q, v).item())
    quarter = len(drift) // 4
    assert abs(drift[-1] - drift[0]) > 2 * abs(drift[quarter] - drift[0])


@pytest.mark.parametrize("name", METHODS)
@torch.no_grad()
def test_momentum_form_solves_the_discrete_euler_lagrange_equations(name):
    method, chain, h = METHODS[name], ChainPendulum(2), 0.1
    q, v = start(2)
    q, v = q.expand(3, 2) + torch.arange(3.0).unsqueeze(1), v.expand(3, 2)
    force = [force_at(2, k * h, forced=True).expand(3, 2) for k in range(3)]
    before, after = Forces(*force[:2]), Forces(*force[1:])
    discrete = DiscreteLagrangian(method, chain, h)
    q_mid, p, _ = discrete.step(TIGHT, q, chain.momentum(q, v), before, q + h * v)
    torch.testing.assert_close(discrete.momentum(q, q_mid, before), p)
    last = discrete.step(TIGHT, q_mid, p, after, 2 * q_mid - q)
    residual = discrete.residual(q, q_mid, last.q, before, after)
    assert last.root.converged.all()
    assert residual.abs().max() < 1e-12


def drawn(count, n):
    """Return ``count`` tensors of seven random rows."""
    generator = torch.Generator().manual_seed(5)
    return torch.randn(count, 7, n, dtype=torch.float64, generator=generator)


LAGRANGIANS = {
    "learned": lambda n: learned_lagrangian(tuple(i % 2 == 1 for i in range(n))),
    **DISSIPATIVE,
}


@pytest.mark.parametrize(
    ("name", "kind", "n"),
    [pytest.param(name, kind, n, marks=[pytest.mark.slow] * (n != 1 + (i + j) % 3))
     for i, name in enumerate(METHODS) for j, kind in enumerate(LAGRANGIANS) for n in (1, 2, 3)],
)  # fmt: skip
def test_jacobian_of_the_residual(name, kind, n):
    method, lagrangian, h = METHODS[name], LAGRANGIANS[kind](n), 0.1
    q0, v, *ends = drawn(4, n)
    q1, forces = q0 + h * v, Forces(*ends)
    jacobian = method.expand(lagrangian, q0, q1, h, forces).d2d1()
    slope = slopes(lambda x: method.expand(lagrangian, q0, x, h, forces).values.d1, q1, 1e-6)
    torch.testing.assert_close(jacobian, slope, atol=1e-6, rtol=1e-6)


USUAL_N = dict(zip(METHODS, cycle((1, 2, 3))))


@pytest.mark.parametrize(
    ("name", "n"),
    [pytest.param(name, n, marks=[pytest.mark.slow] * (n != USUAL_N[name]))
     for name in METHODS for n in (1, 2, 3)],
)  # fmt: skip
@pytest.mark.parametrize("make", [ChainPendulum, LAGRANGIANS["learned"]])
def test_gradients_of_residual_momentum_and_next_configuration(make, name, n):
    """In configurations, forces and parameters."""
    lagrangian, h = make(n), 0.1
    discrete = DiscreteLagrangian(METHODS[name], lagrangian, h)
    q, v, *forces = 0.5 * drawn(5, n)
    weight = torch.randn(3, *q.shape, dtype=torch.float64)
    inputs = [torch.stack((q, q + h * v, q + 2.1 * h * v)), torch.stack(forces)]

    def value():
        (a, b, c), (f, g, k) = inputs
        before, after = Forces(f, g), Forces(g, k)
        residual = discrete.residual(a, b, c, before, after)
        p = discrete.momentum(a, b, before)
        impulse = p + discrete.impulses(after)[0]
        reached, root = discrete.next_configuration(TIGHT, b, impulse, 2 * b - a, after)
        assert root.converged.all()
        return (weight * torch.stack((residual, p, reached))).sum()

    parameters = lagrangian.parameters() if isinstance(lagrangian, torch.nn.Module) else ()
    every = [*(x.requires_grad_() for x in inputs), *parameters]
    assert_gradients(value, every, eps=1e-5, atol=1e-7, rtol=2e-6)
