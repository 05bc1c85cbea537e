"""Data sets that are quick to make."""

from __future__ import annotations

from tempfile import TemporaryDirectory
from typing import Any

from symo_exp.data.datamodule import TrajectoryData
from symo_exp.systems.simulation import Solver
from symo_exp.systems.table import system as stated

CACHE = TemporaryDirectory()
SIZES: dict[str, Any] = {
    "n_train_max": 8,
    "n_val": 3,
    "n_test": 4,
    "n_steps": 4,
    "n_integration": 2,
    "integration_steps": 6,
    "solver": Solver("RK45", 1e-4, 1e-4),
}


def small(**changes: Any) -> TrajectoryData:
    """A cartpole's data; not set up."""
    return TrajectoryData(**({"system": stated("cartpole"), "n_traj": 4} | SIZES | changes))


def ready(**changes: Any) -> TrajectoryData:
    """The same, set up; what was made once is read again."""
    data = small(**({"cache_dir": CACHE.name} | changes))
    data.prepare_data()
    data.setup()
    return data
