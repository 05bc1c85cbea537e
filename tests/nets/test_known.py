"""Known equations with learnable constants: initial values and derivatives."""

from dataclasses import dataclass, replace
from typing import Annotated

import pytest
import torch

from symo_exp.errors import ConfigError
from symo_exp.mechanics.lagrangian import Lagrangian
from symo_exp.mechanics.types import Coordinates
from symo_exp.nets.known import KnownFriction, KnownLagrangian
from symo_exp.systems.base import LagrangianSystem
from tests.learned import assert_each_sample_alone, assert_same
from tests.systems import models
from tests.systems.every import SYSTEMS, points

SYSTEMS = SYSTEMS | {"crane": models.read(models.CRANE)}


@pytest.fixture(params=SYSTEMS)
def system(request):
    return SYSTEMS[request.param]


@pytest.fixture
def known(system):
    found = KnownLagrangian(system=system).double()
    torch.manual_seed(2)
    with torch.no_grad():
        for p in found.parameters():
            p += 0.1 * torch.randn_like(p)
    return found


def test_initial_constants_are_those_of_the_system(system):
    q, *_ = points(system, 16)
    found = KnownLagrangian(system=system).double()
    mass = system.mass_matrix(q)
    size = mass.abs().max()
    assert (found.mass_matrix(q) - mass).abs().max() < 1e-5 * size  # thin bodies have a little
    torch.testing.assert_close(found.potential(q), system.potential(q), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("quantity", ["gradients", "rates"])
def test_derivatives_are_those_of_autograd(system, known, quantity):
    q, v, _ = points(system, 6)
    q, v = q.requires_grad_(), v.requires_grad_()
    own = getattr(known, quantity)(q, v)
    plain = getattr(Lagrangian, quantity)(known, q, v)
    size = max(float(x.detach().abs().max()) for x in plain)
    assert_same(own, plain, [q, v, *known.parameters()], 1e-11 * max(1.0, size))


def test_derivatives_sample_by_sample_are_those_of_each_sample_alone(system, known):
    q, v, _ = points(system, 3)
    assert_each_sample_alone(known, q, v)


def test_the_inertia_is_positive_definite_for_any_parameters(system):
    found, (q, *_) = KnownLagrangian(system=system).double(), points(system, 32)
    torch.manual_seed(3)
    with torch.no_grad():
        for p in found.parameters():
            p += torch.randn_like(p)
    assert torch.linalg.eigvalsh(found.mass_matrix(q)).min() > 0.0


@dataclass(frozen=True, kw_only=True)
class Careless(LagrangianSystem):
    """A system whose inertia forgets that its mass is a parameter."""

    mass: Annotated[float, "kg"]
    coordinates = Coordinates(names=("x",), angular=(False,))
    input_matrix = torch.ones(1, 1, dtype=torch.float64)

    def mass_matrix(self, q):
        return torch.full_like(q, float(self.mass)).unsqueeze(-1)

    def potential(self, q):
        return self.mass * q[:, 0]


def test_a_system_that_loses_its_derivatives_is_refused():
    box = {"q": [[-1, 1]], "v": [[-1, 1]], "u": [[-1, 1]]}
    system = Careless(mass=2.0, time_step=0.1, box=box)
    with pytest.raises(ConfigError, match=r"torch\.ones_like"):
        KnownLagrangian(system=system)


def test_an_unknown_constant_is_refused():
    with pytest.raises(ConfigError, match="no such constant; there are gravity"):
        KnownLagrangian(system=SYSTEMS["pendulum"], fixed=["weight"])


def test_a_fixed_constant_is_no_parameter():
    found = KnownLagrangian(system=SYSTEMS["pendulum"], fixed=["gravity"])
    assert found.numbers == ["mass", "length"]
    assert sum(p.numel() for p in found.parameters()) == 2


def test_friction_dissipates():
    torch.manual_seed(4)
    system = replace(SYSTEMS["cartpole"], viscous=(0.3, 0.0), coulomb=(0.0, 0.2))
    friction = KnownFriction(system=system).double()
    with torch.no_grad():
        friction.logarithms.add_(torch.randn(2))
    q, v = torch.randn(2, 64, 2, dtype=torch.float64).unbind()
    assert ((friction.force(q, v) * v).sum(1) < 0.0).all()
    assert friction.coefficients()[0][0, 1] == 0.0
