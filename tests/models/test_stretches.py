"""Rollouts that solve several steps at once: they are those of single steps, in less time."""

import itertools

import pytest
import torch

from symo_exp.mechanics.lagrangian import Lagrangian
from symo_exp.mechanics.roots import Newton
from symo_exp.mechanics.variational import VariationalMidpoint
from symo_exp.models.flows import ACCURACY, Flow, VariationalFlow
from symo_exp.models.starts import fitted_start
from symo_exp.systems.chain import ChainPendulum
from tests.differences import slopes as slopes_of
from tests.dissipative import LEARNED, dissipative_chain
from tests.tables import systems, variational_integrators

H, STEPS = 0.02, 23
KINDS = {
    "no friction": ChainPendulum,
    "narrow dry friction": lambda n: dissipative_chain(n, rest_velocity=0.01),
    **LEARNED,
}
TURNING = {name: x for name, x in systems().items() if x.coordinates.space.rotations}
METHODS = variational_integrators()
ON_ROTATIONS = [name for name, method in METHODS.items() if method.has_geodesic]
CASES = [
    (kind, name, 1 + i % 3) for i, (kind, name) in enumerate(itertools.product(KINDS, METHODS))
] + [
    (kind, name, TURNING[kind].coordinates.n)
    for kind, name in itertools.product(TURNING, ON_ROTATIONS)
]
QUICK = {
    *zip(KINDS, itertools.cycle(METHODS)),
    *zip(TURNING, itertools.cycle(ON_ROTATIONS)),
}
every_case = pytest.mark.parametrize(
    ("kind", "name", "n"),
    [pytest.param(*x, marks=[] if x[:2] in QUICK else pytest.mark.slow) for x in CASES],
)
"""Each kind of friction, and each space, with one method; the others are among the long proofs."""


def flow_and_starts(kind, name, n, **root):
    found = Newton(tolerance=1e-12, max_iterations=50, **root)
    if kind in TURNING:
        truth = TURNING[kind]
        flow = VariationalFlow(
            truth.lagrangian, METHODS[name], H, truth.input_matrix, root=found
        ).double()
        q, v, u = truth.points(6 * (STEPS + 1), seed=3)
        return flow, q[:6], v[:6], u.view(6, STEPS + 1, -1)
    matrix = torch.eye(n, dtype=torch.float64)
    flow = VariationalFlow(KINDS[kind](n), METHODS[name], H, matrix, root=found).double()
    generator = torch.Generator().manual_seed(3)
    q, v = torch.randn(2, 6, n, dtype=torch.float64, generator=generator)
    return flow, q, v, torch.randn(6, STEPS + 1, n, dtype=torch.float64, generator=generator)


@every_case
def test_rollouts_are_those_of_single_steps(kind, name, n):
    flow, q, v, u = flow_and_starts(kind, name, n)
    assert flow.solves_stretches
    found = flow.rollout(q, v, u)
    expected = flow.rollout(q, v, u, advance=flow.advance)
    assert found.converged.all()
    torch.testing.assert_close(found.q, expected.q, atol=1e-9, rtol=1e-9)
    torch.testing.assert_close(found.v, expected.v, atol=1e-7, rtol=1e-7)


class HeavyBase(torch.nn.Module, Lagrangian):
    """A light pendulum on a base a million times as heavy, to which it is strongly coupled."""

    def mass_matrix(self, q):
        rows = torch.tensor([[1e6, 900.0], [900.0, 1.0]], dtype=q.dtype)
        return rows.expand(len(q), 2, 2)

    def potential(self, q):
        return -1e5 * torch.cos(q[:, 0]) - torch.cos(q[:, 1])


def test_rounding_errors_of_a_heavy_machine_are_no_failures(monkeypatch):
    """Those of its equations are larger than the tolerance."""
    root, matrix = Newton(tolerance=1e-10, max_iterations=50), torch.zeros(2, 1).double()
    root.accuracy = ACCURACY
    flow = VariationalFlow(HeavyBase(), VariationalMidpoint(), H, matrix, root=root).double()
    generator = torch.Generator().manual_seed(3)
    q, v = torch.randn(2, 20, 2, dtype=torch.float64, generator=generator)
    u, single = torch.zeros(20, STEPS + 1, 1).double(), flow.advance
    monkeypatch.setattr(VariationalFlow, "advance", None)  # stretches leave no step to be taken
    for advance in None, single:
        assert flow.rollout(3.0 * q, 0.3 * v, u, advance).converged.all()


@pytest.mark.parametrize("n", [2, pytest.param(3, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", METHODS)
def test_rollouts_of_whips_are_those_of_single_steps(name, n):
    """Motions near the limit of the time step, where Newton's method also finds remote roots."""
    root, matrix = Newton(tolerance=1e-10, max_iterations=50), torch.eye(n, dtype=torch.float64)
    flow = VariationalFlow(ChainPendulum(n), METHODS[name], 0.05, matrix, root=root).double()
    generator = torch.Generator().manual_seed(3)
    q, v = torch.randn(2, 100, n, dtype=torch.float64, generator=generator)
    u = torch.zeros(100, STEPS + 1, n, dtype=torch.float64)
    found = flow.rollout(q, 3.0 * v, u)
    expected = flow.rollout(q, 3.0 * v, u, advance=flow.advance)
    sound = expected.converged.all(1)
    assert sound.sum() >= 80
    assert torch.equal(found.converged, expected.converged)
    torch.testing.assert_close(found.q[sound], expected.q[sound], atol=1e-6, rtol=1e-6)


@every_case
def test_slopes_are_those_of_differences(kind, name, n):
    flow, q, v, u = flow_and_starts(kind, name, n)
    path, slopes = flow.rollout_slopes(q, v, u)
    torch.testing.assert_close(path, flow.rollout(q, v, u).q, atol=1e-9, rtol=1e-9)
    n, space = v.shape[1], flow.space

    def moved(x):
        there = flow.rollout(space.retract(q, x[:, :n]), v + x[:, n:], u).q
        return space.difference(path, there)

    by_differences = slopes_of(moved, torch.zeros(len(v), 2 * n, dtype=torch.float64), 1e-6)
    torch.testing.assert_close(slopes, by_differences, atol=1e-4, rtol=1e-4)


@pytest.mark.parametrize("n", [1, 2, 3])
@pytest.mark.parametrize("rest_velocity", [0.01, 0.001])
def test_rollouts_evaluate_the_lagrangian_less_often_than_single_steps(
    rest_velocity, n, monkeypatch
):
    """Also where machines stick, so that stretches diverge: their first steps are solved."""
    flow, q, v, u = flow_and_starts("narrow dry friction", "midpoint", n)
    flow.lagrangian = dissipative_chain(n, rest_velocity=rest_velocity).double()
    q, v, u = q.repeat(5, 1), v.repeat(5, 1), torch.cat([u * scale for scale in range(5)])
    counts = []
    expand = type(flow.lagrangian).expand

    def counted(*arguments):
        counts[-1] += 1
        return expand(*arguments)

    monkeypatch.setattr(type(flow.lagrangian), "expand", counted)
    for advance in (None, flow.advance):
        counts.append(0)
        flow.rollout(q, v, u, advance=advance)
    assert 2 * counts[0] < counts[1]


def test_rows_without_a_solution_are_left_to_single_steps():
    flow, q, v, u = flow_and_starts("narrow dry friction", "midpoint", 2)
    v[0], u[1, 12:] = torch.nan, torch.nan
    found = flow.rollout(q, v, u)
    expected = flow.rollout(q, v, u, advance=flow.advance)
    assert torch.equal(found.converged, expected.converged)
    torch.testing.assert_close(found.q, expected.q, atol=1e-9, rtol=1e-9, equal_nan=True)


@pytest.mark.parametrize(("kind", "n"), [*zip(LEARNED, itertools.cycle((1, 2, 3)))])
def test_rows_without_a_solution_do_not_keep_others_from_their_slopes(kind, n, monkeypatch):
    """The fit of their starts takes differences of single steps for these rows alone."""
    flow, q, v, u = flow_and_starts(kind, "midpoint", n)
    path, slopes = flow.rollout_slopes(q, v, u)
    measured = path + 1e-3 * torch.randn(path.shape, generator=torch.Generator().manual_seed(0))
    expected = fitted_start(flow, measured, u)
    stretch, rolled = VariationalFlow.solve_stretch, []

    def lossy(self, q, p, u, *guess):
        path, at, solved = stretch(self, q, p, u, *guess)
        return path, at, solved.where(u[:, 0, 0] != lost, 0)

    def counted(self, q, *arguments):
        rolled.append(len(q))
        return rollout(self, q, *arguments)

    lost, rollout = u[2, 0, 0], VariationalFlow.rollout
    monkeypatch.setattr(VariationalFlow, "solve_stretch", lossy)
    monkeypatch.setattr(VariationalFlow, "rollout", counted)
    found = flow.rollout_slopes(q, v, u)
    others = torch.arange(len(q)) != 2
    assert found[0][2, 1:].isnan().all()
    torch.testing.assert_close(found[0][others], path[others])
    torch.testing.assert_close(found[1][others], slopes[others])
    torch.testing.assert_close(fitted_start(flow, measured, u), expected, atol=1e-7, rtol=1e-5)
    assert 1 + 4 * n in rolled
    assert max(rolled) <= max(len(q), 1 + 4 * n)


def test_other_root_finders_take_single_steps(monkeypatch):
    flow, q, v, u = flow_and_starts("no friction", "midpoint", 2, stopping="batch")
    single = []
    base = Flow.advance_all
    monkeypatch.setattr(Flow, "advance_all", lambda *x: single.append(1) or base(*x))
    assert flow.rollout(q, v, u).converged.all()
    assert single
    assert flow.rollout_slopes(q, v, u) is None
