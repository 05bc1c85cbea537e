"""Harmonics of angles: their number and the functions that they span."""

import pytest
import torch

from symo_exp.nets.harmonics import Harmonics
from symo_exp.systems.chain import ChainPendulum


@pytest.mark.parametrize(
    ("angles", "order", "size"), [(1, 1, 2), (2, 2, 8), (3, 3, 26), (3, 2, 18)]
)
def test_the_number_of_harmonics_is_that_of_products_of_cosines_and_sines(angles, order, size):
    assert Harmonics(angular=(True,) * angles, order=order).size == size


def test_lengths_have_no_harmonics():
    assert Harmonics(angular=(False, False), order=2).size == 0
    q = torch.randn(5, 2)
    harmonics = Harmonics(angular=(False, True), order=2)
    assert torch.equal(harmonics(q).x, harmonics(q + torch.tensor([1.0, 0.0])).x)


@pytest.mark.parametrize("n", [1, 2, 3])
def test_inertia_and_potential_of_a_chain_are_linear_in_them(n):
    chain = ChainPendulum(n)
    q = 3.0 * torch.randn(200, n, dtype=torch.float64)
    features = Harmonics(angular=(True,) * n, order=2).double()(q).x
    basis = torch.cat((torch.ones_like(q[:, :1]), features), dim=1)
    wanted = torch.cat((chain.mass_matrix(q).flatten(1), chain.potential(q)[:, None]), dim=1)
    found = basis @ torch.linalg.lstsq(basis, wanted, driver="gelsd").solution
    torch.testing.assert_close(found, wanted, atol=1e-9, rtol=0)
