"""Explicit methods: their order of convergence, and that they are not symplectic."""

import pytest
import torch

from symo_exp.errors import ConfigError
from symo_exp.mechanics.euler_lagrange import acceleration
from symo_exp.mechanics.explicit import ClassicalRK4, RungeKutta
from symo_exp.systems.chain import ChainPendulum
from tests.mechanics.motions import DURATION, force_at, order, reference, start
from tests.tables import explicit_integrators

METHODS = explicit_integrators() | {"classical_rk4": ClassicalRK4()}


@pytest.mark.parametrize(
    ("n", "forced"),
    [(1, True), (2, True), (3, False),
     *(pytest.param(n, forced, marks=pytest.mark.slow)
       for n, forced in ((1, False), (2, False), (3, True)))],
)  # fmt: skip
@pytest.mark.parametrize("name", METHODS)
@torch.no_grad()
def test_order_of_convergence(name, n, forced):
    method, chain = METHODS[name], ChainPendulum(n)

    def integrate(steps):
        (q, v), h = start(n), DURATION / steps
        for k in range(steps):
            u, u_next = (force_at(n, i * h, forced=forced) for i in (k, k + 1))
            q, v = method.step(lambda *x: acceleration(chain, *x), q, v, u, u_next, h)
        return q

    # At n = 2 the h⁵ and h⁶ terms of the order 5 nearly cancel until the steps are fine.
    counts = (24, 32, 48) if method.order <= 4 else (64, 96, 128) if n == 2 else (16, 24, 32)
    slope = order(integrate, reference(chain, n, forced=forced), counts)
    assert slope == pytest.approx(method.order, abs=0.3)


@pytest.mark.parametrize("name", METHODS)
def test_explicit_steps_are_not_symplectic(name):
    method, chain = METHODS[name], ChainPendulum(1)
    q, v = start(1)
    x = torch.cat((q, chain.momentum(q, v)), dim=1).requires_grad_()

    def step(x):
        q, p = x[:, :1], x[:, 1:]
        u = torch.zeros_like(q)
        q, v = method.step(lambda *y: acceleration(chain, *y), q, chain.velocity(q, p), u, u, 0.3)
        return torch.cat((q, chain.momentum(q, v)), dim=1)

    area = torch.linalg.det(torch.autograd.functional.jacobian(step, x).reshape(2, 2))
    assert abs(area.item() - 1.0) > 1e-6


@pytest.mark.parametrize(
    "changes",
    [
        {"b": (0.5,)},
        {"b": (0.5, 0.25, 0.25)},
        {"b": (0.5, 0.6)},
        {"c": (0.0, 0.5)},
        {"a": ((0.5,), (1.0,))},
        {"a": ((),)},
    ],
)
def test_a_tableau_that_is_none_of_an_explicit_method_is_refused(changes):
    heun = {"a": ((), (1.0,)), "b": (0.5, 0.5), "c": (0.0, 1.0)}
    RungeKutta(name="heun", order=2, **heun)
    with pytest.raises(ConfigError, match=r"the tableau of heun has .*: expected "):
        RungeKutta(name="heun", order=2, **heun | changes)
