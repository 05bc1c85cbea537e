"""Inputs that forces follow with a time constant."""

import numpy as np
import pytest

from symo_exp.data.delays import lagging
from symo_exp.data.resample import Samples

LAG = 0.3


def followed(u, lag=LAG):
    """What follows an input, sampled at irregular times."""
    t = np.sort(np.random.default_rng(0).uniform(0.0, 4.0, 300))
    found = lagging(Samples(t, t[:, None], None, u(t - t[0])[:, None]), lag)
    return t - t[0], found.u[:, 0]


def test_a_ramp_is_followed_exactly():
    t, found = followed(lambda t: 2.0 * t + 1.0)
    np.testing.assert_allclose(found, 2.0 * (t - LAG + LAG * np.exp(-t / LAG)) + 1.0)


def test_what_stays_the_same_is_followed_at_once():
    _, found = followed(lambda t: np.full_like(t, 3.0))
    np.testing.assert_allclose(found, 3.0)


@pytest.mark.parametrize("lag", [0.0, 1e-9])
def test_without_a_lag_nothing_changes(lag):
    t, found = followed(np.sin, lag)
    np.testing.assert_allclose(found, np.sin(t), atol=1e-7)
