"""Models for control: derivatives of a step and inverse dynamics."""

import pytest
import torch

from symo_exp.errors import ConfigError
from symo_exp.mechanics.roots import Newton
from symo_exp.mechanics.types import Coordinates
from symo_exp.models import control
from tests.differences import slopes
from tests.models.methods import flows, make, make_small, pairwise, windows

FLOWS = pytest.mark.parametrize(("method", "integrator", "n"), pairwise(flows()))


def state_map(model, n):
    """``(q, v, u) → (q⁺, v⁺)`` under a held control, all in one tensor."""

    def after(x):
        q, v, u = x.split((n, n, x.shape[1] - 2 * n), dim=1)
        step = model.step(q, v, u)
        return torch.cat((step.q, step.v), dim=1)

    return after


def actuated(method, integrator, n, m):
    """A model with ``m`` controls."""
    return make(method, integrator, n, input_matrix=torch.eye(n, m, dtype=torch.float64) + 0.1)


@FLOWS
def test_derivatives_of_a_step_are_those_of_finite_differences(method, integrator, n):
    model, data = actuated(method, integrator, n, n), windows(n)
    u = data.u.expand(-1, n)
    a, b = model.linearize(data.q, data.v, u)
    assert a.shape == (len(u), 2 * n, 2 * n)
    assert b.shape == (len(u), 2 * n, n)
    x, after = torch.cat((data.q, data.v, u), dim=1), state_map(model, n)
    expected = slopes(after, x, 1e-5)
    torch.testing.assert_close(torch.cat((a, b), dim=2), expected, atol=2e-7, rtol=1e-6)


def test_derivatives_do_not_depend_on_the_sensitivity_of_training():
    data = windows(2)
    direct, adjoint = (
        make("node", "rk4", 2, sensitivity=s).linearize(data.q, data.v, data.u)
        for s in ("direct", "adjoint")
    )
    assert torch.equal(direct.A, adjoint.A)
    assert torch.equal(direct.B, adjoint.B)


def test_a_row_without_a_root_has_no_derivative():
    model, data = make("symo", "midpoint", 2), windows(2)
    good = model.linearize(data.q, data.v, data.u)
    q = data.q.clone()
    q[1] = torch.nan
    a, b = model.linearize(q, data.v, data.u)
    assert a[1].isnan().all()
    assert b[1].isnan().all()
    torch.testing.assert_close(a[[0, 2, 3, 4]], good.A[[0, 2, 3, 4]])


def motion(model, data):
    """Three configurations under a held control, which an untrained network does not drown."""
    m = model.input_matrix.shape[1]
    u = 0.05 * (data.u + torch.arange(m))
    return u, model.rollout(data.q, data.v, u[:, None].expand(-1, 3, -1)).q.unbind(1)


@FLOWS
def test_inverse_dynamics_recovers_the_control(method, integrator, n):
    """Fully actuated and underactuated."""
    for m in {1, n}:
        model = actuated(method, integrator, n, m)
        u, path = motion(model, windows(n))
        torch.testing.assert_close(model.inverse_dynamics(*path), u, atol=1e-7, rtol=1e-7)


@pytest.mark.parametrize(
    ("method", "integrator", "n"),
    [("node", "rk4", 1), ("l_node", "midpoint", 3), ("symo", "galerkin4", 2)],
)
def test_inverse_dynamics_takes_the_nearest_possible_motion(method, integrator, n):
    """No other held control brings a motion through the first two configurations nearer."""
    model = make(method, integrator, n)
    _, (q_prev, q, q_next) = motion(model, windows(n))
    q_next = q_next + 1e-5 * torch.randn_like(q_next)
    u = model.inverse_dynamics(q_prev, q, q_next)

    def distance(u):
        v = (q - q_prev) / model.time_step
        for _ in range(5):  # shoot for the second configuration
            step, a = model.step(q_prev, v, u), model.linearize(q_prev, v, u).A
            v = v + torch.linalg.solve(a[:, :n, n:], q - step.q.detach())
        step = model.step(q_prev, v, u)
        return (model.step(step.q, step.v, u).q - q_next).norm(dim=1).detach()

    least = distance(u)
    assert (distance(u - 0.002) >= least).all()
    assert (distance(u + 0.002) >= least).all()
    assert (least.max() < 1e-9) == (n == 1)


@pytest.mark.parametrize(("method", "integrator"), [("node", "rk4"), ("symo", "midpoint")])
def test_configurations_that_are_not_finite_leave_the_controls_of_other_rows(method, integrator):
    model = make(method, integrator, 2)
    _, path = motion(model, windows(2))
    good = model.inverse_dynamics(*path)
    bad = [q.clone() for q in path]
    for k, q in enumerate(bad):
        q[k, 0] = torch.nan
    found = model.inverse_dynamics(*bad)
    assert found[:3].isnan().all()
    torch.testing.assert_close(found[3:], good[3:])


@pytest.mark.parametrize(("method", "integrator"), [("l_node", "rk4"), ("symo", "midpoint")])
@pytest.mark.parametrize("n", [2, *(pytest.param(n, marks=pytest.mark.slow) for n in (1, 3))])
def test_inverse_dynamics_of_a_small_machine_finds_the_same_controls(method, integrator, n):
    """In single precision, too, whose roundings of metres are larger than the machine."""
    model, (small, sizes) = make(method, integrator, n), make_small(method, integrator, n)
    _, (q_prev, q, q_next) = motion(model, windows(n))
    path = q_prev, q, q_next + 1e-5 * torch.randn_like(q_next)  # not in reach
    expected = model.inverse_dynamics(*path)
    torch.testing.assert_close(
        small.inverse_dynamics(*(q * sizes for q in path)), expected, rtol=1e-7, atol=1e-7
    )
    single = small.float().inverse_dynamics(*(q * sizes for q in path))
    torch.testing.assert_close(single.double(), expected, rtol=0, atol=0.05)


@pytest.mark.parametrize("n", [2, *(pytest.param(n, marks=pytest.mark.slow) for n in (1, 3))])
def test_controls_of_a_small_machine_take_as_many_updates(n, monkeypatch):
    """After fewer ones the same rows are nan."""
    lengths = {"coordinates": Coordinates(tuple("xyz"[:n]), (False,) * n)}
    model = make("l_node", "rk4", n, **lengths)
    small, sizes = make_small("l_node", "rk4", n, **lengths)
    _, path = motion(model, windows(n))
    lost = []
    for most in (2, 5):
        monkeypatch.setattr(control, "MOST_UPDATES", most)
        lost.append(model.inverse_dynamics(*path).isnan())
        found = small.inverse_dynamics(*(q * sizes for q in path))
        assert torch.equal(found.isnan(), lost[-1])
    assert lost[0].any()
    assert not lost[-1].any()


def test_single_states_precisions_and_systems_without_a_control():
    model, data = make("symo", "midpoint", 2, root=Newton()).float(), windows(2)
    a, b = model.linearize(data.q[1].tolist(), data.v[1].numpy())
    assert (a.shape, b.shape, a.dtype) == ((4, 4), (4, 1), torch.float32)
    u = model.inverse_dynamics(data.q_prev[1], data.q[1], data.q_next[1])
    exact = model.double().inverse_dynamics(data.q_prev, data.q, data.q_next)[1]
    torch.testing.assert_close(u.double(), exact, atol=0.05, rtol=0)
    free = make("l_node", "rk4", 2, input_matrix=torch.zeros(2, 0, dtype=torch.float64))
    assert free.linearize(data.q, data.v).B.shape == (5, 4, 0)
    assert free.inverse_dynamics(data.q_prev, data.q, data.q_next).shape == (5, 0)
    with pytest.raises(ConfigError, match="q_next has shape"):
        model.inverse_dynamics(data.q, data.q, data.q[:, :1])
