"""Galerkin integrators: inner coefficients and rows of an expansion."""

from dataclasses import replace

import pytest
import torch
from hydra.utils import instantiate
from torch import Tensor

from symo_exp.mechanics.galerkin import Galerkin
from symo_exp.mechanics.lagrangian import Lagrangian
from symo_exp.mechanics.variational import Forces, VariationalMidpoint
from symo_exp.systems.base import LagrangianSystem
from symo_exp.systems.chain import ChainPendulum
from tests.learned import learned_lagrangian
from tests.tables import stated

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


def whips() -> dict[str, LagrangianSystem]:
    """Systems with light ends, which turn fast, without and with friction."""
    elbow = {"length_2": 0.05, "centre_2": 0.025, "inertia_2": 0.01}
    found = {
        "chain_5": ChainPendulum(5),
        "chain_7": ChainPendulum(7),
        "acrobot": instantiate(stated("acrobot") | elbow),
    }
    for name, system in list(found.items()):
        friction = dict.fromkeys(("viscous", "coulomb"), (0.1,) * system.coordinates.n)
        found[f"{name}_friction"] = replace(system, **friction)
    return found


WHIPS = whips()


@pytest.mark.parametrize("stages", [2, 3, 5])
@pytest.mark.parametrize("name", WHIPS)
def test_fast_motions_between_two_configurations_are_found_in_evaluation(
    name: str, stages: int
) -> None:
    """Centrifugal terms are larger than the inertia; rows that converge in training are kept."""
    system = WHIPS[name]
    (q0, v, _), h = system.points(64, seed=5), system.time_step
    q1, forces = q0 + 10.0 * h * v, Forces(torch.zeros_like(v), torch.zeros_like(v))
    trained, measured = (
        integrator.expand(system.lagrangian, q0, q1, h, forces)
        for integrator in (Galerkin(stages=stages), Galerkin(stages=stages).converged())
    )
    before, after = (x.stationarity.abs().amax((0, -1)) for x in (trained, measured))
    assert before.max() > 1e-9
    assert after.max() < 1e-10
    same = (measured.inner == trained.inner).all(-1).all(0)
    assert same.any()
    assert (after[~same] < before[~same]).all()


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
