"""The recordings that come with the project: a command for each of them works."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch
from hydra.utils import instantiate

import symo_exp
from symo_exp.job.parts import build
from symo_exp.runs.folder import RunFolder
from tests.jobs import job_of
from tests.pages import ROOT

FILES = sorted((ROOT / "recordings").glob("*.parquet"))
SPLITS = ["train", "val", "test"]


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_a_recording_is_enough(file: Path, workplace: Path) -> None:
    words = f"data=recorded data.path={file} system=recorded system.angular=all"
    job = job_of(*words.split(), "system.time_step=0.02", "model=symo")
    data = build(job.values, RunFolder(workplace / "run")).data
    data.setup()
    table = pd.read_parquet(file)
    ends = table.groupby(["split", "trajectory"], sort=False)["t"].max()
    for part in SPLITS:
        found = data.trajectories(part)
        assert len(found) == len(ends[part])
        for motion, seconds in zip(found, ends[part], strict=True):
            assert seconds - 0.041 < 0.02 * (len(motion.q) - 1) <= seconds + 1e-3
    assert data.diagnosis().explained > 0.9
    assert data.diagnosis().fixes_scale == ("motor" in file.stem)


def test_the_configuration_of_a_run_is_whole(workplace: Path) -> None:
    """Its system is made again where the recording is not."""
    columns = {"trajectory": 0, "t": [0.0, 0.1, 0.2], "angle": 0.0, "u_motor": 0.0, "u_bat": 9}
    table = pd.concat([pd.DataFrame(columns).assign(trajectory=k) for k in range(3)])
    table.to_csv("mine.csv", index=False)
    words = "data=recorded data.path=mine.csv system=recorded system.angular=[arm]"
    job = job_of(*words.split(), "system.time_step=0.1", "data.columns={q_arm: angle, u_bat: null}")
    stated = job.values["system"]
    Path("mine.csv").unlink()
    system = instantiate(stated)
    assert system.coordinates.names == ("arm",)
    assert system.inputs == ("motor",)
    assert torch.equal(system.input_matrix, torch.ones(1, 1, dtype=torch.float64))
    assert stated["_target_"].startswith("symo_exp.systems.")


def test_a_recorded_machine_is_learned_without_friction(workplace: Path) -> None:
    t = 0.05 * np.arange(20)
    motions = [
        pd.DataFrame({"trajectory": k, "t": t, "q_arm": (k + 1) * 0.1 * np.cos(3.0 * t)})
        for k in range(4)
    ]
    pd.concat(motions).to_csv("mine.csv", index=False)
    words = "data=recorded data.path=mine.csv system=recorded system.angular=all model=symo"
    quiet = ["logger=none", "pictures=false", "trainer.max_epochs=1", "net.width=8"]
    run = symo_exp.run(*words.split(), "system.time_step=0.05", *quiet)
    assert not isinstance(run, list)
    assert run.model.dissipation is None
