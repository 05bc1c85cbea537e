"""Refusals of recordings: the settings that they name, as they are printed, read the motion."""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser

from symo_exp.data.advice import Columns, omitting
from symo_exp.data.header import headers
from symo_exp.data.naming import kind_of_column, names, short_names
from symo_exp.data.recorded import RecordedData, recorded_system
from symo_exp.data.table import read_recordings
from symo_exp.errors import ConfigError
from symo_exp.identify.recordings import examine
from symo_exp.systems.recorded import Recorded, without_unit

H = 0.02
T = H / 2 * np.arange(1500)
Q = np.sin(2 * T) + 0.3 * np.sin(T)
U = np.cos(3 * T)
WORDS = ["idle" if t < 3 else "it's on" for t in T]


def settings_of(message: str) -> dict[str, Any]:
    """Return the settings of a message, read as those of a command line."""
    quoted = message[message.index("'data.columns") :] if "'data.columns" in message else ""
    words = [word.rstrip(",;") for word in shlex.split(quoted)]
    parsed = OverridesParser.create().parse_overrides([x for x in words if x.startswith("data.")])
    return {one.key_or_group.removeprefix("data."): one.value() for one in parsed}


def written(folder: Path, columns: Mapping[str, Any]) -> Path:
    path = folder / "mine.csv"
    pd.DataFrame(columns).to_csv(path, index=False)
    return path


def refused(path: Path, said: str | None = None, columns: Columns | None = None) -> str:
    """Return the message with which the columns of a file are refused."""
    with pytest.raises(ConfigError, match=said) as error:
        headers(path, columns)
    return str(error.value)


def advised(path: Path) -> dict[str, Any]:
    message = refused(path)
    assert ("(without L_N)" in message) == ("L_N" in path.read_text())
    said, _, words = message.rpartition(": 'data.columns=")  # as it is to be copied
    assert said
    assert all(word.startswith("data.") for word in shlex.split(f"'data.columns={words}"))
    return settings_of(message)


TABLES: dict[str, tuple[dict[str, Any], dict[str, str]]] = {
    "joint states of ROS": (
        {"%time": (T * 1e9).astype(int), "field.header.seq": range(len(T)), "field.name0": WORDS,
         "field.position0": Q, "field.position1": 2 * U, "field.velocity0": U,
         "field.velocity1": U, "field.effort0": U, "field.effort1": Q},
        {"t": "time", "q": "field.position0 field.position1", "u": "field.effort0 field.effort1",
         "v": "field.velocity0 field.velocity1"},
    ),
    "topics of ROS": (
        {"__time": T, "/j/arm/position": Q, "/j/arm/velocity": U, "/j/arm/effort": U},
        {"t": "__time", "q": "/j/arm/position", "v": "/j/arm/velocity", "u": "/j/arm/effort"},
    ),
    "numbers of messages and states of drives": (
        {"Time[ms]": 10 * np.arange(len(T)), "motor_id": np.arange(len(T)) % 2,
         "Joint1_ActualPosition": Q, "Joint1_StatusWord": 39, "torque": U},
        {"t": "Time[ms]", "q": "Joint1_ActualPosition", "u": "torque"},
    ),
    "counts of messages of joints": (
        {"time": T, "/joint_states/header/seq": range(len(T)), "/joint_states/position[0]": Q,
         "/joint_states/effort[0]": U},
        {"t": "time", "q": "/joint_states/position[0]", "u": "/joint_states/effort[0]"},
    ),
    "arrays of ROS": (
        {"time": T, ".position[0]": Q, ".effort[0]": U},
        {"t": "time", "q": ".position[0]", "u": ".effort[0]"},
    ),
    "stamps of ROS beside times": (
        {"__time": T, "/j/header/stamp": 1.7e9 + T, "/j/header/stamp/sec": 1_700_000_000 + T // 1,
         "/j/header/stamp/nanosec": T % 1 * 1e9, "/j/position[0]": Q, "/j/effort[0]": U},
        {"t": "__time", "q": "/j/position[0]", "u": "/j/effort[0]"},
    ),
    "a bag of ROS 1 as a table": (
        {"rosbagTimestamp": T, "seq": range(len(T)), "secs": T // 1, "nsecs": T % 1 * 1e9,
         "position_0": Q, "effort_0": U},
        {"t": "rosbagTimestamp", "q": "position_0", "u": "effort_0"},
    ),
    "a stamp of ROS": (
        {".header.seq": range(len(T)), ".header.stamp": T, ".pose.position.x": Q, ".cmd.data": U},
        {"t": ".header.stamp", "q": ".pose.position.x", "u": ".cmd.data"},
    ),
    "columns without a name": (
        {"": WORDS, " ": WORDS, "time": T, "theta": Q}, {"t": "time", "q": "theta"},
    ),
    "units of another language": (
        {"Zeit [s]": T, "Größe [rad]": Q, "Moment [Nm]": U},
        {"t": "Zeit [s]", "q": "Größe [rad]", "u": "Moment [Nm]"},
    ),
    "units in brackets behind an underscore": (
        {"t": T, "Arm_[rad]": Q, "Iq_[mA]": U}, {"q": "Arm_[rad]", "u": "Iq_[mA]"},
    ),
    "products of units": (
        {"Temps (s)": T, "Angle (rad)": Q, "Couple (N.m)": U, "Couple 2 (N·m)": U, "C (N*m)": Q},
        {"t": "Temps (s)", "q": "Angle (rad)", "u": "Couple (N.m) Couple 2 (N·m) C (N*m)"},
    ),
    "units in words": (
        {"Zeit in s": T, "x in mm": Q, "F in N": U},
        {"t": "Zeit in s", "q": "x in mm", "u": "F in N"},
    ),
    "names without a letter of ASCII": (
        {"时间": T, "角度": Q, "角": Q * Q}, {"t": "时间", "q": "角度 角"},
    ),
    "quotes in names": (
        {"time": T, "arm's \"angle\"": Q, "torque": U},
        {"t": "time", "q": "arm's \"angle\"", "u": "torque"},
    ),
    "dates with another name": (
        {"date": [f"2024-05-01T10:00:{t:09.6f}+02:00" for t in T], "theta": Q},
        {"t": "date", "q": "theta"},
    ),
    "a counter of milliseconds": (
        {"row": range(len(T)), "millis": T * 1e3, "theta": Q, "pwm": U},
        {"t": "millis", "q": "theta", "u": "pwm"},
    ),
    "words and recordings": (
        {"run": np.arange(len(T)) // 300, "time": T, "mode": WORDS, "angle": Q, "torque": U,
         "comment": WORDS},
        {"t": "time", "q": "angle", "u": "torque"},
    ),
    "counts beside radians, and of a clock": (
        {"tick": T, "arm_counts": U, "arm [rad]": Q, "pwm_counts": U},
        {"t": "tick", "q": "arm [rad]", "u": "pwm_counts"},
    ),
    "a speed in another unit": ({"t": T, "th": Q, "motor_rpm": U}, {"q": "th"}),
    "what a controller wants": (
        {"time": T, "desired q": Q, "angle_ref": Q, "angle": Q, "torque_cmd": U, "torque_meas": U},
        {"t": "time", "q": "angle", "u": "torque_meas"},
    ),
    "the wanted input alone": (
        {"time": T, "target_pos": Q, "actual_pos": Q, "cmd": U},
        {"t": "time", "q": "actual_pos", "u": "cmd"},
    ),
    "a motor and its joint": (
        {"time": T, "motor_pos": 50 * Q, "joint_pos": Q + U, "motor_current": U, "motor_temp": Q,
         "battery [V]": U},
        {"t": "time", "q": "motor_pos joint_pos", "u": "motor_current"},
    ),
    "a distance, which is no derivative": (
        {"time": T, "distance": Q, "dtheta": U, "theta": U, "thetad": Q},
        {"t": "time", "q": "theta", "v": "thetad"},
    ),
    "an input that is named by its unit alone": (
        {"t": T, "x_mm": Q, "L_N": U, "serial": 7.0}, {"q": "x_mm"},
    ),
    "a force": ({"t": T, "x": Q, "F": U}, {"q": "x", "u": "F"}),
    "a force in a unit": ({"t": T, "x_m": Q, "f_N": U}, {"q": "x_m", "u": "f_N"}),
    "forces and filtered places": (
        {"t": T, "x_f": Q, "theta_f": Q * Q, "F1": U, "F_2": Q},
        {"q": "x_f theta_f", "u": "F1 F_2"},
    ),
    "one more letter": ({"t": T, "x": Q, "E": U}, {"q": "x"}),
    "names of MuJoCo": (
        {"time": T, "qpos_0": Q, "qvel_0": U, "ctrl_0": U, "vbus_voltage": Q},
        {"t": "time", "q": "qpos_0", "v": "qvel_0", "u": "ctrl_0"},
    ),
    "accelerations": (
        {"t": T, "q1": Q, "q1_dot": U, "q1_ddot": Q, "tau1": U},
        {"q": "q1", "v": "q1_dot", "u": "tau1"},
    ),
    "names without blanks": (
        {"timeStamp": T, "jointAngle": Q, "jointVelocity": U, "motorTorque": U},
        {"t": "timeStamp", "q": "jointAngle", "v": "jointVelocity", "u": "motorTorque"},
    ),
    "a rate that no name tells": (
        {"t": T, "w": np.gradient(Q, T), "one": Q, "other": Q * U},
        {"q": "one other"},
    ),
    "coordinates that rates name, beside one that a word names": (
        {"t": T, "x": Q, "tilt": U, "lamp": Q, "xdot": U, "tiltdot": Q, "u": U},
        {"q": "x tilt", "v": "xdot tiltdot", "u": "u"},
    ),
    "an abbreviated angle beside a position": ({"t": T, "x": Q, "th": U}, {"q": "x th"}),
    "German": (
        {"Zeit [s]": T, "Motorwinkel": Q, "Sollwinkel": U, "Winkelgeschwindigkeit": U,
         "Drehmoment": U, "Temperatur": T},
        {"t": "Zeit [s]", "q": "Motorwinkel", "u": "Drehmoment"},
    ),
    "German, of a slide": (
        {"Zeit": T, "Weg": Q, "Weg_Soll": Q, "Kraft_N": U, "Beschleunigung": U},
        {"t": "Zeit", "q": "Weg", "u": "Kraft_N"},
    ),
    "French": (
        {"temps": T, "angle": Q, "vitesse": U, "couple": U, "consigne": Q, "accélération": Q},
        {"t": "temps", "q": "angle", "u": "couple"},
    ),
    "Spanish": (
        {"Tiempo (s)": T, "Ángulo 1": Q, "Velocidad 1": U, "Ángulo 2": U, "Velocidad 2": U,
         "Corriente 1": U, "Corriente 2": Q},
        {"t": "Tiempo (s)", "q": "Ángulo 1 Ángulo 2", "v": "Velocidad 1 Velocidad 2",
         "u": "Corriente 1 Corriente 2"},
    ),
    "Portuguese": (
        {"tempo": T, "posição": Q, "força": U, "tensão": Q},
        {"t": "tempo", "q": "posição", "u": "força tensão"},
    ),
    "seven joints": (
        {"t": T, **{f"{x}{k}": np.roll(Q, 99 * k) for x in ("q", "dq", "tau") for k in range(7)}},
        {"q": " ".join(f"q{k}" for k in range(7)), "v": " ".join(f"dq{k}" for k in range(7)),
         "u": " ".join(f"tau{k}" for k in range(7))},
    ),
}  # fmt: skip
UNITS = {"a counter of milliseconds": "ms", "joint states of ROS": "ns"}


@pytest.mark.parametrize("kind", TABLES)
def test_the_suggested_columns_are_those_of_the_machine(kind: str, tmp_path: Path) -> None:
    columns, expected = TABLES[kind]
    path = written(tmp_path, columns)
    given = advised(path)
    theirs: dict[str, str] = {}
    for ours, name in given["columns"].items():
        theirs[ours[0]] = f"{theirs[ours[0]]} {name}" if ours[0] in theirs else name
    assert theirs == expected
    places = {ours[2:]: name for ours, name in given["columns"].items() if ours[0] == "q"}
    inputs = [ours[2:] for ours in given["columns"] if ours[0] == "u"]
    matrix = np.ones((len(places), len(inputs))).tolist()
    system = Recorded(
        names=list(places), inputs=inputs, angular="none", input_matrix=matrix, time_step=H
    )
    unit = UNITS.get(kind)
    samples = read_recordings(path, system, given["columns"], unit).recordings[0].samples
    for found, name in zip(samples.q.T, places.values(), strict=True):
        np.testing.assert_allclose(found, columns[name][: len(found)], atol=1e-9)
    np.testing.assert_allclose(samples.t - samples.t[0], T[: len(samples.t)], atol=1e-6)


@pytest.mark.parametrize("write", ["to_csv", "to_parquet"])
@pytest.mark.parametrize(
    ("index", "suggested"),
    [
        (pd.Timestamp("2024-05-01") + pd.to_timedelta(T, "s"), True),
        (pd.Index(T), True),
        (np.arange(len(T))[::-1], False),
        (np.arange(1, len(T) + 1) ** 2, False),
    ],
)
def test_an_index_without_a_name_is_suggested_as_times(
    index: pd.Index, suggested: bool, write: str, tmp_path: Path
) -> None:
    """Unless it numbers the rows, those that are left out not counted."""
    path = tmp_path / write.replace("to_", "mine.")
    getattr(pd.DataFrame({"q_arm": Q}, index=index), write)(path)
    columns = settings_of(refused(path, "no column t with times")).get("columns")
    assert (columns is not None) == suggested
    if suggested:
        system = recorded_system(path, time_step=H, angular="all", columns=columns)
        (found,) = read_recordings(path, system, columns).recordings
        np.testing.assert_allclose(found.samples.t, T, atol=1e-6)


@pytest.mark.parametrize("stamp", ["header.stamp.", "/joints/header/stamp/", "stamp_", ""])
@pytest.mark.parametrize("parts", [("sec", "nanosec"), ("secs", "nsecs")])
def test_the_parts_of_a_stamp_are_to_be_added(
    stamp: str, parts: tuple[str, str], tmp_path: Path
) -> None:
    whole, rest = (f"{stamp}{part}" for part in parts)
    stamps = {"seq": range(len(T)), whole: 1_700_000_000 + T // 1, rest: T % 1 * 1e9}
    said = f"add a column t with {whole} + 1e-9 * {rest} to the file"
    path = written(tmp_path, {**stamps, "position": Q})
    columns = settings_of(refused(path, re.escape(said)))["columns"]
    assert columns == {"q_position": "position"}
    written(tmp_path, {**stamps, "q_arm": Q})
    refused(path, re.escape(said))


@pytest.mark.parametrize(
    ("cells", "example"),
    [
        ([f"({x:.3f}, 0.5)" for x in Q], "'(0.000, 0.5)'"),
        ([[x, 0.5] for x in Q], "array([0. , 0.5])"),
        ([f"1.{500 + 99 * x:03.0f},25" for x in Q], "'1.500,25'"),
        ([f"1,{500 + 99 * x:03.0f}.25" for x in Q], "'1,500.25'"),
    ],
)
@pytest.mark.parametrize("name", ["position", "pose"])
def test_coordinates_that_are_not_written_as_numbers_are_named(
    name: str, cells: list, example: str, tmp_path: Path
) -> None:
    """Nothing else is guessed as a coordinate instead."""
    path = tmp_path / "mine.parquet"
    date = "2024-05-01"
    pd.DataFrame({"time": T, name: cells, "other": U, "date": date}).to_parquet(path)
    message = refused(path, f"{name}: not read as numbers")
    assert example in message
    assert "data.columns" not in message


def test_a_column_with_empty_cells_has_numbers(tmp_path: Path) -> None:
    """As that of an input with a clock of its own, whose rows are between those of positions."""
    torque = np.where(np.arange(len(T)) % 3, np.nan, U)
    columns = advised(written(tmp_path, {"t": T, "arm": Q, "torque": torque}))["columns"]
    assert columns == {"q_arm": "arm", "u_torque": "torque"}


@pytest.mark.parametrize("unit", ["mm", "cm", "m"])
def test_suggested_names_keep_units_of_length_that_results_have(unit: str, tmp_path: Path) -> None:
    path = tmp_path / "mine.csv"
    pd.DataFrame(
        {"time": T, f"slide pos [{unit}]": Q, f"slide vel [{unit}/s]": U, "slide force [N]": U}
    ).to_csv(path)
    columns = advised(path)["columns"]
    kept = "" if unit == "m" else f"_{unit}"
    assert list(columns) == ["t", f"q_slide{kept}", f"v_slide{kept}", "u_slide"]
    notes = examine({"path": str(path), "columns": columns}).notes
    assert any(f"positions [{unit}]: slide" in note for note in notes)


def test_a_quaternion_whose_rotation_has_no_name_is_no_four_coordinates(tmp_path: Path) -> None:
    path = tmp_path / "mine.csv"
    pd.DataFrame({"t": T, "q_w": np.cos(Q), "q_x": np.sin(Q), "q_y": 0.0, "q_z": 0.0}).to_csv(path)
    columns = settings_of(refused(path, "are a quaternion by their names"))["columns"]
    assert columns == {f"q_R_{part}": f"q_{part}" for part in "wxyz"}
    assert examine({"path": str(path), "columns": columns}).body


def test_forces_along_axes_are_no_place_beside_a_quaternion(tmp_path: Path) -> None:
    path = tmp_path / "mine.csv"
    pose = {f"pose.{part}": Q for part in "wxyz"} | {f"torque.{axis}": U for axis in "xyz"}
    pd.DataFrame({"t": T} | pose).to_csv(path)
    columns = advised(path)["columns"]
    assert [name for name in columns if name[0] == "q"] == [f"q_R_{part}" for part in "wxyz"]
    assert list(columns.values())[-3:] == ["torque.x", "torque.y", "torque.z"]


def test_names_that_are_made_up_say_no_kind() -> None:
    for stems in (["角度"], ["角度", "位置", "°"]):
        assert [kind_of_column(name) for name in short_names(stems)] == [""] * len(stems)


def test_a_unit_in_brackets_behind_an_underscore_belongs_to_no_name() -> None:
    for name in ("motor_[A]", "motor [A]", "motor_A", "motor_(rad)"):
        assert without_unit(name) == "motor"
    assert short_names(["motor_[A]"]) == ["motor_A"]


def test_a_missing_clock_is_suggested_beside_what_is_given(tmp_path: Path) -> None:
    path = written(tmp_path, {"stamp of row": T, "theta": Q, "u_arm": U})
    given = settings_of(refused(path, "no column t with times", {"q_arm": "theta"}))["columns"]
    assert given == {"q_arm": "theta", "t": "stamp of row"}
    assert headers(path, given)[0][1].names == ("t", "q_arm", "u_arm")


def test_what_a_controller_wants_is_no_coordinate(tmp_path: Path) -> None:
    path = written(tmp_path, {"t": T, "q_arm": Q, "q_arm_des": Q, "u_cmd": U})
    columns = settings_of(refused(path, "what a controller wants"))["columns"]
    assert recorded_system(path, time_step=H, angular="all", columns=columns).names == ("arm",)
    named = {"q_arm_des": "q_arm_des"}  # the user says that it is one
    assert "q_arm_des" in headers(path, named)[0][1].names


@pytest.mark.parametrize(
    ("columns", "mend"),
    [
        ("q_theta q_theta_dot", {"v_theta": "q_theta_dot"}),
        ("q_theta q_thetadot", {"v_theta": "q_thetadot"}),
        ("q_theta q_omega", {"v_theta": "q_omega"}),
        ("q_theta q_omega v_theta", {"q_omega": None}),
        ("q_theta q_acc", {"q_acc": None}),
        ("q_theta q_current", {"q_current": None}),
        ("q_1 q_2 q_dot_1 q_dot_2", {"v_1": "q_dot_1", "v_2": "q_dot_2"}),
        ("q_hip q_knee q_hip_vel", {"q_hip_vel": None}),
        ("q_x q_theta_1 q_wrist q_motor q_z q_d q_throttle", None),
        ("q_rate", None),
        ("q_R_w q_R_x q_R_y q_R_z q_x q_y", None),
    ],
)
def test_a_velocity_or_an_input_is_no_coordinate(
    columns: str, mend: dict[str, str | None] | None, tmp_path: Path
) -> None:
    path = written(tmp_path, {"t": T} | dict.fromkeys(columns.split(), Q))
    if mend is None:
        assert headers(path, None)[0][1].names == ("t", *columns.split())
        return
    assert settings_of(refused(path, "no coordinate by its name"))["columns"] == mend
    places = [x for x in columns.split() if x[0] == "q" and x not in {*mend, *mend.values()}]
    assert names("q", headers(path, mend)[0][1].names) == tuple(x[2:] for x in places)
    assert len(headers(path, dict(zip(columns.split(), columns.split(), strict=True)))) == 1


def test_coordinates_of_other_names_are_not_passed_over(tmp_path: Path) -> None:
    """As of an arm whose wanted angles are in q_d."""
    path = written(tmp_path, {"t": T, "q[0]": Q, "q[1]": U, "q_d[0]": Q, "q_d[1]": U})
    columns = settings_of(refused(path, "would be coordinates by their names"))["columns"]
    assert recorded_system(path, time_step=H, angular="all", columns=columns).names == ("0", "1")
    assert columns["q_0"] == "q[0]"
    written(tmp_path, {"t": T, "q0": Q, "q_0": U})
    assert advised(path)["columns"] == {"q_0": "q0"}
    assert headers(path, {"q_arm": "q_0"})[0][1].names == ("t", "q0", "q_arm")


def test_degrees_are_not_suggested_for_radians(tmp_path: Path) -> None:
    path = written(tmp_path, {"t": T, "hip [deg]": Q, "knee [rad]": Q})
    given = advised(path)
    assert given == {"columns": {"q_hip_deg": "hip [deg]", "q_knee": "knee [rad]"}}
    with pytest.raises(ConfigError, match="hip_deg is in degrees by its name, but not every one"):
        examine({"path": path, **given})
    written(tmp_path, {"t": T, "hip [deg]": Q, "x [m]": Q})
    assert advised(path)["degrees"] is True


@pytest.mark.parametrize(
    "name", ["hip [degrees]", "hip_degree", "hip in degs", "hip_deg", "hip [Grad]", "hip (degrés)"]
)
def test_degrees_are_known_by_every_spelling(name: str, tmp_path: Path) -> None:
    path = written(tmp_path, {"t": T, name: Q})
    assert advised(path) == {"columns": {"q_hip": name}, "degrees": True}
    written(tmp_path, {"t": T, f"q_{name}": np.degrees(Q)})
    assert "data.degrees=true" in examine({"path": path}).settings


@pytest.mark.parametrize(
    ("name", "unit", "remedy"),
    [
        ("q_arm_mrad", "mrad", "rad = mrad / 1000"),
        ("q_turns", "turns", "rad = 2 pi times turns"),
        ("angle [rev]", "rev", "rad = 2 pi times turns"),
        ("angle (turns)", "turns", "rad = 2 pi times turns"),
        ("q_counts", "counts", "m = counts times the length of one"),
        ("q_x_counts", "counts", "rad = 2 pi times counts over the counts of a turn"),
        ("motor_ticks", "ticks", "rad = 2 pi times counts over the counts of a turn"),
        ("encoderCounts", "counts", "rad = 2 pi times counts over the counts of a turn"),
    ],
)
def test_other_units_than_radians_and_degrees_are_to_be_converted(
    name: str, unit: str, remedy: str, tmp_path: Path
) -> None:
    path = written(tmp_path, {"t": T, name: Q, "load": U})
    for columns in (None, {"q_arm": name}):
        message = refused(path, f"numbers in {unit}, .* are not read", columns)
        assert remedy in message
        assert name in message
        assert not settings_of(message)  # which no setting mends
    written(tmp_path, {"t": T, "q_arm": Q, f"v_{name}": U})
    given = settings_of(refused(path, f"numbers in {unit}"))
    assert headers(path, given["columns"])[0][1].names[1] == "q_arm"


@pytest.mark.parametrize(
    "name", ["return", "turns_table", "tick_1", "count_x", "discount", "revs2"]
)
def test_names_that_only_begin_like_a_unit_are_read(name: str, tmp_path: Path) -> None:
    path = written(tmp_path, {"t": T, f"q_{name}": Q, "u_counts": U})
    assert headers(path, None)[0][1].names == ("t", f"q_{name}", "u_counts")


def test_a_file_that_is_no_recording_is_named(tmp_path: Path) -> None:
    pd.DataFrame({"t": T, "q_arm": Q}).to_csv(tmp_path / "1.csv", index=False)
    pd.DataFrame({"mass": [1.0, 2.0], "row": [1, 2]}).to_csv(tmp_path / "2.csv", index=False)
    refused(tmp_path, r"2.csv: no column q_.*name the other files only")


@pytest.mark.parametrize("name", ["omega_rad_s", "v_arm", "motor_speed"])
def test_velocities_alone_are_to_be_integrated(name: str, tmp_path: Path) -> None:
    path = written(tmp_path, {"t": T, name: Q, "torque": U})
    refused(path, rf"add it .*the integral of a velocity \({name}\)")


def test_names_of_inputs_are_not_passed_over(tmp_path: Path) -> None:
    """A machine with the columns t, q_arm and torque is not free."""
    path = written(tmp_path, {"t": T, "q_f": Q, "F": U})
    refused(path, r"no column u_<name> with an input, but F;")
    written(tmp_path, {"t": T, "q_arm": Q, "torque (Nm)": U, "note": U})
    message = refused(path, "no column u_<name> with an input")
    mapped, left_out = message.split("or leave them out")
    assert settings_of(mapped)["columns"] == {"u_torque_Nm": "torque (Nm)"}
    for given in (settings_of(mapped), settings_of(left_out)):
        system = recorded_system(path, time_step=H, angular="all", **given)
        table = read_recordings(path, system, given["columns"])
        assert len(system.inputs) == (None not in given["columns"].values())
        assert any("not read: " in line and "note" in line for line in table.notes)


@pytest.mark.parametrize(
    ("more", "left_out"),
    [
        ("u_temp u_battery", "u_temp u_battery"),
        ("u_motor_ref", "u_motor_ref"),
        ("q_arm_ref q_temp u_bat", "q_arm_ref q_temp u_bat"),
        ("q_arm_ref q_arm_counts u_motor_target u_bus_voltage",
         "q_arm_ref q_arm_counts u_motor_target u_bus_voltage"),
    ],
)  # fmt: skip
def test_one_setting_resolves_all_that_names_contradict(
    more: str, left_out: str, tmp_path: Path
) -> None:
    own = {"t": T, "q_arm": Q, "u_motor": U}
    path = written(tmp_path, own | dict.fromkeys(more.split(), U))
    message = refused(path)
    columns = settings_of(message)["columns"]
    assert columns == dict.fromkeys(left_out.split())
    assert all(name in message.partition(" setting: ")[0] for name in more.split())
    (head,) = (head for _, head in headers(path, columns))
    assert [name for name in head.names if name[0] != "."] == list(own)


def test_a_velocity_with_the_name_of_a_motor_is_no_input(tmp_path: Path) -> None:
    path = written(tmp_path, {"t": T, "q_motor": Q, "v_motor": U})
    assert headers(path, None)[0][1].names == ("t", "q_motor", "v_motor")


@pytest.mark.parametrize("inputs", ["cmd", "cmd_left right", "temp", "supply", "ref_1 ref_2"])
def test_inputs_that_no_other_one_measures_are_inputs(inputs: str, tmp_path: Path) -> None:
    columns = [f"u_{name}" for name in inputs.split()]
    path = written(tmp_path, {"t": T, "q_arm": Q} | dict.fromkeys(columns, U))
    assert names("u", headers(path, None)[0][1].names) == tuple(inputs.split())


def test_an_empty_column_is_left_out_by_the_setting_that_is_named(tmp_path: Path) -> None:
    path = written(tmp_path, {"time": T, "pos": Q, "q_lock": np.nan})
    columns: dict[str, str | None] = {"t": "time", "q_arm": "pos"}
    with pytest.raises(ConfigError, match="column q_lock") as error:
        read_recordings(
            path, recorded_system(path, time_step=H, angular="all", columns=columns), columns
        )
    columns = settings_of(str(error.value))["columns"]
    assert columns == {"t": "time", "q_arm": "pos", "q_lock": None}
    system = recorded_system(path, time_step=H, angular="all", columns=columns)
    assert len(read_recordings(path, system, columns).recordings) == 1


@pytest.mark.parametrize("name", ["a b", "a [rad]", "a(1)", "a/b", "a:{1},=2", "a\\b", "7 %"])
def test_any_name_can_be_left_out(name: str) -> None:
    setting = omitting([f"q_{name}", name])
    assert settings_of(setting)["columns"] == {f"q_{name}": None, name: None}


def test_names_that_no_setting_can_have_are_to_be_renamed() -> None:
    assert omitting(["q_Größe"]).endswith("with an ASCII name in the file instead of q_Größe")
    assert omitting(["q_Größe"], {"q_Größe": "x", "t": "s"}) == "'data.columns={t: s}'"


@pytest.mark.parametrize(
    ("q", "refused"),
    [
        (np.round(Q / (2 * np.pi) * 4096), True),
        (np.round(2 * Q), False),  # few places, such as those of a switch
        (Q, False),
    ],
)
def test_counts_of_an_encoder_are_no_radians(q: np.ndarray, refused: bool, tmp_path: Path) -> None:
    path = written(tmp_path, {"t": T, "q_arm": q})
    for angular in ("all", "none"):
        system = recorded_system(path, time_step=H, angular=angular)
        if refused and angular == "all":
            with pytest.raises(ConfigError, match="convert counts of an encoder"):
                RecordedData(system=system, path=path)
            RecordedData(system=system, path=path, degrees=True, wrapped=True)
        else:
            RecordedData(system=system, path=path)


def test_a_motor_that_turns_by_more_than_half_a_turn_in_a_sample_is_not_wrapped(
    tmp_path: Path,
) -> None:
    path = written(tmp_path, {"t": T, "q_motor": 300 * Q})
    system = recorded_system(path, time_step=H / 2, angular="all")
    data = RecordedData(system=system, path=path, dtype="float64")
    data.setup()
    assert np.abs(np.diff(data.trajectories("train")[0].q[:, 0])).max() > np.pi


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("Operator:,Smith\n\nt,q_arm,\n0,1,2\n1,2,3\n", r"3 cells.* 2, Operator:, Smith"),
        ("Test 12 bench 4\nt,q_arm\n0,left\n1,right\n", r"no column has numbers.*Test, 12, bench"),
        ("t;q_arm\n0,0;1.024,5\n0,1;1.025,5\n", r"'1.024,5' .* write numbers as 1234.5"),
    ],
)
def test_what_is_before_the_names_is_told(text: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "mine.csv"
    path.write_text(text)
    system = Recorded(names=["arm"], angular="all", time_step=H)
    with pytest.raises(ConfigError, match=said):
        read_recordings(path, system)


@pytest.mark.parametrize(
    "heading",
    [
        "Test 12 bench 4\n",
        "Operator:;Smith\n\n",
        "// by hand\n",
        "Prüfstand 7;;\nDatum;30.11.2026;\n;;\n",
        "LabVIEW Measurement\t\nWriter_Version\t2\n***End_of_Header***\t\n",
        "",
    ],
)
@pytest.mark.parametrize("units", ["", "s;rad;Nm\n"])
def test_lines_of_data_loggers_before_the_names_are_left_out(
    heading: str, units: str, tmp_path: Path
) -> None:
    path = tmp_path / "mine.csv"
    rows = "".join(
        f"{t:.2f};{q:.4f};{u}\n".replace(".", ",") for t, q, u in zip(T, Q, T, strict=True)
    )
    path.write_text(f"{heading}t;q_arm;u_arm\n{units}{rows}", encoding="utf-8")
    system = Recorded(names=["arm"], inputs=["arm"], angular="all", time_step=H)
    found = read_recordings(path, system)
    assert found.recordings[0].samples.q[:, 0] == pytest.approx(Q, abs=1e-4)
    assert any("before the names" in note for note in found.notes) == bool(heading)


def test_text_of_two_bytes_without_a_mark_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "mine.csv"
    path.write_text("t,q_arm\n0,1\n1,2\n", encoding="utf-16-le")
    refused(path, "save it as UTF-8")
