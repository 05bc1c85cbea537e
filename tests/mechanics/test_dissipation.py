"""Dissipation: its power is negative, and it is one of the forces."""

from functools import partial
from itertools import cycle

import pytest
import torch

from symo_exp.mechanics.euler_lagrange import acceleration
from tests.dissipative import (
    DISSIPATIVE,
    dissipative_chain,
    friction,
    learned_dissipation,
    learned_drag,
    machine_friction,
)
from tests.mechanics.motions import roll, start
from tests.tables import variational_integrators

METHODS = variational_integrators()
every_n = pytest.mark.parametrize("n", [1, 2, 3])


def states(n):
    generator = torch.Generator().manual_seed(5)
    return torch.randn(2, 7, n, dtype=torch.float64, generator=generator)


@every_n
@pytest.mark.parametrize(
    "make",
    [friction, learned_dissipation, learned_drag, partial(machine_friction, constant=False)],
)
def test_the_power_of_dissipation_is_negative(make, n):
    dissipation, (q, v) = make(n), states(n)
    for scale in (1e-3, 1.0, 30.0):
        assert ((scale * v * dissipation.force(q, scale * v)).sum(-1) < 0).all()
    assert not dissipation.force(q, torch.zeros_like(v)).any()


@every_n
@pytest.mark.parametrize("kind", DISSIPATIVE)
def test_dissipation_is_one_of_the_forces_and_no_part_of_the_energy(kind, n):
    lagrangian, (q, v) = DISSIPATIVE[kind](n), states(n)
    force = torch.sin(q)
    expected = acceleration(
        lagrangian.conservative, q, v, force + lagrangian.dissipation.force(q, v)
    )
    torch.testing.assert_close(acceleration(lagrangian, q, v, force), expected)
    assert torch.equal(lagrangian.energy(q, v), lagrangian.conservative.energy(q, v))


@pytest.mark.parametrize(("name", "n"), [*zip(METHODS, cycle((1, 2, 3)))])
@torch.no_grad()
def test_energy_never_rises_without_input(name, n):
    """Friction exceeds the oscillation of the energy of a symplectic method here."""
    method, lagrangian, h = METHODS[name], dissipative_chain(n, rest_velocity=0.2), 0.02
    q, v = start(n)
    path = roll(method, lagrangian, q, lagrangian.momentum(q, v), 25, h)
    energies = [lagrangian.energy(q, lagrangian.velocity(q, p)) for q, p in zip(*path, strict=True)]
    assert (torch.stack(energies).diff(dim=0) < 0).all()
