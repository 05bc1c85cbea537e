"""Resampling to equal steps: exact on cubics, of fourth order, and averaging the noise."""

from __future__ import annotations

import numpy as np
import pytest

from symo_exp.data.resample import Samples, resample

H = 0.05


def times(samples: float, seconds: float = 4.0, jitter: float = 0.3, start: float = 7.0):
    """About so many samples in a step, irregular."""
    rng = np.random.default_rng(3)
    t = np.arange(0, seconds, H / samples)
    return start + t + rng.uniform(-jitter / 2, jitter / 2, len(t)) * H / samples


def given(t: np.ndarray, motion, velocity=None, inputs=None) -> Samples:
    u = np.zeros((len(t), 0)) if inputs is None else inputs(t)[:, None]
    return Samples(t, motion(t), None if velocity is None else velocity(t), u)


RATES = [1.2, 2.5, 4, 7, 25]


@pytest.mark.parametrize("n", [1, 2, 3])
@pytest.mark.parametrize("rate", RATES)
def test_cubics_are_exact(rate: float, n: int) -> None:
    rng = np.random.default_rng(n)
    factors = rng.standard_normal((4, n))

    def motion(t: np.ndarray) -> np.ndarray:
        return ((t - 8)[:, None] ** np.arange(4)) @ factors

    found = resample(given(times(rate), motion), H)
    np.testing.assert_allclose(np.diff(found.t), H, rtol=1e-9)
    np.testing.assert_allclose(found.q, motion(found.t), atol=1e-9)
    slope = ((found.t - 8)[:, None] ** np.arange(3) * [1, 2, 3]) @ factors[1:]
    np.testing.assert_allclose(found.v, slope, atol=1e-7)


@pytest.mark.parametrize("rate", RATES)
def test_measured_velocities_are_read(rate: float) -> None:
    found = resample(given(times(rate), lambda t: 0 * t[:, None], lambda t: t[:, None] ** 2), H)
    assert found.v is not None
    np.testing.assert_allclose(found.v[:, 0], found.t**2, rtol=1e-9)


def test_the_error_is_of_fourth_order() -> None:
    errors = []
    for h in (0.08, 0.04):
        t = np.linspace(0, 4, round(4 / h * 10) + 1)
        found = resample(Samples(t, np.sin(5 * t)[:, None], None, np.zeros((len(t), 0))), h)
        errors.append(np.abs(found.q[:, 0] - np.sin(5 * found.t)).max())
    assert 12 < errors[0] / errors[1] < 20
    assert errors[1] < 1e-5


def test_many_samples_average_the_noise() -> None:
    """By √(9 / 4N) for N samples in a step."""
    t = times(20, seconds=60)
    q = np.random.default_rng(0).standard_normal((len(t), 1))
    found = resample(Samples(t, q, None, np.zeros((len(t), 0))), H)
    assert found.q.std() == pytest.approx(np.sqrt(9 / 80), rel=0.1)


@pytest.mark.parametrize("rate", RATES)
def test_inputs_keep_their_impulse(rate: float) -> None:
    t = times(rate)
    u = np.random.default_rng(1).standard_normal((len(t), 2))
    found = resample(Samples(t, u, None, u), H)
    edges = found.t[1] - H / 2, found.t[-2] + H / 2
    fine = np.union1d(t[(t > edges[0]) & (t < edges[1])], edges)
    for i in range(2):
        impulse = np.trapezoid(np.interp(fine, t, u[:, i]), fine)
        assert found.u[1:-1, i].sum() * H == pytest.approx(impulse, abs=1e-9)


def test_a_gap_is_bridged() -> None:
    t = times(10)
    t = t[(t < 8) | (t > 8.1)]
    found = resample(given(t, lambda t: np.sin(3 * t)[:, None]), H)
    np.testing.assert_allclose(found.q[:, 0], np.sin(3 * found.t), atol=1e-4)
    np.testing.assert_allclose(np.diff(found.t), H, rtol=1e-9)


def test_dense_samples_lose_half_a_step_at_either_end_and_sparse_ones_nothing() -> None:
    for rate, lead in [(10, H / 2), (2, 0)]:
        t = np.linspace(1, 3, round(2 / H * rate) + 1)
        found = resample(given(t, lambda t: t[:, None]), H)
        np.testing.assert_allclose(found.t[[0, -1]], [1 + lead, 3 - lead], atol=1e-9)
