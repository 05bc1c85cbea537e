"""Dissipation: its power is never positive, and all derivatives include it."""

from functools import partial
from itertools import cycle

import pytest
import torch

from symo_exp.mechanics.euler_lagrange import acceleration
from symo_exp.mechanics.roots import Newton
from symo_exp.mechanics.variational import DiscreteLagrangian, Forces
from tests.dissipative import (
    dissipative_chain,
    dissipative_net,
    dragged_net,
    friction,
    learned_dissipation,
    learned_drag,
    machine_friction,
)
from tests.mechanics.motions import force_at, order, reference, refinement, start
from tests.tables import variational_integrators

METHODS = variational_integrators()
TIGHT = Newton(tolerance=1e-13, max_iterations=50)
STEP = 1e-6
KINDS = {"chain": dissipative_chain, "learned": dissipative_net, "drag": dragged_net}
every_kind = pytest.mark.parametrize("kind", KINDS)
every_n = pytest.mark.parametrize("n", [1, 2, 3])


def states(n):
    generator = torch.Generator().manual_seed(5)
    return torch.randn(2, 7, n, dtype=torch.float64, generator=generator)


@every_n
@pytest.mark.parametrize(
    "make",
    [friction, learned_dissipation, learned_drag, partial(machine_friction, constant=False)],
)
def test_the_power_of_dissipation_is_never_positive(make, n):
    dissipation, (q, v) = make(n), states(n)
    for scale in (1e-3, 1.0, 30.0):
        assert ((scale * v * dissipation.force(q, scale * v)).sum(-1) < 0).all()
    assert not dissipation.force(q, torch.zeros_like(v)).any()


@every_n
@every_kind
def test_it_joins_the_forces(kind, n):
    lagrangian, (q, v) = KINDS[kind](n), states(n)
    force = torch.sin(q)
    expected = acceleration(
        lagrangian.conservative, q, v, force + lagrangian.dissipation.force(q, v)
    )
    torch.testing.assert_close(acceleration(lagrangian, q, v, force), expected)
    assert torch.equal(lagrangian.energy(q, v), lagrangian.conservative.energy(q, v))


@every_n
@every_kind
@torch.no_grad()
def test_curvature_is_the_slope_of_the_gradients(kind, n):
    lagrangian, (q, v) = KINDS[kind](n), states(n)
    curvature = lagrangian.expand(q, v).curvature()
    for j in range(n):
        shift = torch.zeros_like(q)
        shift[:, j] = STEP
        by_q, by_v = (
            [(a - b) / (2 * STEP) for a, b in zip(ahead, behind, strict=True)]
            for ahead, behind in (
                (lagrangian.gradients(q + shift, v), lagrangian.gradients(q - shift, v)),
                (lagrangian.gradients(q, v + shift), lagrangian.gradients(q, v - shift)),
            )
        )
        torch.testing.assert_close(curvature.qq[:, :, j], by_q[0], atol=1e-7, rtol=1e-7)
        torch.testing.assert_close(curvature.vq[:, :, j], by_q[1], atol=1e-7, rtol=1e-7)
        torch.testing.assert_close(curvature.qv[:, :, j], by_v[0], atol=1e-7, rtol=1e-7)


@every_n
@every_kind
@pytest.mark.parametrize("name", METHODS)
@torch.no_grad()
def test_jacobian_of_the_residual(name, kind, n):
    method, lagrangian, h = METHODS[name], KINDS[kind](n), 0.05
    q0, v = states(n)
    q1 = q0 + 0.3 * h * v
    jacobian = method.expand(lagrangian, q0, q1, h).d2d1()
    for j in range(n):
        shift = torch.zeros_like(q1)
        shift[:, j] = STEP
        ahead, behind = (method.expand(lagrangian, q0, q1 + s * shift, h) for s in (1, -1))
        slope = (ahead.values.d1 - behind.values.d1) / (2 * STEP)
        torch.testing.assert_close(jacobian[:, :, j], slope, atol=2e-6, rtol=2e-6)


@pytest.mark.parametrize("n", [1, pytest.param(2, marks=pytest.mark.slow), 3])
@pytest.mark.parametrize("name", METHODS)
@torch.no_grad()
def test_order_of_convergence(name, n):
    method, lagrangian = METHODS[name], dissipative_chain(n, rest_velocity=4.0)
    q0, v0 = start(n)
    duration, counts = refinement(method.order, n)

    def integrate(steps):
        q, p, h = q0, lagrangian.momentum(q0, v0), duration / steps
        discrete = DiscreteLagrangian(method, lagrangian, h)
        for k in range(steps):
            forces = Forces(*(force_at(n, i * h, forced=True) for i in (k, k + 1)))
            q, p, _ = discrete.step(TIGHT, q, p, forces, q + h * lagrangian.velocity(q, p))
        return q

    slope = order(integrate, reference(lagrangian, n, forced=True, duration=duration), counts)
    assert slope == pytest.approx(method.order, abs=0.3)


@pytest.mark.parametrize(("name", "n"), [*zip(METHODS, cycle((1, 2, 3)))])
@torch.no_grad()
def test_energy_never_rises_without_input(name, n):
    """Friction exceeds the oscillation of the energy of a symplectic method here."""
    method, lagrangian, h = METHODS[name], dissipative_chain(n, rest_velocity=0.2), 0.02
    q, v = start(n)
    p, zero, energies = lagrangian.momentum(q, v), torch.zeros_like(q), [lagrangian.energy(q, v)]
    discrete, free = DiscreteLagrangian(method, lagrangian, h), Forces(zero, zero)
    for _ in range(25):
        q, p, _ = discrete.step(TIGHT, q, p, free, q + h * lagrangian.velocity(q, p))
        energies.append(lagrangian.energy(q, lagrangian.velocity(q, p)))
    assert (torch.stack(energies).diff(dim=0) < 0).all()
