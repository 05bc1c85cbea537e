"""Priors from the evidence, also where the data leave combinations of parameters open."""

import pytest
import torch

from symo_exp.optim.evidence import FLAT, evidence


def determined(gram, precision):
    """Return how many parameters the data determine, each in a group of its own."""
    group, theta = torch.arange(len(gram)), torch.ones_like(precision)
    found = evidence(gram, 1.0, precision, theta, group, theta > 0, theta < 0)
    return found[1]


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("size", [1e-3, 1.0, 1e6, 1e9, 1e12, 1e15])
def test_open_combinations_count_as_none(size, seed):
    """The prior alone holds them; its precision is lost in the rounding of large entries."""
    generator = torch.Generator().manual_seed(seed)
    slopes = size**0.5 * torch.randn(40, 6, dtype=torch.float64, generator=generator)
    slopes[:, 5] = slopes[:, 0] - 2.0 * slopes[:, 1]
    precision = torch.full((6,), FLAT, dtype=torch.float64)
    assert determined(slopes.T @ slopes, precision) == pytest.approx(5.0, abs=0.01)


def test_the_number_is_that_of_the_posterior():
    generator = torch.Generator().manual_seed(0)
    slopes = torch.randn(40, 6, dtype=torch.float64, generator=generator)
    precision = 10.0 ** torch.arange(-2, 4, dtype=torch.float64)
    gram = slopes.T @ slopes
    covariance = torch.linalg.inv(gram + torch.diag(precision))
    wanted = 6.0 - float(precision @ covariance.diagonal())
    assert determined(gram, precision) == pytest.approx(wanted, rel=1e-12)


def test_equations_that_are_not_finite_have_none():
    gram, theta = torch.full((2, 2), torch.inf), torch.ones(2)
    assert evidence(gram, 1.0, theta, theta, torch.arange(2), theta > 0, theta < 0) is None
