"""Learned dissipation, as an optimiser sees it."""

import pytest
import torch

from symo_exp.errors import ConfigError
from symo_exp.mechanics.types import Coordinates
from symo_exp.nets.affine import parameter_jacobian
from symo_exp.nets.dissipation import LearnedDissipation
from tests.dissipative import dissipative_net


@pytest.mark.parametrize("n", [1, 2, 3])
def test_derivatives_sample_by_sample_are_those_of_each_sample_alone(n):
    lagrangian = dissipative_net(n)
    q, v = torch.randn(2, 4, n, dtype=torch.float64)
    parameters = list(lagrangian.parameters())
    inputs = q.clone().requires_grad_(), v.clone().requires_grad_()

    def force(rows=slice(None)):
        return lagrangian.gradients(*(x[rows] for x in inputs)).q

    found = parameter_jacobian(force, parameters, inputs)
    for sample in range(len(q)):
        for i in range(n):
            alone = force(slice(sample, sample + 1))[0, i]
            (*by_input,) = torch.autograd.grad(alone, (*inputs, *parameters), allow_unused=True)
            flat = torch.cat([
                (torch.zeros_like(p) if g is None else g).flatten()
                for p, g in zip(parameters, by_input[2:], strict=True)
            ])  # fmt: skip
            torch.testing.assert_close(found.parameters[sample, i], flat)
            for mine, oracle in zip(found.inputs, by_input[:2], strict=True):
                torch.testing.assert_close(mine[sample, i], oracle[sample])


@pytest.mark.parametrize("wrong", [{"joints": "chain"}, {"rest_velocity": 0.0}])
def test_bad_settings_are_refused_in_a_line(wrong):
    with pytest.raises(ConfigError, match=f"dissipation.{next(iter(wrong))}"):
        LearnedDissipation(coordinates=Coordinates(("a",), (True,)), **wrong)
