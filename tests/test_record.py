"""Recordings of environments: a table of inputs and motions that can be trained on."""

import shlex

import gymnasium
import numpy as np
import pandas as pd
import pytest
import torch

from symo_exp.__main__ import main
from symo_exp.systems.simulation import Solver, simulate
from symo_exp.systems.table import system
from tests.jobs import jobs_of


def recorded(*words, out="recording.csv"):
    assert main(["record", *words, "--out", out, "--episodes", "3", "--steps", "6"]) == 0
    return pd.read_csv(out) if out.endswith(".csv") else pd.read_parquet(out)


def test_a_recording_of_ours_is_the_simulated_motion(workplace, capsys):
    (workplace / "push.py").write_text(
        "import numpy as np\ndef policy(observation):\n    return np.sin(7 * observation[:1])\n"
    )
    table = recorded("symo_exp/Cartpole-v0", "--policy", "push.py")
    cartpole = system("cartpole")
    assert list(table) == ["trajectory", "t", "q_x", "q_theta", "v_x", "v_theta", "u_0"]
    for _, rows in table.groupby("trajectory"):
        np.testing.assert_allclose(rows.t, 0.05 * np.arange(7))
        q, v, u = (
            torch.tensor(rows[list(names)].to_numpy()).unsqueeze(0)
            for names in (("q_x", "q_theta"), ("v_x", "v_theta"), ("u_0",))
        )
        np.testing.assert_allclose(u[0, :-1, 0], np.sin(7 * q[0, :-1, 0].numpy()))
        path = simulate(cartpole, q[:, 0], v[:, 0], u, 6, Solver())
        torch.testing.assert_close(path.q, q, rtol=1e-6, atol=1e-6)
        torch.testing.assert_close(path.v, v, rtol=1e-6, atol=1e-6)
    assert table.trajectory.nunique() == 3
    _, warning, command = capsys.readouterr().out.strip().splitlines()
    assert warning.startswith("warning: the median episode has 7 nodes (0.3 s)")
    (job,) = jobs_of(*shlex.split(command)[3:])
    assert job.values["system"]["angular"] == ["theta"]


def test_a_mujoco_environment_is_recorded_with_its_inputs(workplace):
    pytest.importorskip("imageio")  # Gymnasium's own need
    name = "InvertedDoublePendulum-v5"
    table = recorded(name, out="recording.parquet")
    again = recorded(name, "--seed", "0", out="again.parquet")
    pd.testing.assert_frame_equal(table, again)
    env = gymnasium.make(name)
    env.reset(seed=0)
    env.action_space.seed(0)
    first = table[table.trajectory == 0]
    for k in range(len(first) - 1):
        action = env.action_space.sample()
        env.step(action)
        assert first.u_slide.iloc[k] == pytest.approx(float(action[0]))
        assert first.q_slider.iloc[k + 1] == env.unwrapped.data.qpos[0]
        assert first.v_hinge2.iloc[k + 1] == env.unwrapped.data.qvel[2]
    words = ["system=gymnasium", f"system.id={name}", "data=recorded", "system.time_step=0.05"]
    (job,) = jobs_of(*words, "data.path=recording.parquet")
    assert job.values["system"]["mechanism"]["inputs"]["names"] == ["slide"]


def test_the_command_that_learns_from_a_recording_names_its_file(workplace, capsys):
    (workplace / "my (new), motions").mkdir()
    recorded("symo_exp/Pendulum-v0", out="my (new), motions/1=2.csv")
    command = capsys.readouterr().out.strip().splitlines()[-1]
    (job,) = jobs_of(*shlex.split(command)[3:])
    assert job.values["data"]["path"] == "my (new), motions/1=2.csv"


def test_a_recording_that_cannot_be_written_leaves_the_file_before(workplace, monkeypatch, capsys):
    recorded("symo_exp/Pendulum-v0", out="mine.csv")
    before = (workplace / "mine.csv").read_text()

    def tear(table, path, **_):
        path.write_text("trajectory,t\n0,")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(pd.DataFrame, "to_csv", tear)
    words = ["symo_exp/Pendulum-v0", "--out", "mine.csv", "--episodes", "1", "--steps", "3"]
    assert main(["record", *words]) == 2
    assert "No space left" in capsys.readouterr().err
    assert (workplace / "mine.csv").read_text() == before
    assert [*workplace.glob(".mine.csv*")] == []


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["Nothing-v0"], "cannot make it"),
        (["CartPole-v1"], "its coordinates are unknown"),
        (["symo_exp/Quadrotor-v0"], "does not write rotations (R)"),
        (["Ant-v5"], "does not write rotations (root_R)"),
        (["symo_exp/Pendulum-v0", "--policy", "none.py"], "none.py: there is no such file"),
        (["symo_exp/Pendulum-v0", "--policy", "mine.txt"], "expected random or a .py file"),
        (["symo_exp/Pendulum-v0", "--policy", "empty.py"], "has no function policy"),
        (
            ["symo_exp/Pendulum-v0", "--policy", "broken.py"],
            "fails: ZeroDivisionError: division by zero (broken.py, line 1)",
        ),
        (["symo_exp/Pendulum-v0", "--policy", "wide.py"], "expected 1 finite"),
        (["symo_exp/Pendulum-v0", "--policy", "late.py"], "by zero (late.py, line 2)"),
        (["symo_exp/Pendulum-v0", "--policy", "words.py"], "the policy fails: ValueError"),
        (["symo_exp/Pendulum-v0", "--steps", "1"], "--steps=1: expected a whole number of at le"),
        (["symo_exp/Pendulum-v0", "--episodes", "0"], "--episodes=0: expected a whole number of"),
        (["symo_exp/Pendulum-v0", "--seed", "-1"], "--seed=-1: expected a whole number of at le"),
        (["symo_exp/Pendulum-v0", "--out", "mine.txt"], "ends in .parquet or .csv"),
        (["symo_exp/Pendulum-v0", "--out", "no/where.csv"], "cannot be written"),
    ],
)
def test_recordings_that_cannot_be_made_are_refused_in_one_line(words, reason, workplace, capsys):
    (workplace / "empty.py").write_text("")
    (workplace / "broken.py").write_text("1 / 0\n")
    (workplace / "late.py").write_text("def policy(observation):\n    return 1 / 0\n")
    (workplace / "words.py").write_text("def policy(observation):\n    return 'left'\n")
    (workplace / "wide.py").write_text("def policy(observation):\n    return [0, 0]\n")
    assert main(["record", "--steps", "3", "--episodes", "1", *words]) == 2
    said = capsys.readouterr().err
    assert reason in said
    assert said.count("\n") == 1
