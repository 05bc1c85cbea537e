"""Galerkin integrators: inner coefficients, forces, and rows of an expansion."""

import pytest
import torch
from torch import Tensor

from symo_exp.mechanics.galerkin import Galerkin
from symo_exp.mechanics.lagrangian import Lagrangian
from symo_exp.mechanics.roots import Newton
from symo_exp.mechanics.variational import (
    DiscreteLagrangian,
    Forces,
    VariationalMidpoint,
)
from symo_exp.systems.chain import ChainPendulum
from tests.differences import assert_gradients, slopes
from tests.learned import learned_lagrangian

ROOT = Newton(tolerance=1e-12, max_iterations=30)
DEGREES = (1, 2, 3)
STAGES = (2, 3)


def lagrangians(n: int) -> list[Lagrangian]:
    """A true one, and a learned one of angles and straight coordinates."""
    return [ChainPendulum(n), learned_lagrangian(tuple(i % 2 == 0 for i in range(n)))]


def state(n: int, rows: int = 3) -> tuple[Tensor, Tensor]:
    generator = torch.Generator().manual_seed(10 + n)
    q, v = torch.rand(2, rows, n, generator=generator, dtype=torch.float64) - 0.5
    return 2.0 * q, v


@pytest.mark.parametrize("n", DEGREES)
def test_one_stage_is_the_midpoint_rule(n: int) -> None:
    midpoint, one = VariationalMidpoint(), Galerkin(stages=1)
    (q0, q1), f = state(n), Forces(*state(n))
    for ours, theirs in zip(
        one.impulses(*f, 0.1) + tuple(one.slots(ChainPendulum(n), q0, q1, 0.1, f)),
        midpoint.impulses(*f, 0.1) + tuple(midpoint.slots(ChainPendulum(n), q0, q1, 0.1)),
        strict=True,
    ):
        torch.testing.assert_close(ours, theirs)
    a, b = (x.expand(ChainPendulum(n), q0, q1, 0.1) for x in (one, midpoint))
    torch.testing.assert_close(a.d2d1(), b.d2d1())


@pytest.mark.parametrize("n", DEGREES)
@pytest.mark.parametrize("stages", STAGES)
def test_inner_coefficients_are_stationary(stages: int, n: int) -> None:
    (q0, v), f = state(n), Forces(*state(n))
    for lagrangian in lagrangians(n):
        at = Galerkin(stages=stages).expand(lagrangian, q0, q0 + 0.1 * v, 0.1, f)
        assert at.stationarity.abs().max() < 1e-9
        assert at.inner.abs().max() > 1e-5


@pytest.mark.parametrize("n", DEGREES)
@pytest.mark.parametrize("stages", STAGES)
def test_jacobian_in_the_next_configuration(stages: int, n: int) -> None:
    h, integrator, (q0, v), f = 0.1, Galerkin(stages=stages), state(n), Forces(*state(n))
    q1 = q0 + h * v
    for lagrangian in lagrangians(n):
        jacobian = integrator.expand(lagrangian, q0, q1, h, f).d2d1()
        for i in range(len(q0)):
            row = Forces(f.start[i : i + 1], f.end[i : i + 1])

            def d1(
                x: Tensor, i: int = i, row: Forces = row, own: Lagrangian = lagrangian
            ) -> Tensor:
                with torch.no_grad():
                    return integrator.slots(own, q0[i : i + 1], x[None], h, row).d1[0]

            torch.testing.assert_close(
                jacobian[i],
                slopes(d1, q1[i]),
                rtol=1e-6,
                atol=1e-6 * float(jacobian.abs().max()),
            )


@pytest.mark.parametrize(
    ("stages", "n"),
    [(2, 1), (2, 3), (3, 2),
     *(pytest.param(*pair, marks=pytest.mark.slow) for pair in ((2, 2), (3, 1), (3, 3)))],
)  # fmt: skip
def test_derivatives_of_residual_root_and_momentum(stages: int, n: int) -> None:
    """In configurations, forces and parameters, for a true and a learned Lagrangian."""
    h, integrator = 0.1, Galerkin(stages=stages)
    q0, v = state(n)
    forces = torch.stack((*state(n), 0.3 * v))
    configurations = torch.stack((q0, q0 + h * v, q0 + 2.1 * h * v))
    weight = torch.randn(3, *q0.shape, dtype=torch.float64)
    for lagrangian in lagrangians(n):
        parameters = (
            list(lagrangian.parameters()) if isinstance(lagrangian, torch.nn.Module) else []
        )

        inputs = [x.clone().requires_grad_() for x in (configurations, forces)]
        discrete = DiscreteLagrangian(integrator, lagrangian, h)

        def value(inputs=inputs, discrete=discrete) -> Tensor:  # type: ignore[no-untyped-def]
            (a, b, c), (f, g, k) = inputs
            before, after = Forces(f, g), Forces(g, k)
            residual = discrete.residual(a, b, c, before, after)
            p = discrete.momentum(a, b, before)
            impulse = p + discrete.impulses(after)[0]
            root, _ = discrete.next_configuration(ROOT, b, impulse, 2 * b - a, after)
            return (weight * torch.stack((residual, p, root))).sum()

        assert_gradients(value, [*inputs, *parameters], eps=1e-5, atol=1e-7, rtol=2e-6)


def test_rows_and_replace_keep_every_point() -> None:
    q0, v = state(2, rows=5)
    q1 = q0 + 0.1 * v
    integrator, index = Galerkin(stages=3), torch.tensor([3, 1])
    for lagrangian in lagrangians(2):
        whole = integrator.expand(lagrangian, q0, q1, 0.1)
        part = whole.rows(index)
        torch.testing.assert_close(part.values.d1, whole.values.d1[index])
        torch.testing.assert_close(part.d2d1(), whole.d2d1()[index])
        other = integrator.expand(lagrangian, q1[index], q0[index], 0.1)
        mixed = whole.replace(index, other)
        torch.testing.assert_close(mixed.d2d1()[index], other.d2d1())
        torch.testing.assert_close(mixed.d2d1()[[0, 2, 4]], whole.d2d1()[[0, 2, 4]])
