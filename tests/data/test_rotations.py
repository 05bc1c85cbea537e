"""Recordings with quaternions: reading in every form, and refusals."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pandas as pd
import pytest
import torch

from symo_exp.data.noise import add_noise
from symo_exp.data.recorded import RecordedData
from symo_exp.errors import ConfigError
from symo_exp.mechanics.space import rotation_vector
from symo_exp.mechanics.types import Trajectories
from symo_exp.systems.recorded import Recorded
from symo_exp.systems.simulation import Solver, simulate
from symo_exp.systems.table import system as stated
from tests.data.small import write_recordings

H = 0.04
NAMES = ("x", "y", "z", "R_w", "R_x", "R_y", "R_z")
INPUTS = ("0", "1", "2", "3")


def motion() -> Trajectories:
    """Three motions of the quadrotor."""
    system = stated("quadrotor", time_step=H)
    q, v, u = system.points(3, seed=0)
    return simulate(system, q, v, u, 12, Solver())


def table(path: Path) -> pd.DataFrame:
    write_recordings(path / "one.parquet", motion(), stated("quadrotor").coordinates, H)
    return pd.read_parquet(path / "one.parquet")


def machine(**changes: Any) -> Recorded:
    settings = {
        "names": NAMES, "inputs": INPUTS, "rotations": ["R"], "angular": "none", "time_step": H,
        "input_matrix": stated("quadrotor").input_matrix.tolist(),
    }  # fmt: skip
    return Recorded(**settings | changes)


def read(frame: pd.DataFrame, path: Path, **changes: Any) -> RecordedData:
    frame.to_csv(path / "table.csv", index=False)
    return RecordedData(
        system=machine(**changes), path=path / "table.csv", n_val=1, n_test=1, dtype="float64"
    )


def test_written_recordings_are_read_as_they_were(tmp_path: Path) -> None:
    data, path = read(table(tmp_path), tmp_path), motion()
    data.setup()
    torch.testing.assert_close(data.trajectories("train")[0].q, path.q[0])
    torch.testing.assert_close(data.trajectories("train")[0].v, path.v[0])
    assert data.train.q.shape[1] == 12


def test_the_sign_and_the_length_of_a_quaternion_do_not_matter(tmp_path: Path) -> None:
    frame = table(tmp_path)
    columns = [f"q_R_{part}" for part in "wxyz"]
    frame.loc[::2, columns] *= -1.0009
    data = read(frame, tmp_path)
    data.setup()
    torch.testing.assert_close(data.trajectories("train")[0].q, motion().q[0])


def test_velocities_come_from_poses_and_times_are_resampled(tmp_path: Path) -> None:
    frame = table(tmp_path).drop(columns=[f"v_{n}" for n in stated("quadrotor").coordinates.names])
    path = motion()
    for step in (H, 1.5 * H):
        data = read(frame, tmp_path, time_step=step)
        data.setup()
        found = data.trajectories("train")[0]
        nodes = found.q.shape[0]
        turn = found.q[:, 3:].view(nodes, 3, 3)
        one = torch.eye(3).double().expand_as(turn)
        torch.testing.assert_close(turn @ turn.mT, one, rtol=0, atol=1e-12)
        assert torch.isfinite(found.v).all()
        if step == H:
            inner = slice(1, -1)
            assert (found.v - path.v[0])[inner].abs().max() < 0.03 * path.v[0].abs().max()
        else:
            rates = machine(time_step=step).coordinates.space.difference(found.q[:-1], found.q[1:])
            middle = 0.5 * (found.v[1:] + found.v[:-1])
            assert (rates / step - middle).abs().max() < 0.1 * path.v[0].abs().max()


@pytest.mark.parametrize(
    ("change", "settings", "text"),
    [
        (lambda f: f.assign(q_R_w=1.01 * f.q_R_w + 0.2), {}, "expected a unit quaternion"),
        (lambda f: f, {"rotations": ["S"]}, "no column q_S_w, q_S_x, q_S_y, q_S_z"),
        (lambda f: f, {"rotations": 3}, r"system\.rotations=3"),
        (lambda f: f, {"rotations": []}, r"are a quaternion .*give system\.rotations=\[R\]"),
        (lambda f: f.rename(columns={"v_R_x": "v_S_x"}), {}, "v_S_x belongs to no coordinate"),
    ],
)
def test_matrices_that_are_no_rotations_are_refused_in_one_line(
    change: Any, settings: dict[str, Any], text: str, tmp_path: Path
) -> None:
    with pytest.raises(ConfigError, match=text):
        read(change(table(tmp_path)), tmp_path, **settings)


def test_noise_turns_rotations_by_its_size() -> None:
    clean = motion().each()
    noisy = add_noise(clean, 1e-2, 0)
    turns = [x.q[:, 3:].view(-1, 3, 3) for x in (clean[0], noisy[0])]
    between = rotation_vector(turns[0].mT @ turns[1])
    assert 0.5e-2 < float(between.square().mean().sqrt()) < 2e-2
    torch.testing.assert_close(turns[1] @ turns[1].mT, torch.eye(3).double().expand_as(turns[1]))
