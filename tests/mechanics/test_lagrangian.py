"""Derivatives of a Lagrangian against finite differences and the power balance."""

import pytest
import torch

from symo_exp.mechanics.euler_lagrange import acceleration
from symo_exp.mechanics.lagrangian import Lagrangian
from symo_exp.systems.chain import ChainPendulum
from tests.learned import learned_lagrangian

STEP = 1e-5


def lagrangians(n: int) -> dict[str, Lagrangian]:
    angular = tuple(i % 2 == 0 for i in range(n))
    return {"chain": ChainPendulum(n), "learned": learned_lagrangian(angular)}


CASES = [(n, kind) for n in (1, 2, 3) for kind in ("chain", "learned")]


@pytest.fixture(params=CASES, ids=lambda case: f"{case[1]}-{case[0]}")
def case(request):
    n, kind = request.param
    generator = torch.Generator().manual_seed(7)
    q, v = torch.randn(2, 6, n, dtype=torch.float64, generator=generator)
    return lagrangians(n)[kind], q, v


def value(lagrangian, q, v):
    return lagrangian.kinetic(q, v) - lagrangian.potential(q)


def central(function, x, i):
    shift = torch.zeros_like(x)
    shift[:, i] = STEP
    return (function(x + shift) - function(x - shift)) / (2 * STEP)


def test_gradients_are_the_slopes_of_the_lagrangian(case):
    lagrangian, q, v = case
    gradients = lagrangian.gradients(q, v)
    for i in range(q.shape[1]):
        slope = central(lambda x: value(lagrangian, x, v), q, i)
        torch.testing.assert_close(gradients.q[:, i].detach(), slope.detach(), atol=1e-8, rtol=1e-8)
        slope = central(lambda x: value(lagrangian, q, x), v, i)
        torch.testing.assert_close(gradients.v[:, i].detach(), slope.detach(), atol=1e-8, rtol=1e-8)


def test_curvature_is_the_slope_of_the_gradients(case):
    lagrangian, q, v = case
    curvature = lagrangian.expand(q, v).curvature()
    for j in range(q.shape[1]):
        dq = central(lambda x: lagrangian.expand(x, v).values.q, q, j)
        dv = central(lambda x: lagrangian.expand(x, v).values.v, q, j)
        torch.testing.assert_close(curvature.qq[:, :, j], dq, atol=1e-8, rtol=1e-8)
        torch.testing.assert_close(curvature.vq[:, :, j], dv, atol=1e-8, rtol=1e-8)


def test_rates_are_those_along_the_motion(case):
    lagrangian, q, v = case
    rates = lagrangian.rates(q, v)
    mass = lagrangian.mass_matrix(q)
    ahead, behind = (lagrangian.momentum(q + s * STEP * v, v) for s in (1, -1))
    torch.testing.assert_close(rates.mass, mass)
    torch.testing.assert_close(rates.q, lagrangian.gradients(q, v).q)
    torch.testing.assert_close(
        rates.mass_rate_v.detach(), ((ahead - behind) / (2 * STEP)).detach(), atol=1e-8, rtol=1e-8
    )


def test_power_of_the_force_is_the_rate_of_the_energy(case):
    lagrangian, q, v = case
    force = torch.sin(q) + 0.3
    a = acceleration(lagrangian, q, v, force)
    ahead, behind = (
        lagrangian.energy(q + s * STEP * v + 0.5 * STEP**2 * a, v + s * STEP * a) for s in (1, -1)
    )
    power = (ahead - behind) / (2 * STEP)
    torch.testing.assert_close(power.detach(), (v * force).sum(-1), atol=1e-6, rtol=1e-6)


def test_velocity_inverts_momentum(case):
    lagrangian, q, v = case
    torch.testing.assert_close(lagrangian.velocity(q, lagrangian.momentum(q, v)), v)


def test_rows_of_an_expansion_can_be_taken_and_replaced(case):
    lagrangian, q, v = case
    index = torch.tensor([4, 1])
    other = lagrangian.expand(q[index] + 1.0, v[index])
    mixed = lagrangian.expand(q, v).replace(index, other)
    moved = q.index_add(0, index, torch.ones_like(q[index]))
    expected = lagrangian.expand(moved, v)
    for got, want in zip(mixed.values, expected.values, strict=True):
        torch.testing.assert_close(got, want)
    for got, want in zip(mixed.rows(index).curvature(), other.curvature(), strict=True):
        torch.testing.assert_close(got, want)


def test_a_constant_lagrangian_has_no_forces():
    class Free(Lagrangian):
        def mass_matrix(self, q):
            return 2.0 * torch.eye(2, dtype=q.dtype).expand(len(q), 2, 2)

        def potential(self, q):
            return q.new_zeros(len(q))

    q, v = torch.randn(2, 3, 2, dtype=torch.float64)
    assert torch.equal(acceleration(Free(), q, v, torch.zeros_like(q)), torch.zeros_like(q))
