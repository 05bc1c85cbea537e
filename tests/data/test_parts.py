"""Recordings are split into parts, and columns assigned to coordinates and inputs."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch

from symo_exp.data.parts import divided, with_every_part
from symo_exp.data.recorded import RecordedData, recorded_system
from symo_exp.data.resample import Samples
from symo_exp.data.table import Recording
from symo_exp.errors import ConfigError

H = 0.1
SPLITS = {"a": "test", "b": "train", "c": "extra", "d": "val", "e": "train"}


def table(n: int = 2) -> pd.DataFrame:
    t = H * np.arange(8)
    parts = []
    for k, (label, split) in enumerate(SPLITS.items()):
        columns = {"trajectory": label, "split": split, "t": t, "note": "spare"}
        columns |= {f"q_arm{i}": np.sin(t + k + i) for i in range(n)}
        columns |= {f"u_motor{i}": np.cos(t + k) for i in range(n)}
        parts.append(pd.DataFrame(columns))
    return pd.concat(parts, ignore_index=True)


def recorded(given: pd.DataFrame, path: Path, columns=None, angular="all", matrix=None):
    """Write a table and return the system that its columns describe."""
    given.to_parquet(path, index=False)
    return recorded_system(path, time_step=H, angular=angular, columns=columns, input_matrix=matrix)


def read(given: pd.DataFrame, folder: Path, columns=None, angular="all", matrix=None, **more):
    path = folder / "mine.parquet"
    system = recorded(given, path, columns, angular, matrix)
    data = RecordedData(system=system, path=path, columns=columns, dtype="float64", **more)
    data.setup()
    return data


def alone(t: np.ndarray, q: np.ndarray, u: np.ndarray | None = None) -> Recording:
    """A recording of one coordinate and at most one input."""
    inputs = np.zeros((len(t), 0)) if u is None else u[:, None]
    samples = Samples(t, q[:, None], None, inputs)
    return Recording("", "", samples, samples)


def first(data: RecordedData, part: str) -> list[float]:
    return [t.q[0, 0].item() for t in data.trajectories(part)]


@pytest.mark.parametrize(
    ("settings", "wanted"),
    [
        ({}, ("be", "d", "a")),
        ({"n_traj": 1}, ("b", "d", "a")),
        ({"n_test": 2}, ("ab", "c", "de")),
        ({"test": ["c"]}, ("be", "d", "c")),
        ({"test": ["e"]}, ("b", "d", "e")),
        ({"train": ["a"], "val": "b", "test": ["c", "d"]}, ("a", "b", "cd")),
    ],
)
def test_trajectories_are_assigned_to_parts(settings: dict, wanted: tuple, tmp_path: Path) -> None:
    data = read(table(), tmp_path, **settings)
    for part, labels in zip(("train", "val", "test"), wanted, strict=True):
        expected = [np.sin("abcde".index(label)) for label in labels]
        assert first(data, part) == pytest.approx(expected), part


@pytest.mark.parametrize(
    ("splits", "wanted"),
    [
        ("train train train train train", ("abc", "d", "e")),
        ("test train test train train", ("bd", "e", "ac")),
        ("val train val extra val", ("b", "ae", "c")),
        ("train val train extra train", ("ac", "b", "e")),
    ],
)
def test_a_part_that_the_column_split_lacks_is_taken_from_others(
    splits: str, wanted: tuple, tmp_path: Path, caplog
) -> None:
    given = table()
    given["split"] = given["trajectory"].map(dict(zip("abcde", splits.split(), strict=True)))
    with caplog.at_level(logging.INFO):
        data = read(given, tmp_path)
    for part, labels in zip(("train", "val", "test"), wanted, strict=True):
        assert first(data, part) == pytest.approx([np.sin("abcde".index(x)) for x in labels])
    assert any("the column split has nothing for" in r.getMessage() for r in caplog.records)


@pytest.mark.parametrize(("seconds", "time_step"), [(0.5, H), (40.0, 5.0)])
def test_recordings_too_short_to_be_split_in_time_are_refused_with_the_distance_of_nodes(
    seconds: float, time_step: float
) -> None:
    t = np.arange(0.0, seconds, time_step / 2)
    with pytest.raises(ConfigError, match=rf"too short .* a node every {time_step:g} s"):
        divided("mine.csv", [alone(t, np.sin(t))], {}, None, None, time_step)


def test_a_recording_of_a_few_samples_is_not_split_in_time() -> None:
    t = np.array([0.0, 1.0, 100.0, 200.0])
    with pytest.raises(ConfigError, match="too short to be split in time"):
        divided("mine.csv", [alone(t, np.sin(t))], {}, None, None, 1.0)


@pytest.mark.parametrize("lacking", ["val", "test"])
def test_too_few_recordings_for_the_part_that_is_lacking_are_split_in_time(
    lacking: str, tmp_path: Path, caplog
) -> None:
    t = H * np.arange(400)
    there = "val" if lacking == "test" else "test"
    given = pd.concat(
        [
            pd.DataFrame({"trajectory": k, "split": part, "t": t, "q_arm0": np.sin(t + k)})
            for k, part in enumerate(("train", there))
        ]
    )
    with caplog.at_level(logging.INFO):
        data = read(given, tmp_path)
    assert len(data.trajectories(there)) == 1
    whole = len(data.trajectories(there)[0].q)
    held_out = sum(len(one.q) for one in data.trajectories(lacking))
    assert 0.15 * whole < held_out < 0.25 * whole
    assert 0.6 * whole < sum(len(one.q) for one in data.trajectories("train")) < whole - held_out
    assert any(f"nothing for {lacking}: split in time" in r.getMessage() for r in caplog.records)


@pytest.mark.parametrize("before", [0.0, 7.0])
@pytest.mark.parametrize("after", [0.0, 30.0])
def test_every_part_of_a_recording_that_is_split_in_time_moves(
    before: float, after: float, tmp_path: Path, caplog
) -> None:
    """Whatever rests there are before and after the motion."""
    t = H * np.arange(round((before + 12.0 + after) / H))
    q = np.sin(3.0 * (t - before).clip(0.0, 12.0))
    q += 1e-3 * np.random.default_rng(0).normal(size=len(t))
    with caplog.at_level(logging.INFO):
        data = read(pd.DataFrame({"t": t, "q_arm0": q}), tmp_path)
    found = [one for part in ("train", "val", "test") for one in data.trajectories(part)]
    assert all(float(np.ptp(one.q)) > 1.0 for one in found)
    assert H * sum(len(one.q) for one in found) == pytest.approx(12.0, abs=1.5)
    told = [r.getMessage() for r in caplog.records if "split in time" in r.getMessage()]
    assert ("at rest are left out" in told[0]) == (before + after > 0.0)


@pytest.mark.parametrize("pause", [0.0, 0.7, 25.0, 1e4])
def test_a_recording_with_a_pause_is_split_by_its_samples(pause: float) -> None:
    """However long the pause is, the parts have the samples that they have without it."""
    t = 0.01 * np.arange(4000)
    q = np.sin(2 * t) + 0.3 * np.sin(t)
    later = t + pause * (t > 17.005)
    blocks, note = with_every_part([alone(later, q)], 0.02)
    expected, _ = with_every_part([alone(t, q)], 0.02)
    assert note is not None
    assert "40 s" in note or "39.99 s" in note
    for block, other in zip(blocks, expected, strict=True):
        assert block.part == other.part
        assert len(block.samples.t) == pytest.approx(len(other.samples.t), abs=3)
        np.testing.assert_allclose(block.samples.q[5:-5, 0], np.interp(
            block.samples.t[5:-5], later, q), atol=1e-12)  # fmt: skip
        start = float(block.label.split(" to ")[0])
        assert block.samples.t[0] == pytest.approx(start, abs=0.02 + 1e-3 * start)


@pytest.mark.parametrize("pause", [0.05, 0.2, 0.5])
def test_parts_of_a_recording_with_pauses_do_not_depend_on_the_time_step(pause: float) -> None:
    """Candidates with different time steps are tested on the same samples."""
    t = 0.01 * np.arange(4000)
    later = t + pause * np.floor(t / 2.7)
    whole = alone(later, np.sin(2 * t))
    (expected, _), *others = (with_every_part([whole], h) for h in (0.01, 0.02, 0.05, 0.1))
    for blocks, _ in others:
        for block, other in zip(blocks, expected, strict=True):
            np.testing.assert_array_equal(block.samples.t, other.samples.t)


def test_copies_of_a_recording_are_left_out(tmp_path: Path, caplog) -> None:
    """Nothing is tested on the samples that it is trained on, even if their clock is another."""
    given = table()
    copy = given[given.trajectory == "a"].assign(trajectory="f", split="train")
    with caplog.at_level(logging.INFO):
        data = read(pd.concat([given, copy.assign(t=copy.t + 7.0)]), tmp_path)
    assert first(data, "train") == first(read(given, tmp_path), "train")
    assert "copies are left out: f of a" in caplog.text


def test_a_rest_in_which_an_input_acts_is_a_motion(tmp_path: Path) -> None:
    t = H * np.arange(1000)
    inputs = 0.0 * t, np.sign(t - 12.0).clip(0.0)
    parts = [alone(t, np.sin(t.clip(0.0, 6.3)), u) for u in inputs]
    ends = [max(one.samples.t[-1] for one in with_every_part([part], H)[0]) for part in parts]
    assert ends == pytest.approx([6.3, t[-1]], abs=0.2)


def test_a_recording_is_cut_at_gaps(tmp_path: Path, caplog) -> None:
    """Nothing is interpolated over a gap, and the pieces are what was recorded."""
    t = H * np.arange(200)
    parts = [
        pd.DataFrame({"t": t, "q_arm0": np.cos(t + k), "trajectory": k, "split": part})
        for k, part in enumerate(("val", "test"))
    ]
    jitter = 0.2 * H * np.random.default_rng(0).random(len(t))
    broken = pd.DataFrame({"t": t + jitter, "q_arm0": np.sin(t + jitter)})
    broken = broken.assign(trajectory=2, split="train")
    broken = broken[~broken.t.between(5.0, 7.0) & ~broken.t.between(7.2, 9.0)]
    with caplog.at_level(logging.INFO):
        data = read(pd.concat([*parts, broken]), tmp_path)
    found = data.trajectories("train")
    assert len(found) == 2  # the samples from 7.0 to 7.2 s are too few
    at = [broken.t.iloc[0], broken.t[broken.t > 9.0].iloc[0]]
    for one, begin in zip(found, at, strict=True):
        expected = np.sin(begin + H * np.arange(len(one.q)))
        assert one.q[:, 0].numpy() == pytest.approx(expected, abs=1e-3)
    said = [r.getMessage() for r in caplog.records if "gaps: 1 of 1" in r.getMessage()]
    assert len(said) == 1
    assert "too short are left out" in said[0]


def test_a_recording_without_a_name_is_told_as_such(tmp_path: Path) -> None:
    t = H * np.arange(200)
    alone = pd.DataFrame({"t": t, "q_arm0": np.sin(t)})
    with pytest.raises(ConfigError, match="has no trajectory z; it has one without a name"):
        read(alone, tmp_path, test=["z"])
    with pytest.raises(ConfigError, match=r"leave_out: \['z', 0, 1\]: .* of one without a name"):
        read(alone, tmp_path, leave_out=[["z", 0, 1]])
    with pytest.raises(ConfigError, match="leaves nothing of the recording"):
        read(alone, tmp_path, leave_out=[[0, 99]])


def test_names_without_a_split_leave_the_others_to_training(tmp_path: Path) -> None:
    data = read(table().drop(columns="split"), tmp_path, val=["b"], test=["c"])
    assert first(data, "train") == pytest.approx([np.sin(k) for k in (0, 3, 4)])


def test_names_of_any_kind_are_read_as_texts(tmp_path: Path) -> None:
    plain = table()
    lists = plain.assign(trajectory=[[x] for x in plain.trajectory])
    data = read(lists, tmp_path, val=["['b']"], test=["['c']"])
    assert [first(data, part) for part in ("val", "test")] == [[np.sin(1)], [np.sin(2)]]


@pytest.mark.parametrize(
    ("change", "settings", "message"),
    [
        ({}, {"test": ["z"]}, "has no trajectory z; it has a, b, c, d, e"),
        ({}, {"test": ["a"], "val": ["a"]}, "trajectory a is named twice"),
        ({}, {"test": []}, "data.test=[]: expected the names"),
        ({}, {"test": ["a"], "n_val": 1}, "leave out data.n_val"),
        ({"split": "val"}, {}, "no trajectory for train; its column split has val"),
        ({"split": ""}, {"test": ["a"]}, "no trajectory for val; name some by data.val=[...]"),
        ({"split": ["train", "test"] * 20}, {}, "trajectory a is in the splits train, test"),
        ({"q_": 0.0}, {}, "system.input_matrix=null: say how the inputs (motor0, motor1)"),
        ({"v_leg": 0.0}, {}, "column v_leg belongs to no coordinate of the system (arm0, arm1)"),
        ({}, {"angular": None}, "system.angular=null"),
        ({}, {"angular": ["leg"]}, "which of arm0, arm1 are angles?"),
        (
            {"u_motor2": 0.0},
            {},
            "keep one, by data.columns; a row for each coordinate, such as system.input_matrix=[[1",
        ),
        (
            {},
            {"columns": {"u_motor_V": "u_motor0", "u_motor_A": "u_motor1"}},
            "(motor_V, motor_A) drive the coordinates (arm0, arm1); of the voltage",
        ),
        (
            {},
            {"columns": {"u_arm0_V": "u_motor0", "u_arm0_A": "u_motor1"}},
            "(arm0_V, arm0_A) drive the coordinates (arm0, arm1); of the voltage",
        ),
        ({"u_motor2": 0.0}, {"matrix": [[1], [2]]}, "such as system.input_matrix="),
        (
            {},
            {"matrix": [[0, 0.0], [0, 0]]},
            "zeros drive nothing; give the entries, such as system.input_matrix=[[1,0],[0,1]]",
        ),
        ({}, {"columns": {"q_arm2": "gone"}}, "q_arm2=gone, but"),
        ({}, {"columns": {"leg": "note"}}, "leg=note is not allowed"),
        ({}, {"columns": {"v_a": "note", "v_b": "note"}}, "one column has two names"),
    ],
)
def test_contradictions_of_table_and_settings_are_refused(
    change, settings, message, tmp_path: Path
) -> None:
    with pytest.raises(ConfigError) as error:
        read(table().assign(**change), tmp_path, **settings)
    assert message in str(error.value)


@pytest.mark.parametrize("n", [1, 2, 3])
def test_coordinates_and_inputs_are_those_of_the_columns(n: int, tmp_path: Path) -> None:
    system = recorded(table(n), tmp_path / "x.parquet", angular=["arm0"])
    assert system.coordinates.names == tuple(f"arm{i}" for i in range(n))
    assert system.coordinates.angular == tuple(i == 0 for i in range(n))
    assert torch.equal(system.input_matrix, torch.eye(n, dtype=torch.float64))
    one = read(table(n), tmp_path, angular=["arm0"]).trajectories("train")[0].u
    torch.testing.assert_close(one[:, 0], torch.cos(H * torch.arange(8).double() + 1))
    free = table(n).drop(columns=[f"u_motor{i}" for i in range(n)])
    assert recorded(free, tmp_path / "x.parquet").input_matrix.shape == (n, 0)
    assert read(free, tmp_path).train.u.shape == (12, 0)


def test_fewer_inputs_than_coordinates_need_a_matrix(tmp_path: Path) -> None:
    given = table().drop(columns="u_motor0")
    system = recorded(given, tmp_path / "x.parquet", matrix=[[0], [1]])
    assert system.input_matrix.tolist() == [[0.0], [1.0]]


def test_columns_may_have_other_names(tmp_path: Path) -> None:
    theirs = {"t": "time", "trajectory": "run", "q_arm0": "shoulder"}
    other = table().rename(columns=theirs).assign(t="not the time")
    found, plain = read(other, tmp_path, columns=theirs), read(table(), tmp_path)
    for a, b in zip(found.train, plain.train, strict=True):
        assert torch.equal(a, b)


def test_only_angles_are_unwrapped(tmp_path: Path) -> None:
    turning = table().assign(q_arm0=lambda t: 9 * t["t"], q_arm1=lambda t: 9 * t["t"])
    jumping = turning.assign(q_arm0=lambda t: (t["q_arm0"] + np.pi) % (2 * np.pi) - np.pi)
    plain = read(turning, tmp_path, angular=["arm0"])
    with pytest.raises(ConfigError, match=r"data\.wrapped=true unwraps"):
        read(jumping, tmp_path, angular=["arm0"])
    found = read(jumping, tmp_path, angular=["arm0"], wrapped=True)
    torch.testing.assert_close(found.train.q, plain.train.q)


@pytest.mark.parametrize("degrees", [False, True])
def test_the_log_says_the_same_of_angles_that_jump_by_a_turn(degrees: bool, tmp_path: Path) -> None:
    """Of noise, steps of encoders and velocities."""
    t, turn = 0.01 * np.arange(2000), 360.0 if degrees else 2 * np.pi
    q = np.random.default_rng(0).normal(30 * t + np.sin(2 * t), 1e-3)
    scale = turn / (2 * np.pi)
    columns = {"t": t, "q_rotor": scale * q, "v_rotor": scale * np.gradient(q, t)}
    plain = pd.DataFrame(columns)
    jumping = plain.assign(q_rotor=(plain.q_rotor + turn / 2) % turn - turn / 2)
    expected = read(plain, tmp_path, degrees=degrees)
    found = read(jumping, tmp_path, degrees=degrees, wrapped=True)
    assert found.lines() == expected.lines()


@pytest.mark.parametrize("fold", [None, [0, 3], [1, 3]])
def test_a_rest_where_an_angle_jumps_by_a_turn_is_a_rest(fold, tmp_path: Path) -> None:
    t = H * np.arange(600)
    moving = (t > 15.0) & (t < 45.0)
    q = np.pi + np.where(moving, np.sin(2 * (t - 15.0)) * (45.0 - t) / 30.0, 0.0)
    plain = pd.DataFrame({"t": t, "q_arm": np.random.default_rng(0).normal(q, 1e-4)})
    if fold is not None:  # one recording moves and two are at rest
        t = H * np.arange(300)
        parts = [plain[:150], plain[150:450], plain[450:], plain[150:450], plain[150:450]]
        parts = [x.assign(trajectory=k, t=t[: len(x)]) for k, x in enumerate(parts)]
        plain = pd.concat(parts)
        plain["q_arm"] += 1e-3 * plain.trajectory
    jumping = plain.assign(q_arm=(plain.q_arm + np.pi) % (2 * np.pi) - np.pi)
    assert (np.abs(jumping.q_arm.diff()) > np.pi).sum() > 100
    expected = read(plain, tmp_path, fold=fold)
    found = read(jumping, tmp_path, fold=fold, wrapped=True)
    for part in ("train", "val", "test"):
        pairs = zip(found.trajectories(part), expected.trajectories(part), strict=True)
        for one, other in pairs:
            torch.testing.assert_close(one.q.cos(), other.q.cos())
            torch.testing.assert_close(one.v, other.v)


def test_the_log_reports_unused_data_and_resampling(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    faster = table()
    faster["t"] /= 2
    with caplog.at_level(logging.INFO):
        read(faster, tmp_path)
    lines = [record.getMessage() for record in caplog.records]
    for line, part in zip(lines, ("not used: 1 extra", "note", "4 of 4"), strict=False):
        assert part in line
    assert [line.split(":")[0] for line in lines[3:]] == ["inputs", "noise", "time step", "scale"]


@pytest.mark.parametrize("pace", [0.9992, 0.9999, 1.0, 1.0001, 1.0008])
def test_the_pace_of_a_clock_is_believed_over_the_whole_record(pace: float, tmp_path: Path) -> None:
    t = H * pace * np.arange(200)
    swings = [pd.DataFrame({"trajectory": k, "t": t, "q_arm": np.sin(3 * t + k)}) for k in range(3)]
    (one,) = read(pd.concat(swings), tmp_path).trajectories("test")
    nodes = H * np.arange(len(one.q))
    np.testing.assert_allclose(one.q[5:-5, 0], np.sin(3 * nodes + 2)[5:-5], atol=2e-4)


@pytest.mark.parametrize("rounding", [0.0, 5e-5])
def test_times_that_scatter_little_around_the_nodes_are_theirs(
    rounding: float, tmp_path: Path
) -> None:
    rng = np.random.default_rng(0)
    t = 7.0 + H * np.arange(200) + rng.uniform(-rounding, rounding, 200)
    swings = [pd.DataFrame({"trajectory": k, "t": t, "q_arm": np.sin(3 * t + k)}) for k in range(3)]
    (one,) = read(pd.concat(swings), tmp_path).trajectories("test")
    np.testing.assert_array_equal(one.q[:, 0], np.sin(3 * t + 2))


def test_a_time_step_that_is_too_short_is_refused_with_one_that_is_accepted(tmp_path: Path) -> None:
    t = 1.004 * H * np.arange(50)
    given = pd.concat(
        pd.DataFrame({"trajectory": k, "t": t, "q_arm": np.sin(t + k)}) for k in range(3)
    )
    with pytest.raises(ConfigError, match="may not be shorter") as error:
        read(given, tmp_path)
    step = float(str(error.value).partition("set system.time_step=")[2].split()[0])
    system = recorded_system(tmp_path / "mine.parquet", time_step=step, angular="all")
    RecordedData(system=system, path=tmp_path / "mine.parquet").setup()


@pytest.mark.parametrize("fold", [[0, 2], [1, 2], "pooled"])
def test_the_fits_of_a_search_do_not_diagnose_the_data_again(
    fold: object, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    alone = read(table(), tmp_path).lines()
    monkeypatch.delattr(RecordedData, "diagnosis")
    lines = read(table(), tmp_path, fold=fold).lines()
    assert 0 < len(lines) < len(alone)


def test_a_batch_is_an_eighth_of_the_samples(tmp_path: Path) -> None:
    assert len(read(table(), tmp_path).batches(0)) == 6  # of 12 samples, two each
    assert len(read(table(), tmp_path, batch_size=5).batches(0)) == 3
