"""The table of systems: each file of conf/system, and chains of one, two and three links."""

from __future__ import annotations

from torch import Tensor

from symo_exp.systems.base import LagrangianSystem
from tests.chain import ChainPendulum
from tests.tables import systems as configured

SYSTEMS: dict[str, LagrangianSystem] = configured() | {
    f"chain_{n}": ChainPendulum(n) for n in (1, 2, 3)
}


def points(system: LagrangianSystem, count: int = 64) -> tuple[Tensor, Tensor, Tensor]:
    """States and inputs, uniform in the box."""
    return system.box.points(count, seed=1)
