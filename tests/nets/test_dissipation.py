"""Learned dissipation, as an optimiser sees it."""

import pytest
import torch

from symo_exp.errors import ConfigError
from symo_exp.mechanics.types import Coordinates
from symo_exp.nets.dissipation import LearnedDissipation
from symo_exp.nets.drag import LearnedDrag
from tests.dissipative import dissipative_net, dragged_net
from tests.learned import assert_each_sample_alone
from tests.systems.models import mjcf, read


@pytest.mark.parametrize("make", [dissipative_net, dragged_net])
@pytest.mark.parametrize("n", [1, 2, 3])
def test_derivatives_sample_by_sample_are_those_of_each_sample_alone(n, make):
    lagrangian = make(n)
    q, v = torch.randn(2, 4, n, dtype=torch.float64)
    assert_each_sample_alone(lagrangian, q, v)


@pytest.mark.parametrize("wrong", [{"joints": "chain"}, {"rest_velocity": 0.0}, {"start": 0.0}])
def test_bad_settings_are_refused_in_a_line(wrong):
    with pytest.raises(ConfigError, match=f"dissipation.{next(iter(wrong))}"):
        LearnedDissipation(coordinates=Coordinates(("a",), (True,)), **wrong)


def test_a_drag_of_no_speeds_is_refused_in_a_line():
    with pytest.raises(ConfigError, match=r"dissipation\.speeds=0"):
        LearnedDrag(coordinates=Coordinates(("a",), (True,)), speeds=0)


def test_a_drag_can_be_that_of_a_link_in_a_fluid():
    """Three speeds suffice: along the link, across it and about its centre."""
    body = '<body><joint name="x" type="slide" axis="1 0 0"/><joint name="y" type="slide" '
    body += 'axis="0 1 0"/><joint name="turn" axis="0 0 1"/><geom type="box" size="0.5 0.1 0.2"/>'
    swimmer = read(mjcf(f"{body}</body>", option='<option density="1000" viscosity="3"/>'))
    (hull,) = swimmer.mechanism["fluid"]["hulls"]
    true = swimmer.dissipation
    found = LearnedDrag(coordinates=swimmer.coordinates, speeds=3).double()
    a, b, c = hull["sides"]
    mean = (a + b + c) / 3
    fast = torch.tensor(
        [500.0 * b * c, 500.0 * a * c, 1000.0 * c * (a**4 + b**4) / 64], dtype=torch.float64
    )
    slow = 3.0 * torch.pi * torch.tensor([3.0 * mean, 3.0 * mean, mean**3], dtype=torch.float64)
    scale = fast ** (1 / 3)
    with torch.no_grad():
        weight = found.weight.zero_().unflatten(0, (3, 3))  # of cos and sin of the turning
        weight[0, 0, 0] = weight[1, 1, 0] = 1.0
        weight[0, 1, 1], weight[1, 0, 1] = 1.0, -1.0
        weight *= scale[:, None, None]
        found.bias.zero_()[-1] = scale[2]
        found.viscous.copy_(torch.log(torch.expm1(slow / scale**2)))
    q, v = 2.0 * torch.randn(2, 20, 3, dtype=torch.float64)
    torch.testing.assert_close(found.force(q, v), true.force(q, v), rtol=1e-9, atol=1e-9)
