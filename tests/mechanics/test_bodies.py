"""Pseudo-inertias of rigid bodies, at every size."""

import pytest
import torch

from symo_exp.mechanics.bodies import of_pseudo_inertia, pseudo_inertia

SIZES = [1.0, 1e-2, 1e-4, 1e-6]
"""Of cubes of water [m]."""
PLACES = [0.0, 1.0, 100.0]
"""Distances of the centre from the joint, and from the origin, over the size."""


def numbers(*given):
    return [torch.tensor(x, dtype=torch.float64) for x in given]


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("size", SIZES)
def test_a_pseudo_inertia_is_that_of_the_body(size, place):
    mass = 1e3 * size**3
    m, centre = numbers(mass, [place * size, 0.0, 0.0])
    inertia = mass * size**2 * torch.diag(*numbers([0.1, 0.13, 0.17]))
    found = of_pseudo_inertia(pseudo_inertia(m, centre, inertia, place * size))
    for x, y in zip(found, (m, centre, inertia), strict=True):
        torch.testing.assert_close(x, y, rtol=1e-9, atol=1e-9 * float(y.abs().max()))


@pytest.mark.parametrize("moments", [(1.0, 1.0, 2.0), (0.0, 1.0, 1.0), (0.0, 0.0, 0.0)])
@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("size", SIZES)
def test_that_of_a_thin_body_or_a_point_is_positive_definite_and_nearly_its_own(
    size, place, moments
):
    mass = 1e3 * size**3
    m, centre = numbers(mass, [0.0, -place * size, 0.0])
    inertia = mass * size**2 * torch.diag(*numbers(moments))
    for lever in (0.0, place * size):  # the joint at the centre, or at the origin
        body = pseudo_inertia(m, centre, inertia, lever)
        torch.linalg.cholesky(body.flip(0, 1))
        about = float(inertia.abs().max()) + mass * (place * size) ** 2
        close = 1e-5 * about or 1e-9 * mass
        torch.testing.assert_close(of_pseudo_inertia(body)[2], inertia, rtol=0, atol=close)
