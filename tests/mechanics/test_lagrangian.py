"""Derivatives of a Lagrangian against finite differences and the power balance."""

import pytest
import torch

from symo_exp.mechanics.euler_lagrange import acceleration
from symo_exp.mechanics.lagrangian import Lagrangian
from symo_exp.systems.chain import ChainPendulum
from tests.differences import slopes
from tests.dissipative import DISSIPATIVE
from tests.learned import learned_lagrangian

STEP = 1e-5
CONSERVATIVE = {
    "chain": ChainPendulum,
    "learned": lambda n: learned_lagrangian(tuple(i % 2 == 0 for i in range(n))),
}


def state(n):
    generator = torch.Generator().manual_seed(7)
    return torch.randn(2, 6, n, dtype=torch.float64, generator=generator)


@pytest.fixture(params=[(n, kind) for n in (1, 2, 3) for kind in CONSERVATIVE], ids=str)
def case(request):
    n, kind = request.param
    return CONSERVATIVE[kind](n), *state(n)


def value(lagrangian, q, v):
    return lagrangian.kinetic(q, v) - lagrangian.potential(q)


def test_gradients_are_the_slopes_of_the_lagrangian(case):
    lagrangian, q, v = case
    gradients = lagrangian.gradients(q, v)
    exact = {"atol": 1e-8, "rtol": 1e-8}
    by_q = slopes(lambda x: value(lagrangian, x, v), q, STEP)
    torch.testing.assert_close(gradients.q.detach(), by_q, **exact)
    by_v = slopes(lambda x: value(lagrangian, q, x), v, STEP)
    torch.testing.assert_close(gradients.v.detach(), by_v, **exact)


@pytest.mark.parametrize("n", [1, 2, 3])
@pytest.mark.parametrize("kind", CONSERVATIVE | DISSIPATIVE)
def test_curvature_is_the_slope_of_the_gradients(kind, n):
    lagrangian, (q, v) = (CONSERVATIVE | DISSIPATIVE)[kind](n), state(n)
    curvature, exact = lagrangian.expand(q, v).curvature(), {"atol": 1e-8, "rtol": 1e-8}
    for part in (0, 1):
        by_q = slopes(lambda x, part=part: lagrangian.gradients(x, v)[part], q, STEP)
        torch.testing.assert_close((curvature.qq, curvature.vq)[part], by_q, **exact)
    by_v = slopes(lambda x: lagrangian.gradients(q, x).q, v, STEP)
    torch.testing.assert_close(curvature.qv, by_v, **exact)


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
