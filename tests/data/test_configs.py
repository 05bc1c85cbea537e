"""The data of the configuration are what the code would make by itself."""

from __future__ import annotations

from pathlib import Path

from hydra.utils import instantiate
from omegaconf import OmegaConf

from symo_exp.data.datamodule import TrajectoryData
from symo_exp.data.draws import uniform
from symo_exp.data.recorded import RecordedData, write_recordings
from symo_exp.data.simulate import generate
from symo_exp.systems.simulation import Solver
from symo_exp.systems.table import system as stated
from tests.tables import CONF


def composed(name: str, **changes: object):
    config = OmegaConf.create({"seed": 3, "dtype": "float64"})
    config.draws = OmegaConf.load(CONF / "draws" / "independent.yaml")
    config.data = OmegaConf.load(CONF / "data" / f"{name}.yaml")
    config.data.update(changes)
    return instantiate(config.data, _partial_=True)(system=stated("pendulum"))


def test_simulated(tmp_path: Path) -> None:
    data = composed("simulated", cache_dir=str(tmp_path))
    assert isinstance(data, TrajectoryData)
    assert data.recipe() == TrajectoryData(system=stated("pendulum"), n_traj=1, seed=3).recipe()
    assert (data.seed, data.noise_seed, str(data.dtype)) == (3, 3, "torch.float64")


def test_recorded(tmp_path: Path) -> None:
    system, path = stated("pendulum"), tmp_path / "mine.parquet"
    solver = Solver("RK45", 1e-4, 1e-4)
    truth = generate(system, uniform(system.box, 4, 0), steps=6, forced=True, solver=solver)
    write_recordings(path, truth, system.coordinates, system.time_step)
    data = composed("recorded", path=str(path))
    assert isinstance(data, RecordedData)
    data.setup()
    assert [t.q.shape for t in data.train_trajectories] == [(7, 1)] * 2
