"""Known equations with learnable constants: initial values and settings."""

from dataclasses import dataclass, replace
from typing import Annotated

import pytest
import torch

from symo_exp.errors import ConfigError
from symo_exp.mechanics.types import Coordinates
from symo_exp.nets.known import KnownFriction, KnownLagrangian
from symo_exp.systems.base import LagrangianSystem
from tests.systems import models
from tests.systems.every import SYSTEMS as EVERY
from tests.systems.every import points

SYSTEMS = EVERY | {"crane": models.read(models.CRANE)}


@pytest.mark.parametrize("system", SYSTEMS.values(), ids=SYSTEMS)
def test_initial_constants_are_those_of_the_system(system):
    q, *_ = points(system, 16)
    found = KnownLagrangian(system=system).double()
    mass = system.mass_matrix(q)
    size = mass.abs().max()
    assert (found.mass_matrix(q) - mass).abs().max() < 1e-5 * size  # thin bodies have a little
    torch.testing.assert_close(found.potential(q), system.potential(q), rtol=1e-9, atol=1e-9)


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


@dataclass(frozen=True, kw_only=True)
class Assigned(Careless):
    """A system that sets the entries of a new tensor, which belongs to no sample."""

    def mass_matrix(self, q):
        mass = torch.zeros(len(q), 1, 1).to(q)
        mass[:, 0, 0] = self.mass * q[:, 0].cosh()
        return mass


@dataclass(frozen=True, kw_only=True)
class Set(Careless):
    """The same in a tensor like those of the samples."""

    def mass_matrix(self, q):
        mass = q.new_zeros(len(q), 1, 1)
        mass[:, 0, 0] = self.mass * q[:, 0].cosh()
        return mass


@pytest.mark.parametrize(
    ("kind", "mend"),
    [
        (Careless, r"torch\.ones_like"),
        (Assigned, r"\(test_known.py, line \d+\).* q.new_zeros"),
        (Set, None),
    ],
)
def test_a_system_that_loses_its_derivatives_is_refused(kind, mend):
    box = {"q": [[-1, 1]], "v": [[-1, 1]], "u": [[-1, 1]]}
    system = kind(mass=2.0, time_step=0.1, box=box)
    if mend is None:
        KnownLagrangian(system=system)
        return
    with pytest.raises(ConfigError, match=mend):
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
