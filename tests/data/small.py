"""Data sets that are quick to make, and recordings of trajectories."""

from __future__ import annotations

import os
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd

from symo_exp.data.datamodule import TrajectoryData
from symo_exp.mechanics.types import Coordinates, Trajectories
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


def write_recordings(
    path: str | os.PathLike[str],
    trajectories: Trajectories,
    coordinates: Coordinates,
    time_step: float,
) -> None:
    """Write trajectories as a table that ``read_recordings`` takes."""
    count, nodes, _ = trajectories.q.shape
    columns: dict[str, np.ndarray] = {
        "trajectory": np.repeat(np.arange(count), nodes),
        "t": np.tile(time_step * np.arange(nodes), count),
    }
    places = coordinates.space.to_quaternions(trajectories.q)
    for field, x, names in (
        ("q", places, coordinates.measured),
        ("v", trajectories.v, coordinates.names),
    ):
        values = x.flatten(0, 1).numpy()
        columns |= {f"{field}_{name}": values[:, i] for i, name in enumerate(names)}
    u = trajectories.u.flatten(0, 1).numpy()
    columns |= {f"u_{i}": u[:, i] for i in range(u.shape[1])}
    table = pd.DataFrame(columns)
    if Path(path).suffix == ".csv":
        table.to_csv(path, index=False)
    else:
        table.to_parquet(path, index=False)
