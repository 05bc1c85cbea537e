"""Galerkin variational integrators: order, structure, and derivatives against differences."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
import torch
from scipy.integrate import solve_ivp
from torch import Tensor

from symo_exp.mechanics.euler_lagrange import acceleration
from symo_exp.mechanics.galerkin import Galerkin
from symo_exp.mechanics.lagrangian import Lagrangian
from symo_exp.mechanics.roots import Newton
from symo_exp.mechanics.variational import (
    Forces,
    VariationalMidpoint,
    del_residual,
    momentum_before,
    next_pose,
    variational_step,
)
from symo_exp.nets.structured_lagrangian import StructuredLagrangian

ROOT = Newton(tolerance=1e-13, max_iterations=30)
DEGREES = (1, 2, 3)
STAGES = (2, 3)


class Chain(Lagrangian):
    """``n`` unit point masses, one hanging from the other by unit rods; absolute angles."""

    def __init__(self, n: int) -> None:
        index = torch.arange(n, dtype=torch.float64)
        self._carried = n - torch.maximum(index[:, None], index[None, :])

    def mass_matrix(self, q: Tensor) -> Tensor:
        return self._carried * torch.cos(q.unsqueeze(-1) - q.unsqueeze(-2))

    def potential(self, q: Tensor) -> Tensor:
        return -9.81 * (self._carried.diagonal() * q.cos()).sum(-1)


class Cyclic(Chain):
    """A chain on a free cart without gravity: the cart's coordinate is cyclic."""

    def mass_matrix(self, q: Tensor) -> Tensor:
        return super().mass_matrix(q[:, :1] * 0.0 + torch.cat((0 * q[:, :1], q[:, 1:]), 1))

    def potential(self, q: Tensor) -> Tensor:
        return -(q[:, 1:].cos()).sum(-1)


def network(n: int) -> StructuredLagrangian:
    """A learned Lagrangian, of an angle and otherwise of straight coordinates too."""
    torch.manual_seed(n)
    angular = tuple(i % 2 == 0 for i in range(n))
    net = StructuredLagrangian(angular=angular, width=12).double()
    with torch.no_grad():
        net.net.biases[-1][:n] += 1.5  # away from a singular inertia
    return net


def lagrangians(n: int) -> list[Lagrangian]:
    return [Chain(n), network(n)]


def state(n: int, rows: int = 3) -> tuple[Tensor, Tensor]:
    generator = torch.Generator().manual_seed(10 + n)
    q, v = torch.rand(2, rows, n, generator=generator, dtype=torch.float64) - 0.5
    return 2.0 * q, v


def force(t: float, n: int) -> Tensor:
    """A control that is piecewise linear with its corner at 0.4 s, where all steps have a node."""
    value = 2.0 + 3.0 * t if t <= 0.4 else 2.0 + 3.0 * 0.4 - 7.0 * (t - 0.4)
    return value * torch.linspace(1.0, -0.5, n, dtype=torch.float64)


def exact(lagrangian: Lagrangian, q: Tensor, v: Tensor, forced: bool) -> tuple[Tensor, Tensor]:
    """The motion at 0.8 s by SciPy, far below every error here."""
    rows, n = q.shape
    x = np.concatenate([q.numpy().ravel(), v.numpy().ravel()])
    for start, end in ((0.0, 0.4), (0.4, 0.8)) if forced else ((0.0, 0.8),):

        def field(t: float, x: np.ndarray) -> np.ndarray:
            q, v = torch.from_numpy(x).view(2, rows, n)
            f = force(t, n).expand(rows, n) if forced else torch.zeros_like(q)
            with torch.no_grad():
                a = acceleration(lagrangian, q, v, f)
            return np.concatenate([v.numpy().ravel(), a.numpy().ravel()])

        x = solve_ivp(field, (start, end), x, method="DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
    q, v = torch.from_numpy(x.copy()).view(2, rows, n)
    return q, v


@torch.no_grad()
def integrate(
    integrator: Galerkin, lagrangian: Lagrangian, q: Tensor, p: Tensor, h: float, steps: int,
    forced: bool = False,
) -> list[tuple[Tensor, Tensor]]:  # fmt: skip
    path = [(q, p)]
    for k in range(steps):
        f0, f1 = (
            force(t, q.shape[1]).expand_as(q) if forced else torch.zeros_like(q)
            for t in (k * h, (k + 1) * h)
        )
        guess = q + h * lagrangian.velocity(q, p)
        step = variational_step(integrator, lagrangian, ROOT, q, p, f0, f1, h, guess)
        q, p = step.q, step.p
        path.append((q, p))
    return path


@pytest.mark.parametrize("forced", [False, True])
@pytest.mark.parametrize("n", DEGREES)
@pytest.mark.parametrize(("stages", "order"), [(1, 2), (2, 4), (3, 6)])
def test_order_of_pose_and_momentum(stages: int, order: int, n: int, forced: bool) -> None:
    integrator = Galerkin(stages=stages)
    assert integrator.order == order
    for lagrangian in lagrangians(n):
        q, v = state(n)
        with torch.no_grad():
            q_end, v_end = exact(lagrangian, q, v, forced)
            p, p_end = lagrangian.momentum(q, v), lagrangian.momentum(q_end, v_end)
        steps = [8, 12, 16]
        errors = []
        for count in steps:
            path = integrate(integrator, lagrangian, q, p, 0.8 / count, count, forced)
            errors.append([(a - b).norm().item() for a, b in zip(path[-1], (q_end, p_end))])
        for one, two in pairwise(range(len(steps))):
            for i in (0, 1):
                slope = math.log(errors[one][i] / errors[two][i]) / math.log(steps[two] / steps[one])
                assert slope == pytest.approx(order, abs=0.5) or errors[two][i] < 1e-11


@pytest.mark.parametrize("n", DEGREES)
def test_one_stage_is_the_midpoint_rule(n: int) -> None:
    midpoint, one = VariationalMidpoint(), Galerkin(stages=1)
    (q0, q1), f = state(n), Forces(*state(n))
    for ours, theirs in zip(
        one.impulses(*f, 0.1) + tuple(one.slots(Chain(n), q0, q1, 0.1, f)),
        midpoint.impulses(*f, 0.1) + tuple(midpoint.slots(Chain(n), q0, q1, 0.1)),
        strict=True,
    ):
        torch.testing.assert_close(ours, theirs)
    a, b = (x.expand(Chain(n), q0, q1, 0.1) for x in (one, midpoint))
    torch.testing.assert_close(a.d2d1(), b.d2d1())
    torch.testing.assert_close(a.d2d1_limit(), b.d2d1_limit())


@pytest.mark.parametrize("n", DEGREES)
@pytest.mark.parametrize("stages", STAGES)
def test_step_is_symplectic(stages: int, n: int) -> None:
    h, integrator = 0.1, Galerkin(stages=stages)
    canonical = torch.kron(torch.tensor([[0.0, 1.0], [-1.0, 0.0]]), torch.eye(n)).double()
    for lagrangian in lagrangians(n):
        q, v = state(n, rows=1)

        def step(x: Tensor, lagrangian: Lagrangian = lagrangian) -> Tensor:
            q, p = x[None, :n], x[None, n:]
            zero = torch.zeros_like(q)
            done = variational_step(integrator, lagrangian, ROOT, q, p, zero, zero, h, q + h * v)
            return torch.cat((done.q, done.p), 1)[0]

        x = torch.cat((q, lagrangian.momentum(q, v)), 1)[0].detach()
        jacobian = torch.autograd.functional.jacobian(step, x)
        torch.testing.assert_close(jacobian, differences(step, x), rtol=1e-6, atol=1e-7)
        torch.testing.assert_close(jacobian.T @ canonical @ jacobian, canonical, atol=1e-9, rtol=0)


@pytest.mark.parametrize("n", (2, 3))
@pytest.mark.parametrize("stages", STAGES)
def test_momentum_of_a_cyclic_coordinate_is_kept(stages: int, n: int) -> None:
    lagrangian = Cyclic(n)
    q, v = state(n)
    path = integrate(Galerkin(stages=stages), lagrangian, q, lagrangian.momentum(q, v), 0.1, 50)
    momenta = torch.stack([p[:, 0] for _, p in path])
    moved = torch.stack([p[:, 1] for _, p in path])
    torch.testing.assert_close(momenta, momenta[:1].expand_as(momenta), atol=1e-10, rtol=0)
    assert (moved - moved[0]).abs().max() > 1e-2  # the others are not


@pytest.mark.parametrize("n", DEGREES)
@pytest.mark.parametrize("stages", STAGES)
def test_energy_error_is_bounded(stages: int, n: int) -> None:
    lagrangian = Chain(n)
    q, v = (0.5 * x for x in state(n))
    path = integrate(Galerkin(stages=stages), lagrangian, q, lagrangian.momentum(q, v), 0.05, 400)
    energy = torch.stack([lagrangian.energy(q, lagrangian.velocity(q, p)) for q, p in path])
    error = (energy - energy[0]).abs()
    assert error[200:].max() < 1.5 * error[:200].max()
    assert error.max() < 1e-3 * (energy.max() - lagrangian.potential(torch.zeros_like(q))[0]).abs()


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
def test_jacobian_in_the_next_pose(stages: int, n: int) -> None:
    h, integrator, (q0, v), f = 0.1, Galerkin(stages=stages), state(n), Forces(*state(n))
    q1 = q0 + h * v
    for lagrangian in lagrangians(n):
        jacobian = integrator.expand(lagrangian, q0, q1, h, f).d2d1()
        for i in range(len(q0)):
            row = Forces(f.start[i : i + 1], f.end[i : i + 1])

            def d1(x: Tensor, i: int = i, row: Forces = row, l: Lagrangian = lagrangian) -> Tensor:
                with torch.no_grad():
                    return integrator.slots(l, q0[i : i + 1], x[None], h, row).d1[0]

            torch.testing.assert_close(
                jacobian[i], differences(d1, q1[i]), rtol=1e-6, atol=1e-6 * float(jacobian.abs().max())
            )
        torch.testing.assert_close(
            jacobian, integrator.expand(lagrangian, q0, q1, h).d2d1_limit(), rtol=0.2, atol=3.0
        )


@pytest.mark.parametrize("n", DEGREES)
@pytest.mark.parametrize("stages", STAGES)
def test_derivatives_of_residual_root_and_momentum(stages: int, n: int) -> None:
    """In poses, forces and parameters, for a true and a learned Lagrangian."""
    h, integrator = 0.1, Galerkin(stages=stages)
    q0, v = state(n)
    forces = torch.stack((*state(n), 0.3 * v))
    poses = torch.stack((q0, q0 + h * v, q0 + 2.1 * h * v))
    weight = torch.randn(3, *q0.shape, dtype=torch.float64)
    for lagrangian in lagrangians(n):
        parameters = list(lagrangian.parameters()) if isinstance(lagrangian, torch.nn.Module) else []

        def value(
            poses: Tensor, forces: Tensor, *_: Tensor, lagrangian: Lagrangian = lagrangian
        ) -> Tensor:
            (a, b, c), (f, g, k) = poses, forces
            residual = del_residual(integrator, lagrangian, a, b, c, f, g, k, h)
            p = momentum_before(integrator, lagrangian, a, b, f, g, h)
            impulse = p + integrator.impulses(g, k, h)[0]
            root, _ = next_pose(
                integrator, lagrangian, ROOT, b, impulse, h, 2 * b - a, forces=Forces(g, k)
            )
            return (weight * torch.stack((residual, p, root))).sum()

        inputs = [x.clone().requires_grad_() for x in (poses, forces)]
        gradients = torch.autograd.grad(value(*inputs), [*inputs, *parameters], allow_unused=True)
        for x, gradient in zip([*inputs, *parameters], gradients, strict=True):
            assert gradient is not None
            direction = torch.randn(x.shape, dtype=torch.float64)
            eps, ends = 1e-5, []
            for sign in (1.0, -1.0):
                with torch.no_grad():
                    x += sign * eps * direction
                    ends.append(value(*inputs))
                    x -= sign * eps * direction
            expected = (ends[0] - ends[1]) / (2 * eps)
            torch.testing.assert_close((gradient * direction).sum(), expected, rtol=2e-6, atol=1e-7)


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


def differences(function, x: Tensor, eps: float = 1e-5) -> Tensor:  # type: ignore[no-untyped-def]
    columns = []
    for i in range(len(x)):
        e = torch.zeros_like(x)
        e[i] = eps
        with torch.no_grad():
            columns.append((function(x + e) - function(x - e)) / (2 * eps))
    return torch.stack(columns, dim=1)
