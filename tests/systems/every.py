"""The table of systems: each complete file of conf/system, chains, and a MuJoCo model."""

from __future__ import annotations

from torch import Tensor

from symo_exp.systems.base import LagrangianSystem
from symo_exp.systems.chain import ChainPendulum
from tests.systems import models
from tests.tables import systems as configured

SYSTEMS: dict[str, LagrangianSystem] = configured() | {
    **{f"chain_{n}": ChainPendulum(n) for n in (1, 2)},
    "mujoco": models.read(models.PENDULUMS),
    "puppet": models.read(models.PUPPET, viscous=[0.0] * 8),
    "drone": models.read(models.DRONE, viscous=[0.0] * 10),
}

FLAT = {name: system for name, system in SYSTEMS.items() if not system.space.rotations}
"""Those of lengths and angles."""


def points(system: LagrangianSystem, count: int = 64) -> tuple[Tensor, Tensor, Tensor]:
    """States and inputs, uniform in the box."""
    return system.points(count, seed=1)
