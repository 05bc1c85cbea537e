"""The table of systems: each file of conf/system, and chains of one, two and three links."""

from __future__ import annotations

import torch
from torch import Tensor

from symo_exp.systems.base import System
from tests.chain import ChainPendulum
from tests.tables import systems as configured

SYSTEMS: dict[str, System] = configured() | {f"chain_{n}": ChainPendulum(n) for n in (1, 2, 3)}


def points(system: System, count: int = 64, seed: int = 1) -> tuple[Tensor, Tensor, Tensor]:
    """States and inputs, uniform in the box."""
    generator = torch.Generator().manual_seed(seed)
    drawn = []
    for ranges in system.sampling_box:
        low, high = torch.tensor(ranges, dtype=torch.float64).T
        share = torch.rand(count, len(ranges), dtype=torch.float64, generator=generator)
        drawn.append(low + share * (high - low))
    return drawn[0], drawn[1], drawn[2]
