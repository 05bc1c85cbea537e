"""Simulated data of the configuration are what the code would make by itself."""

from __future__ import annotations

from pathlib import Path

from hydra.utils import instantiate
from omegaconf import OmegaConf

from symo_exp.data.datamodule import TrajectoryData
from symo_exp.systems.table import system as stated
from tests.tables import CONF


def test_simulated_data_of_the_configuration_are_the_defaults_of_the_code(tmp_path: Path) -> None:
    config = OmegaConf.create({"seed": 3, "dtype": "float64"})
    config.draws = OmegaConf.load(CONF / "draws" / "independent.yaml")
    config.data = OmegaConf.load(CONF / "data" / "simulated.yaml")
    config.data.cache_dir = str(tmp_path)
    system = stated("pendulum")
    data = instantiate(config.data, _partial_=True)(system=system)
    assert data.recipe() == TrajectoryData(system=system, n_traj=1, seed=3).recipe()
    assert (data.seed, data.noise_seed, str(data.dtype)) == (3, 3, "torch.float64")
