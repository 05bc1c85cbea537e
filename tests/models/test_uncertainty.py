"""Intervals of rollouts follow from the posterior, and from the error beyond it."""

import math

import numpy as np
import pytest
import torch

from symo_exp.errors import ConfigError
from symo_exp.mechanics.roots import Broyden
from symo_exp.models.uncertainty import (
    START_TIME,
    ModelPosterior,
    extended,
    quantile,
    sensitivity,
)  # fmt: skip
from symo_exp.optim.posterior import Posterior
from tests.models.methods import flows, make, make_small, pairwise

STATE = torch.tensor([0.3]).double(), torch.tensor([0.1]).double()


def with_posterior(size, *, directions=3, error=None, method="symo", integrator="midpoint"):
    model = make(method, integrator, 1)
    mean = torch.cat([p.detach().flatten() for p in model.parameters()])
    generator = torch.Generator().manual_seed(1)
    drawn = torch.randn(len(mean), directions, generator=generator, dtype=torch.float64)
    free = torch.zeros(len(mean), 0, dtype=torch.float64)
    model.posterior = ModelPosterior(Posterior(mean, size * drawn, free, 1e-3, 1e-4, 100), error)
    return model


def width(model, level=0.9):
    lower, upper = model.rollout_interval(*STATE, steps=6, level=level)
    return 0.5 * (upper - lower)


def test_half_the_deviation_of_parameters_gives_half_the_interval():
    wide, narrow = (width(with_posterior(size)) for size in (2e-5, 1e-5))
    assert (wide[2:] > 0.0).all()
    torch.testing.assert_close(wide, 2.0 * narrow, rtol=1e-3, atol=1e-12)


def test_the_interval_depends_neither_on_the_precision_nor_on_a_sample_of_the_model():
    exact = width(with_posterior(1e-2))
    single = width(with_posterior(1e-2).float())
    assert single.dtype == torch.float32
    torch.testing.assert_close(single[2:].double(), exact[2:], rtol=1e-2, atol=0.0)
    (drawn,) = with_posterior(1e-2).sample(1)
    torch.testing.assert_close(width(drawn), exact)


def test_a_number_of_samples_is_checked():
    assert len(with_posterior(1e-5).sample(np.int64(2), seed=np.int64(1))) == 2
    for count in (-1, 1.5):
        with pytest.raises(ConfigError, match=f"count={count}: expected a whole number"):
            with_posterior(1e-5).sample(count)


def test_samples_and_linearisation_agree():
    """Of a few directions every pair is a rollout; of many there are samples."""
    few, many = with_posterior(1e-5, directions=3), with_posterior(1e-5, directions=3)
    posterior = many.posterior.parameters
    zeros = torch.zeros(len(posterior.mean), 40, dtype=torch.float64)
    padded = torch.cat((posterior.directions, zeros), dim=1)
    many.posterior = ModelPosterior(posterior._replace(directions=padded))
    ratio = width(many)[2:] / width(few)[2:]
    assert ((ratio > 0.6) & (ratio < 1.5)).all()


def test_an_error_beyond_the_parameters_widens_the_interval_where_the_motion_is_sensitive():
    error = 0.1 * torch.ones(7, 1, dtype=torch.float64)
    model = with_posterior(1e-9, error=error)
    q, v = (x.unsqueeze(0) for x in STATE)
    u = torch.zeros(1, 7, 1, dtype=torch.float64)
    size = sensitivity(model.flow, q, v, u, model.flow.rollout(q, v, u).q)[0]
    assert size[-1] > 1.1 * size[0]
    torch.testing.assert_close(width(model), quantile(0.9) * error * size, rtol=1e-3, atol=1e-6)


@pytest.mark.parametrize(("method", "integrator", "n"), pairwise(flows()))
def test_sensitivity_is_that_of_starts_that_are_off(method, integrator, n):
    flow = make(method, integrator, n).flow
    generator = torch.Generator().manual_seed(2)
    q, v = 0.3 * torch.randn(2, 1, n, dtype=torch.float64, generator=generator)
    u = torch.zeros(1, 5, 1, dtype=torch.float64)
    middle = flow.rollout(q, v, u).q
    found = sensitivity(flow, q, v, u, middle)
    off, total = 1e-4, torch.zeros_like(middle)
    for step in off * torch.eye(n, dtype=torch.float64):
        for dq, dv in ((step, 0.0 * step), (0.0 * step, step / START_TIME)):
            up, down = (flow.rollout(q + s * dq, v + s * dv, u).q for s in (1.0, -1.0))
            total += ((up - down) / (2.0 * off)).square()
    torch.testing.assert_close(found, total.sqrt(), rtol=1e-4, atol=1e-6)
    torch.testing.assert_close(found[:, 0], torch.ones_like(found[:, 0]), rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize(("method", "integrator"), [("l_node", "rk4"), ("symo", "galerkin4")])
@pytest.mark.parametrize("n", [2, 3])
def test_starts_are_off_by_the_units_of_the_coordinates(method, integrator, n):
    """The sensitivity of a small machine is that of a large one, in its units."""
    flow, (small, sizes) = make(method, integrator, n).flow, make_small(method, integrator, n)
    q, v = torch.linspace(-0.4, 0.5, 2 * n, dtype=torch.float64).view(2, 1, n)
    u = torch.zeros(1, 5, 1, dtype=torch.float64)
    middle = flow.rollout(q, v, u).q
    found = sensitivity(small.flow, q * sizes, v * sizes, u, middle * sizes)
    torch.testing.assert_close(found / sizes, sensitivity(flow, q, v, u, middle), rtol=1e-6, atol=0)


def test_intervals_of_an_earlier_version_are_those_of_the_parameters_and_said_so(caplog):
    state = with_posterior(1e-5).posterior.state()
    state["error"] = state.pop("relative_error")
    assert ModelPosterior.of_state(state).relative_error is None
    assert not caplog.records
    state["error"] = torch.ones(3, 1)
    assert ModelPosterior.of_state(state).relative_error is None
    assert "earlier version" in caplog.text


def test_an_error_goes_on_growing_beyond_its_last_node():
    error = torch.tensor([[0.0], [1.0], [2.0]]).double()
    torch.testing.assert_close(extended(error, 5)[:, 0], torch.arange(5.0).double())
    assert len(extended(error, 2)) == 2


def test_a_normal_variable_is_in_its_interval():
    assert quantile(0.9) == pytest.approx(1.6449, abs=1e-4)


def test_an_interval_is_infinite_where_a_motion_diverges():
    model = with_posterior(1e-5, method="l_node", integrator="rk4")
    q, v = torch.full((2, 1), 0.3).double(), torch.tensor([[0.1], [1e25]]).double()
    assert not model.rollout(q, v, steps=4).q[1].isfinite().all()
    lower, upper = model.rollout_interval(q, v, steps=4)
    assert (upper - lower)[0].isfinite().all()
    assert (lower[1, 1:] == -torch.inf).all()
    assert (upper[1, 1:] == torch.inf).all()


def test_an_interval_is_infinite_after_a_root_that_is_not_found():
    model = with_posterior(1e-5)
    model.flow.rollout_root = Broyden(tolerance=1e-13, max_iterations=1)
    start = torch.tensor([[0.0], [0.3]]).double(), torch.tensor([[0.0], [400.0]]).double()
    found, lost = model.rollout(*start, steps=6), torch.zeros(2, 7, dtype=torch.bool)
    lost[:, 1:] = (~found.converged).cumsum(1) > 0
    assert lost.any()
    for bound in model.rollout_interval(*start, steps=6):
        assert torch.equal(bound[..., 0].isinf(), lost)


@pytest.mark.parametrize("level", [90, 0, 1, "0.9", None, [0.9], math.nan])
def test_an_invalid_level_is_refused(level):
    with pytest.raises(ConfigError, match=r"level=.*: expected a finite number above 0 and below"):
        width(with_posterior(1e-5), level=level)


@pytest.mark.parametrize("seed", [1.5, "1", None, -1, 2**70])
def test_an_invalid_seed_is_refused(seed):
    model = with_posterior(1e-5)
    with pytest.raises(ConfigError, match=f"seed={seed!r}: expected a whole number from 0"):
        model.sample(1, seed=seed)
    assert len(model.sample(1, seed=np.int64(1))) == 1


def test_a_posterior_comes_back_from_its_state():
    posterior = with_posterior(1e-5).posterior
    again = ModelPosterior.of_state(posterior.state())
    assert again.parameters.noise == posterior.parameters.noise
    torch.testing.assert_close(again.parameters.directions, posterior.parameters.directions)
