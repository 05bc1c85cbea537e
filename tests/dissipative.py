"""Lagrangians with dissipation, true and learned, at any n."""

import torch

from symo_exp.mechanics.dissipation import DissipativeLagrangian, Friction
from symo_exp.mechanics.scaled import ScaledDissipation, ScaledLagrangian
from symo_exp.mechanics.types import Coordinates
from symo_exp.mechanics.units import Units
from symo_exp.nets.dissipation import LearnedDissipation, MachineFriction
from symo_exp.nets.drag import LearnedDrag
from symo_exp.systems.chain import ChainPendulum
from tests.learned import learned_lagrangian

UNITS = Units(length=0.5, time=0.8, mass=1.5)


def friction(n: int, rest_velocity: float = 0.5) -> Friction:
    """Coupled viscous and dry friction."""
    factor = 0.3 * torch.eye(n, dtype=torch.float64) + 0.1
    dry = torch.linspace(0.1, 0.3, n, dtype=torch.float64)
    return Friction(factor @ factor.T, dry, rest_velocity)


def dissipative_chain(n: int, rest_velocity: float = 0.5) -> DissipativeLagrangian:
    return DissipativeLagrangian(ChainPendulum(n), friction(n, rest_velocity))


def learned_dissipation(n: int, *, joints: str = "own") -> LearnedDissipation:
    """Of all kinds together, with random coefficients."""
    torch.manual_seed(n)
    found = LearnedDissipation(
        coordinates=_coordinates(n), viscous=True, coulomb=True, width=5, joints=joints
    ).double()
    with torch.no_grad():
        for p in found.parameters():
            p += 0.3 * torch.randn_like(p)
    return found


def dissipative_net(n: int) -> DissipativeLagrangian:
    conservative = learned_lagrangian((True, False, True)[:n], harmonics=2)
    return DissipativeLagrangian(conservative, learned_dissipation(n, joints="neighbours"))


def machine_friction(n: int, *, joints: str = "own", constant: bool = True) -> MachineFriction:
    """All terms together, with random coefficients."""
    torch.manual_seed(n)
    found = MachineFriction(
        coordinates=_coordinates(n), stribeck=True, constant=constant, width=3, joints=joints,
        rest_velocity=0.4,
    ).double()  # fmt: skip
    with torch.no_grad():
        for p in found.parameters():
            p += 0.5 * torch.randn_like(p)
    return found


def machine_net(n: int) -> DissipativeLagrangian:
    conservative = learned_lagrangian((True, False, True)[:n], harmonics=2)
    return DissipativeLagrangian(conservative, machine_friction(n, joints="neighbours"))


def learned_drag(n: int) -> LearnedDrag:
    torch.manual_seed(n)
    return LearnedDrag(coordinates=_coordinates(n)).double()


def dragged_net(n: int) -> DissipativeLagrangian:
    conservative = learned_lagrangian((True, False, True)[:n], harmonics=2)
    return DissipativeLagrangian(conservative, learned_drag(n))


def scaled_net(n: int) -> DissipativeLagrangian:
    """The same as ``machine_net``, with parameters in units of their own."""
    coordinates = _coordinates(n)._replace(units=UNITS)
    found = machine_net(n)
    friction = ScaledDissipation(found.dissipation, coordinates)
    return DissipativeLagrangian(
        ScaledLagrangian(found.conservative, coordinates), friction
    ).double()


LEARNED = {
    "learned friction": dissipative_net,
    "friction of a machine": machine_net,
    "drag": dragged_net,
    "friction in units of its own": scaled_net,
}
"""Kind of a learned dissipation to a Lagrangian with it, made for a number of coordinates."""
DISSIPATIVE = {"friction": dissipative_chain, **LEARNED}


def _coordinates(n: int) -> Coordinates:
    return Coordinates(tuple(f"q{i}" for i in range(n)), (True, False, True)[:n])
