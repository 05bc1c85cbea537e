"""Files of recordings: every format and convention gives the same motion."""

from __future__ import annotations

import io
import logging
from collections.abc import Callable
from datetime import datetime, timedelta
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import scipy.io
import torch

from symo_exp.data.advice import Columns, as_setting
from symo_exp.data.arrays import from_arrays
from symo_exp.data.bags import joint_states
from symo_exp.data.elements import check_elements
from symo_exp.data.formats import readable, table_of
from symo_exp.data.parts import without
from symo_exp.data.paths import files
from symo_exp.data.recorded import RecordedData, recorded_system
from symo_exp.data.table import RecordingTable, read_recordings
from symo_exp.errors import ConfigError
from symo_exp.systems.recorded import Recorded
from symo_exp.systems.table import system as stated

H = 0.02
SECONDS = 30.0
DRIVEN = Recorded(time_step=H, names=("0",), inputs=("0",), angular="all")
FREE = Recorded(time_step=H, names=("0",), inputs=(), angular="all")


def motion(seconds: float = SECONDS) -> pd.DataFrame:
    t = H / 2 * np.arange(round(2 * seconds / H))
    return pd.DataFrame({"t": t, "q_0": np.sin(2 * t) + 0.3 * np.sin(t), "u_0": np.cos(3 * t)})


def load(path: object, *, columns: object = None, **settings: object) -> RecordedData:
    system = recorded_system(path, time_step=H, angular="all", columns=columns)
    data = RecordedData(system=system, path=path, columns=columns, dtype="float64", **settings)
    data.setup()
    return data


def read(
    table: pd.DataFrame, folder: Path, system: Recorded = DRIVEN, columns: Columns | None = None
) -> RecordingTable:
    """Write a table and read it."""
    table.to_csv(folder / "x.csv", index=False)
    return read_recordings(folder / "x.csv", system, columns)


def csv(name: str, change: Callable[[pd.DataFrame], pd.DataFrame] = lambda t: t, **options):
    def write(folder: Path) -> object:
        change(motion()).to_csv(folder / name, index=False, **options)
        return folder / name

    return write


def parquet(change: Callable[[pd.DataFrame], pd.DataFrame]):
    def write(folder: Path) -> object:
        change(motion()).to_parquet(folder / "x.parquet", index=False)
        return folder / "x.parquet"

    return write


def text(change: Callable[[list[str]], list[str]], **options):
    """A file of the motion with other lines."""

    def write(folder: Path) -> object:
        lines = motion().to_csv(index=False, **options).splitlines()
        (folder / "x.csv").write_text("\n".join(change(lines)) + "\n")
        return folder / "x.csv"

    return write


def arrays(folder: Path, name: str, **changes: np.ndarray) -> Path:
    t = motion()
    found = {"t": t.t.to_numpy(), "q": t[["q_0"]].to_numpy(), "u": t.u_0.to_numpy(), "rate": 100.0}
    found |= changes
    if name.endswith(".npz"):
        np.savez(folder / name, **found)
    else:
        scipy.io.savemat(folder / name, found)
    return folder / name


def several(folder: Path, suffix: str = "csv") -> Path:
    """Three pieces of the motion, a file each."""
    (folder / "logs").mkdir()
    for k, piece in enumerate(np.array_split(np.arange(len(motion())), 3)):
        getattr(motion().iloc[piece], f"to_{suffix}")(folder / f"logs/{k}.{suffix}", index=False)
    return folder / "logs"


def saved(save: Callable[..., None], *given: np.ndarray, **arrays: np.ndarray) -> bytes:
    """The content of a file of NumPy."""
    file = io.BytesIO()
    save(file, *given, **arrays)
    return file.getvalue()


def encrypted(archive: bytes) -> bytes:
    """The archive with a flag in its directory that says that its first file is encrypted."""
    content = bytearray(archive)
    content[content.index(b"PK\x01\x02") + 8] ^= 1
    return bytes(content)


Writer = Callable[[Path], object]
WRITERS: dict[str, Writer] = {
    "semicolons": csv("x.csv", sep=";"),
    "decimal commas": csv("x.csv", sep=";", decimal=","),
    "tabs": csv("x.csv", sep="\t"),
    "vertical bars": csv("x.csv", sep="|"),
    "blanks": csv("x.csv", sep=" "),
    "a text file": csv("x.txt", sep="\t"),
    "comments": text(lambda lines: ["# a log, by hand", "% 2024", *lines]),
    "names in a comment": text(lambda lines: ["# a log", "# " + lines[0], *lines[1:]]),
    "names in a comment, blanks": text(lambda lines: ["# " + lines[0], *lines[1:]], sep=" "),
    "a row of units": text(lambda lines: [lines[0], "s,rad,Nm", *lines[1:]]),
    "a row of units above decimal commas": text(
        lambda lines: [lines[0], "s;rad;Nm", *lines[1:]], sep=";", decimal=","
    ),
    "nanoseconds of a clock": csv(
        "x.csv",
        lambda t: t.assign(t=(1e9 * t.t).round().astype("int64") + 1_700_000_000_000_000_000),
    ),
    "milliseconds of a clock": csv("x.csv", lambda t: t.assign(t=(1e3 * t.t).round() + 1.7e12)),
    "milliseconds of a clock in any order": csv(
        "x.csv",
        lambda t: t.assign(t=(1e3 * t.t).round() + 1.7e12).sample(frac=1, random_state=0),
    ),
    "nanoseconds of a clock under a row of units": text(
        lambda lines: [
            lines[0],
            "ns,rad,Nm",
            *(
                f"{170_000_000_000 + k}0000000,{x.partition(',')[2]}"
                for k, x in enumerate(lines[1:])
            ),
        ]
    ),
    "the stated separator of a spreadsheet": text(
        lambda lines: ["sep=;", *lines], sep=";", decimal=","
    ),
    "a blank line": text(lambda lines: ["", *lines]),
    "blanks after commas": text(lambda lines: [x.replace(",", ", ") for x in lines]),
    "decimal commas in quotes": text(
        lambda lines: [",".join(f'"{x}"' for x in line.split(";")) for line in lines],
        sep=";",
        decimal=",",
    ),
    "commas at the ends": text(lambda lines: [lines[0], *(f"{x}," for x in lines[1:])]),
    "empty columns and rows": text(lambda lines: [*(f"{x},," for x in lines), *[",,,,"] * 999]),
    "a short first row": text(lambda lines: [lines[0], "-1.0", *lines[1:]]),
    "Windows": csv("x.csv", lambda t: t.assign(**{"°C": 20}), encoding="cp1252"),
    "Unicode of a spreadsheet": csv("x.txt", sep="\t", encoding="utf-16"),
    "upper case": csv("LOG.CSV"),
    "dates, some without a fraction": csv(
        "x.csv",
        lambda t: t.assign(
            t=[datetime(2024, 5, 1) + timedelta(microseconds=round(1e6 * x)) for x in t.t]
        ).assign(t=lambda t: [x.isoformat() for x in t.t]),
    ),
    "minutes and seconds": csv(
        "x.csv", lambda t: t.assign(t=[f"{x // 60:02.0f}:{x % 60:012.9f}" for x in t.t + 3599])
    ),
    "minutes and seconds, some without a fraction": csv(
        "x.csv",
        lambda t: t.assign(
            t=[f"{x // 60:02.0f}:{x % 60:012.9f}".replace(".000000000", "") for x in t.t + 3599]
        ),
    ),
    "PlotJuggler's name of the time": csv("x.csv", lambda t: t.rename(columns={"t": "__time"})),
    "a row twice": csv("x.csv", lambda t: t.iloc[[*range(9), 8, *range(9, len(t))]]),
    "time": csv("x.csv", lambda t: t.rename(columns={"t": "Time [s]"})),
    "a unit in the name": csv(
        "x.csv", lambda t: t.assign(t=1e3 * t.t).rename(columns={"t": "time_ms"})
    ),
    "days in the name": csv(
        "x.csv", lambda t: t.assign(t=t.t / 86400).rename(columns={"t": "time (days)"})
    ),
    "hours in the name": csv(
        "x.csv", lambda t: t.assign(t=t.t / 3600).rename(columns={"t": "time_h"})
    ),
    "durations, whatever unit the name has": parquet(
        lambda t: t.assign(t=pd.to_timedelta(t.t, "s")).rename(columns={"t": "time_ms"})
    ),
    "npz": lambda folder: arrays(folder, "x.npz"),
    "dates of NumPy": lambda folder: arrays(
        folder, "x.npz", t=np.datetime64("2024-05-01", "ns") + pd.to_timedelta(motion().t, "s")
    ),
    "mat": lambda folder: arrays(folder, "x.mat"),
    "rows of MATLAB": lambda folder: arrays(folder, "x.mat", q=motion().q_0.to_numpy()),
    "a structure": lambda folder: arrays(
        folder, "x.mat", log={"q": motion().q_0.to_numpy()}, q=0.0
    ),
}
WITH_SETTINGS: dict[str, tuple[Writer, dict]] = {
    "a unit that is given": (csv("x.csv", lambda t: t.assign(t=1e6 * t.t)), {"time_unit": "us"}),
    "days": (csv("x.csv", lambda t: t.assign(t=t.t / 86400)), {"time_unit": "d"}),
    "minutes": (csv("x.csv", lambda t: t.assign(t=t.t / 60)), {"time_unit": "min"}),
    "a unit in the name of a column that is given": (
        csv("x.csv", lambda t: t.assign(t=1e3 * t.t).rename(columns={"t": "Zeit [ms]"})),
        {"columns": {"t": "Zeit [ms]"}},
    ),
    "no times": (csv("x.csv", lambda t: t.drop(columns="t")), {"sample_time": H / 2}),
    "degrees": (csv("x.csv", lambda t: t.assign(q_0=np.degrees(t.q_0))), {"degrees": True}),
    "other names": (
        csv("x.csv", lambda t: t.rename(columns={"q_0": "angle"})),
        {"columns": {"q_0": "angle"}},
    ),
    "columns that are left out": (
        csv("x.csv", lambda t: t.assign(u_bat=np.nan, q_lock=0.3, traj=t.t, split="x")),
        {"columns": {"u_bat": None, "q_lock": None, "traj": None, "split": None}},
    ),
    "a clock that is left out": (
        csv("x.csv", lambda t: t.rename(columns={"t": "time"}).assign(t=0.0)),
        {"columns": {"t": None}},
    ),
}


@pytest.mark.parametrize("kind", [*WRITERS, *WITH_SETTINGS])
def test_every_format_gives_the_same_motion(kind: str, tmp_path: Path) -> None:
    motion().to_parquet(tmp_path / "plain.parquet", index=False)
    writer, settings = WITH_SETTINGS.get(kind) or (WRITERS[kind], {})
    expected, found = load(tmp_path / "plain.parquet"), load(writer(tmp_path), **settings)
    for a, b in zip(found.train, expected.train, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-9, atol=1e-7)


def test_rows_without_times_are_a_sample_time_apart_in_each_trajectory(tmp_path: Path) -> None:
    path = tmp_path / "x.csv"
    table = motion().assign(run=["a", "b"] * (len(motion()) // 2))
    table.to_csv(path, index=False)
    with pytest.raises(ConfigError, match="has times; leave it out"):
        read_recordings(path, DRIVEN, sample_time=H)
    table.drop(columns="t").to_csv(path, index=False)
    with pytest.raises(ConfigError, match="or give data\\.sample_time=SECONDS"):
        read_recordings(path, DRIVEN)
    with pytest.raises(ConfigError, match="sample_time=0"):
        read_recordings(path, DRIVEN, sample_time=0.0)
    lists = table.drop(columns="t").assign(run=[["a"], ["b"]] * (len(table) // 2))
    lists.to_parquet(tmp_path / "x.parquet", index=False)
    for file in path, tmp_path / "x.parquet":
        first, second = read_recordings(file, DRIVEN, sample_time=H).recordings
        np.testing.assert_allclose(first.samples.t, table.t[::2], atol=1e-12)
        np.testing.assert_allclose(second.samples.t, table.t[::2], atol=1e-12)


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_each_of_several_files_is_a_trajectory(suffix: str, tmp_path: Path) -> None:
    folder = several(tmp_path, suffix)
    ways = [folder, f"{folder}/*.{suffix}", [folder / f"{k}.{suffix}" for k in range(3)]]
    all_of_them = [load(path) for path in ways]
    for data in all_of_them:
        assert [len(data.trajectories(part)) for part in ("train", "val", "test")] == [1] * 3
        assert torch.equal(data.test.q, all_of_them[0].test.q)
    chosen = load(folder, test=["0"], val=["1"])
    assert chosen.trajectories("test")[0].q[0].item() < all_of_them[0].test.q[0, 0]


def test_files_of_the_same_name_are_different_trajectories(tmp_path: Path) -> None:
    paths = [tmp_path / name for name in ("a/log.csv", "b/log.csv", "b/log.parquet", "c/log.csv")]
    for k, path in enumerate(paths):
        path.parent.mkdir(exist_ok=True)
        piece = motion(4.0).assign(q_0=k)
        piece.to_csv(path, index=False) if path.suffix == ".csv" else piece.to_parquet(path)
    for some, names in (
        ([0, 1, 3], ["a/log", "b/log", "c/log"]),
        ([0, 1, 2, 3], ["a/log.csv", "b/log.csv", "b/log.parquet", "c/log.csv"]),
        ([1], [""]),
    ):
        found = read_recordings([paths[k] for k in some], DRIVEN).recordings
        assert [one.label for one in found] == names
        kept = without(found, [[names[-1], 1.0, 2.0]], H)
        assert [one.samples.q[0, 0] for one in kept] == some
    with pytest.raises(ConfigError, match=r"log.csv is there twice"):
        read_recordings([paths[0], tmp_path / "a/*.csv"], DRIVEN)


@pytest.mark.parametrize("pattern", ["", "*.csv"])
def test_numbered_files_are_in_the_order_of_their_numbers(pattern: str, tmp_path: Path) -> None:
    names = ["run_9.csv", "run_10.csv", "run_10b.csv", "run_11.csv"]
    for name in reversed(names):
        (tmp_path / name).touch()
    assert [file.name for file in files(tmp_path / pattern)] == names


def test_hidden_files_of_a_folder_are_left_out(tmp_path: Path) -> None:
    folder = several(tmp_path)
    (folder / "._0.csv").write_bytes(b"\x00\x05\xff")
    assert len(load(folder).trajectories("train")) == 1


@pytest.mark.parametrize("path", [None, 5, [], "", True])
def test_what_is_no_path_is_refused(path: object) -> None:
    with pytest.raises(ConfigError, match=r"data.path=.*: expected a file, a folder"):
        load(path)


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        ({"u_bat": None}, "u_bat=null, but .* has no such column; it has t, q_0, u_0"),
        ({"q_0": None}, "no column q_<name>"),
        ({"t": None}, "no column t"),
        ({"u_0": None, "u_1": "u_0"}, "one column has two names"),
    ],
)
def test_columns_that_cannot_be_left_out_are_refused(columns, said, tmp_path: Path) -> None:
    motion().to_csv(tmp_path / "x.csv", index=False)
    with pytest.raises(ConfigError, match=said):
        load(tmp_path / "x.csv", columns=columns)


def test_files_with_other_columns_are_refused(tmp_path: Path) -> None:
    folder = several(tmp_path)
    motion().rename(columns={"u_0": "u_1"}).to_csv(folder / "1.csv", index=False)
    with pytest.raises(ConfigError, match=r"1.csv has the columns q_0, u_1, but 0.csv has q_0"):
        load(folder)


@pytest.mark.parametrize("seconds", [1.5, 10.0, 70.0, 400.0])
def test_a_long_log_is_split_in_time(seconds: float, tmp_path: Path, caplog) -> None:
    """In parts of 60, 20 and 20 %, which do not touch."""
    motion(seconds).to_csv(tmp_path / "log.csv", index=False)
    with caplog.at_level(logging.INFO):
        data = load(tmp_path / "log.csv")
    nodes = {part: data.trajectories(part) for part in ("train", "val", "test")}
    shares = {part: sum(len(t.q) for t in found) * H / seconds for part, found in nodes.items()}
    assert shares == pytest.approx({"train": 0.6, "val": 0.2, "test": 0.2}, abs=0.1)
    assert 0.85 < sum(shares.values()) < 1.0
    rows = [tuple(row.tolist()) for found in nodes.values() for t in found for row in t.q]
    assert len(set(rows)) == len(rows)
    assert any("split in time" in record.getMessage() for record in caplog.records)


@pytest.mark.parametrize(
    ("settings", "message"),
    [({"n_val": 1}, "too few"), ({"val": [""], "test": [""]}, "is named twice")],
)
def test_a_log_is_not_split_where_parts_are_given(settings, message, tmp_path: Path) -> None:
    motion().to_csv(tmp_path / "log.csv", index=False)
    with pytest.raises(ConfigError, match=message):
        load(tmp_path / "log.csv", **settings)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            lambda t: t.rename(columns={"t": "time", "q_0": "theta", "u_0": "torque"}),
            "'data.columns={t: time, q_theta: theta, u_torque: torque}'",
        ),
        (
            lambda t: t.rename(columns={"q_0": "q1", "u_0": "tau1"}).assign(dq1=0.0),
            "'data.columns={q_1: q1, v_1: dq1, u_1: tau1}'",
        ),
        (
            lambda t: t.rename(columns={"q_0": "arm_pos", "u_0": "motor1"}),
            "'data.columns={q_arm: arm_pos, u_motor1: motor1}'",
        ),
        (
            lambda t: t.rename(columns={"q_0": "arm_pos"}).assign(arm_vel=0.0),
            "'data.columns={q_arm: arm_pos, v_arm: arm_vel}'",
        ),
        (
            lambda t: t.rename(columns={"t": "timestamp", "q_0": "pos_m", "u_0": "motor_volt"}),
            "'data.columns={t: timestamp, q_pos: pos_m, u_motor_volt: motor_volt}'",
        ),
        (lambda t: t.assign(t=1e3 * t.t), "give data.time_unit=ms"),
        (
            lambda t: pd.concat(t.assign(t=1e3 * t.t + 0.7 * k).iloc[:300] for k in range(14)),
            "times are 10 apart, and nothing says their unit; if they are in ms",
        ),
        (
            lambda t: t.assign(t=[f"{x // 60:02}:{x % 60:02}" for x in range(len(t))]),
            "times such as 00:00 may be minutes and seconds, or hours and minutes",
        ),
        (lambda t: t.assign(t=np.nan), "most of them in column t"),
        (
            lambda t: t.rename(columns={"t": "Time (s)", "q_0": "Arm Angle (rad)"}),
            '\'data.columns={t: "Time (s)", q_Arm: "Arm Angle (rad)"}\'',
        ),
        (
            lambda t: t[["t"]].assign(
                **dict.fromkeys(["x", "y", "z", "vx", "vy", "vz"], 0.0),
                **dict.fromkeys(["qx", "qy", "qz", "qw", "gyro_x", "gyro_y", "gyro_z"], 0.0),
                pwm1=0.0,
            ),
            "'data.columns={q_x: x, q_y: y, q_z: z, q_R_w: qw, q_R_x: qx, q_R_y: qy, q_R_z: qz, "
            "u_pwm1: pwm1}'",
        ),
        (
            lambda t: t.rename(columns={"q_0": "arm_deg"}),
            "'data.columns={q_arm: arm_deg}' data.degrees=true",
        ),
        (lambda t: t.assign(t=1e9 * t.t), "give data.time_unit=ns"),
        (lambda t: t.assign(t=1e9 * t.t + 1.5e12), "give data.time_unit=ns"),  # not ms since 1970
        (lambda t: t.assign(t=1e6 * t.t + 1.5e12), "give data.time_unit=us"),
        (lambda t: t.assign(t=t.t / 86400), "if they are in days, give data.time_unit=d"),
        (
            lambda t: t.assign(q_0=(200 * t.t) % 360),
            "data.degrees=true data.wrapped=true",
        ),
    ],
)
def test_a_refused_table_names_the_setting_that_reads_it(change, said: str, tmp_path: Path) -> None:
    change(motion()).to_csv(tmp_path / "x.csv", index=False)
    with pytest.raises(ConfigError) as error:
        load(tmp_path / "x.csv")
    assert said in str(error.value)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda t: t.assign(q_0=np.degrees(t.q_0)), "data.degrees=true"),
        (lambda t: t.assign(v_0=1e-3 * np.gradient(t.q_0, t.t)), "v_0 is 0.001 times the slope"),
        (lambda t: t.assign(v_0=np.gradient(t.q_0, t.t)), None),
        (lambda t: t.assign(v_0=-np.gradient(t.q_0, t.t)), "v_0 is -1 times the slope"),
        (lambda t: t.assign(q_0=t.q_0 + 9 * t.t), None),
    ],
)
def test_doubtful_units_are_noted(change, said: str | None, tmp_path: Path, caplog) -> None:
    change(motion()).to_csv(tmp_path / "x.csv", index=False)
    with caplog.at_level(logging.INFO):
        load(tmp_path / "x.csv")
    told = [r.getMessage() for r in caplog.records if "if angles are in" in r.getMessage()]
    told += [r.getMessage() for r in caplog.records if "times the slope" in r.getMessage()]
    assert [said in line for line in told] == [True] if said else not told


def test_velocities_in_other_units_can_be_left_out_of_all_parts(tmp_path: Path) -> None:
    """By the setting that the line on them gives, which keeps those that are given."""
    slope = np.gradient(motion().q_0, motion().t)
    table = motion().rename(columns={"u_0": "torque"}).assign(v_0=60 * slope)
    table.to_csv(tmp_path / "x.csv", index=False)
    columns: dict[str, str | None] = {"u_0": "torque"}
    (told,) = [x for x in load(tmp_path / "x.csv", columns=columns).lines() if "the slope" in x]
    assert told.endswith("'data.columns={u_0: torque, v_0: null}'")
    found = load(tmp_path / "x.csv", columns={**columns, "v_0": None})
    assert not [x for x in found.lines() if "the slope" in x]
    for part in ("train", "val", "test"):
        assert all(float(one.v.abs().max()) < 2 * slope.max() for one in found.trajectories(part))


@pytest.mark.parametrize(
    ("large", "style"),
    [("1.024,5", {"sep": ";", "decimal": ","}), ("1,024.5", {}), ("1 024.5", {}), ("1'024", {})],
)
def test_a_few_numbers_with_separators_of_thousands_are_not_left_out(
    large: str, style: dict[str, str], tmp_path: Path
) -> None:
    table = motion()
    words = table.q_0.astype(str).str.replace(".", style.get("decimal", "."))
    table.assign(q_0=words.mask(table.index == 99, large)).to_csv(
        tmp_path / "x.csv", index=False, **style
    )
    with pytest.raises(ConfigError, match=f"{large}.* in data row 100: write numbers as 1234.5"):
        read_recordings(tmp_path / "x.csv", DRIVEN)


@pytest.mark.parametrize(
    ("dated", "rounding"),
    [
        (lambda t: pd.Timestamp("2024-05-01 12:00") + pd.to_timedelta(t, "s"), 1e-9),
        (lambda t: 45413.5 + t / 86400, 1e-6),  # a spreadsheet's
        (lambda t: 739373.5 + t / 86400, 1e-5),  # MATLAB's
    ],
)
def test_dates_are_read_as_seconds_from_the_first_one(dated, rounding, tmp_path: Path) -> None:
    table = motion()
    (found,), (expected,) = (
        read(one, tmp_path).recordings for one in (table.assign(t=dated(table.t)), table)
    )
    np.testing.assert_allclose(found.samples.t, expected.samples.t, rtol=0.0, atol=rounding)


@pytest.mark.parametrize("start", [0.0, 40000.0])
def test_times_of_a_fast_clock_are_seconds(start: float, tmp_path: Path) -> None:
    """Also if rounded, as the sums of a counter are, in rows of several trajectories."""
    t = start + 1e-4 * np.arange(100)
    rounded = np.nextafter(t, np.inf)
    rows = pd.DataFrame(
        {"trajectory": np.tile([0, 1], 100), "t": np.stack([t, rounded], 1).ravel()}
    )
    rows.assign(q_0=0.0).to_csv(tmp_path / "x.csv", index=False)
    system = Recorded(time_step=1e-4, names=("0",), inputs=(), angular="all")
    found = read_recordings(tmp_path / "x.csv", system)
    assert [np.ptp(one.samples.t) for one in found.recordings] == pytest.approx([99e-4] * 2)
    assert not found.notes


def test_a_few_rows_without_a_number_are_left_out_and_it_is_said(tmp_path: Path) -> None:
    table = motion()
    found = read(table.assign(q_0=table.q_0.where(table.index % 50 > 0)), tmp_path)
    kept = table[table.index % 50 > 0]
    np.testing.assert_allclose(found.recordings[0].samples.t, kept.t, rtol=1e-12)
    np.testing.assert_allclose(found.recordings[0].samples.q[:, 0], kept.q_0, rtol=1e-12)
    (note,) = found.notes
    assert f"{len(table) - len(kept)} of {len(table)} rows" in note


@pytest.mark.parametrize(("failure", "noted"), [(-999.0, True), (5.0, False)])
def test_inputs_far_from_all_others_are_used_and_it_is_said(
    failure: float, noted: bool, tmp_path: Path
) -> None:
    """They may be those of a sensor that fails, or a short push."""
    table = motion()
    found = read(table.assign(u_0=table.u_0.mask(table.index % 500 == 7, failure)), tmp_path)
    assert found.recordings[0].samples.u[7] == failure
    said = f"u_0 is far from its other values in 6 rows, such as {failure:g} in data row 8"
    assert any(said in note for note in found.notes) == noted


def test_a_clock_that_starts_anew_begins_a_recording(tmp_path: Path) -> None:
    table = motion(6.0)
    pieces = np.array_split(np.arange(len(table)), 3)
    anew = [
        table.iloc[rows].assign(t=table.t.iloc[rows] - table.t.iloc[rows[0]]) for rows in pieces
    ]
    found = read(pd.concat(anew), tmp_path)
    assert "3 recordings" in found.notes[-1]
    for one, rows in zip(found.recordings, pieces, strict=True):
        np.testing.assert_allclose(one.samples.q[:, 0], table.q_0.iloc[rows], rtol=1e-12)


@pytest.mark.parametrize(
    ("name", "unit", "count"),
    [("t_ms", 1e-3, 2**16), ("t_us", 1e-6, 2**16), ("time_usec", 1e-6, 2**32), ("ms", 1e-3, 2**32)],
)
def test_a_counter_of_times_goes_on_where_it_starts_anew(name, unit, count, tmp_path: Path) -> None:
    """Those of microcontrollers have 16 or 32 bits."""
    times = 0.01 * np.arange(8000)
    counts = np.round(times / unit).astype(int)
    for first in (0, count - 150):
        table = pd.DataFrame({name: (counts + first) % count, "q_0": np.sin(times)})
        found = read(table, tmp_path, FREE, {"t": "ms"} if name == "ms" else None)
        (one,) = found.recordings
        assert one.samples.t - one.samples.t[0] == pytest.approx(times)
        told = any("counter starts anew" in note for note in found.notes)
        assert told == (counts[-1] + first >= count)


@pytest.mark.parametrize("every", [2, 10])
def test_inputs_of_another_clock_are_read_as_the_message_says(every: int, tmp_path: Path) -> None:
    t = 0.01 * np.arange(900)
    table = pd.DataFrame({"t": t, "q_0": np.sin(t), "u_0": np.cos(t)})
    same = table.assign(u_0=table.u_0.where(table.index % every == 0))
    own = pd.concat([table[["t", "q_0"]], table.assign(t=t + 0.003).iloc[::every][["t", "u_0"]]])
    for change in (same, own.sort_values("t")):
        with pytest.raises(ConfigError, match="inputs keep their last values") as error:
            read(change, tmp_path)
        assert "null" not in str(error.value)  # without its input, a machine is another one
        (one,) = read(change.assign(u_0=change.u_0.ffill()).dropna(), tmp_path).recordings
        assert len(one.samples.t) >= 899


@pytest.mark.parametrize("label", [{}, {"trajectory": 7}])
def test_any_number_of_rows_may_be_written_twice(label, tmp_path: Path) -> None:
    table = motion().assign(**label)
    found = read(table.loc[table.index.repeat(2)], tmp_path)
    np.testing.assert_allclose(found.recordings[0].samples.q[:, 0], table.q_0, rtol=1e-12)
    assert "3000 of 6000 rows are copies and are left out" in found.notes


@pytest.mark.parametrize("label", [{}, {"trajectory": 7}])
def test_a_clock_that_is_set_back_by_a_part_of_its_time_is_refused(label, tmp_path: Path) -> None:
    """Its times repeat earlier ones, and no other rows would tell of it."""
    table = motion().assign(**label)
    late = (table.t - 0.5 * (table.index >= 1500)).round(2)
    with pytest.raises(ConfigError, match=r"goes back in time after t=14.99"):
        read(table.assign(t=late), tmp_path)
    for order in (table.sample(frac=1, random_state=0), table[::-1]):
        (found,) = read(order, tmp_path).recordings
        np.testing.assert_allclose(found.samples.q[:, 0], table.q_0, rtol=1e-12)


@pytest.mark.parametrize(
    ("start", "clock", "told"),
    [
        (lambda k: 7.0 * k, 0.0, True),  # the motion starts anew elsewhere
        (lambda k: 1.0 * k, 0.0, False),  # it goes on, as where the column is a state of it
        (lambda k: 7.0 * k, 5.0, False),  # the recordings are cut at gaps
    ],
)
def test_a_column_that_changes_where_positions_jump_is_not_passed_over(
    start, clock, told, tmp_path: Path
) -> None:
    k = np.arange(600) // 100
    t = 0.01 * np.arange(600)
    q = np.sin(t - k + start(k))
    table = pd.DataFrame({"t": t + clock * k, "q_0": q, "Versuch": k, "noise": np.arange(600) % 2})
    if not told:
        assert len(read(table, tmp_path, FREE).recordings) == 1
        return
    with pytest.raises(ConfigError, match="positions jump where Versuch changes") as error:
        read(table, tmp_path, FREE)
    # without the column, one of the leaps is too small to be told from a motion
    for columns, count in (({"trajectory": "Versuch"}, 6), ({"Versuch": None}, 5)):
        assert as_setting(columns) in str(error.value)
        assert len(read(table, tmp_path, FREE, columns).recordings) == count


def struck(q: np.ndarray) -> np.ndarray:
    """A motion whose velocity jumps twice."""
    t = 0.01 * np.arange(len(q))
    return q + 5.0 * np.maximum(t - 2.005, 0.0) - 5.0 * np.maximum(t - 4.0, 0.0)


@pytest.mark.parametrize(
    ("change", "count"),
    [
        (lambda q: q, 3),
        (lambda q: 1e3 * q, 3),  # in mm
        (lambda q: q.round(2), 3),  # of an encoder
        (lambda q: np.sin(0.01 * np.arange(len(q))), 1),
        (lambda q: struck(np.sin(0.01 * np.arange(len(q)))), 1),  # blows
        (lambda q: (0.02 * np.arange(len(q)) + np.pi) % (2 * np.pi) - np.pi, 1),
        (lambda q: (np.arange(len(q)) + 180.0) % 360.0 - 180.0, 1),  # angles jump by a turn
        (
            lambda q: np.where(
                np.arange(len(q)) % 200 == 77, 9.0, np.sin(0.01 * np.arange(len(q)))
            ),
            1,
        ),
        (lambda q: np.sin(0.01 * (np.arange(len(q)) // 5 * 5)), 1),  # a slower sensor
        (lambda q: np.where(np.arange(len(q)) % 200 < 100, 0.0, 1.0), 1),  # two places only
    ],
)
@pytest.mark.parametrize("pause", [0.0, 0.02])
def test_positions_that_leap_begin_a_recording(change, count, pause: float, tmp_path: Path) -> None:
    """No time tells of motions that were written one below the other."""
    k = np.arange(900) // 300
    t = 0.01 * np.arange(900)
    q = np.array([1.0, 1.5, 0.8])[k] * np.cos(3.0 * (t - 3.0 * k))
    table = pd.DataFrame({"t": t + pause * k, "q_0": change(q)})
    found = read(table, tmp_path, FREE)
    assert len(found.recordings) == count
    assert any("leap 2 times, first after t=2.99: 3 rec" in x for x in found.notes) == (count > 1)


@pytest.mark.parametrize(
    ("rows", "shown"),
    [
        (lambda k: k // 5 * 5, 180),  # a sensor of a fifth of the rate
        (lambda k: (k * 10 // 35 * 35 + 9) // 10, 257),  # of 2/7
        (lambda k: np.minimum(k, 450) // 5 * 5, 180),  # and then at rest
        (lambda k: k, 900),
        (lambda k: k // 5 * 5 + k % 5 // 2, 900),
    ],
)
def test_positions_that_a_slow_sensor_repeats_are_left_out(rows, shown, tmp_path: Path) -> None:
    k = np.arange(900)
    t, place = 0.01 * k, np.sin(0.01 * rows(k))
    table = pd.DataFrame({"t": t, "q_0": place, "u_0": k % 5 == 0}).astype(float)
    found = read(table, tmp_path)
    (one,) = found.recordings
    assert len(one.samples.q) == shown
    assert any("repeats its positions" in note for note in found.notes) == (shown < 900)
    at = np.round(one.samples.t / 0.01).astype(int)
    # that far the CSV reader of pandas 2 rounds
    assert one.samples.q[:, 0] == pytest.approx(place[at], rel=0.0, abs=1e-15)
    if shown == 180:
        assert one.samples.u[1:-1] == pytest.approx(0.2)  # the mean of the five around each


@pytest.mark.parametrize("speed", [0.2, 1.0, 3.0])
def test_positions_that_an_encoder_repeats_are_kept(speed: float, tmp_path: Path) -> None:
    k = np.arange(900)
    for place in (np.floor(speed * k), np.round(50.0 * np.sin(0.01 * speed * k))):
        table = pd.DataFrame({"t": 0.01 * k, "q_0": 0.01 * place})
        (one,) = read(table, tmp_path, FREE).recordings
        assert len(one.samples.q) == 900


@pytest.mark.parametrize("name", ["run", "Trial_ID", "Trial #", "episode", "experiment no"])
def test_a_column_of_recordings_needs_no_setting(name: str, tmp_path: Path) -> None:
    """The clock goes on from one to the next, so that nothing else tells them apart."""
    table = motion(6.0)
    number = np.arange(len(table)) // 200
    found = read(table.assign(**{name: number}), tmp_path)
    assert [one.label for one in found.recordings] == ["0", "1", "2"]
    assert f"column {name} is read as trajectory" in found.notes


@pytest.mark.filterwarnings("error")
def test_times_of_day_are_read_without_a_warning(tmp_path: Path) -> None:
    table = motion(6.0)
    clock = pd.Timestamp("2024-05-01 23:00") + pd.to_timedelta(table.t, "s")
    words = clock.dt.strftime("%H:%M:%S.%f")
    (found,) = read(table.assign(t=words), tmp_path).recordings
    np.testing.assert_allclose(found.samples.t, table.t, rtol=0.0, atol=1e-6)


def test_arrays_may_hold_many_trajectories() -> None:
    q = np.arange(24.0).reshape(2, 4, 3)
    found = from_arrays({"t": np.arange(4.0), "q": q, "mass": np.array([1.0, 2.0]), "note": "x"})
    assert list(found) == ["trajectory", "t", "q_0", "q_1", "q_2", "mass"]
    np.testing.assert_array_equal(found[["q_0", "q_1", "q_2"]], q.reshape(8, 3))
    assert found.trajectory.tolist() == [0] * 4 + [1] * 4
    with pytest.raises(ValueError, match="no array of times"):
        from_arrays({"q": q})


@pytest.mark.parametrize("nodes", [2, 5])
def test_an_array_of_one_trajectory_has_its_nodes_in_rows_or_in_columns(nodes: int) -> None:
    t, q = np.arange(nodes), np.arange(nodes * 3.0).reshape(nodes, 3)
    for x in (q, q.T):
        found = from_arrays({"t": t, "q": x})
        np.testing.assert_array_equal(found[["q_0", "q_1", "q_2"]], q)


@pytest.mark.parametrize("count", [3, 40])
@pytest.mark.parametrize("shape", [(10,), (1, 10), (10, 1), (-1, 10)])
def test_times_may_be_those_of_all_trajectories(shape: tuple[int, ...], count: int) -> None:
    """Also if there are more trajectories than samples of each."""
    t = np.tile(np.arange(10.0), count if shape[0] == -1 else 1).reshape(shape)
    q = np.arange(count * 10 * 2.0).reshape(count, 10, 2)
    found = from_arrays({"t": t, "q": q})
    np.testing.assert_array_equal(found.t, np.tile(np.arange(10.0), count))
    np.testing.assert_array_equal(found[["q_0", "q_1"]], q.reshape(-1, 2))
    np.testing.assert_array_equal(found.trajectory, np.repeat(np.arange(count), 10))


@pytest.mark.parametrize("name", ["q", "v", "u", "torque"])
@pytest.mark.parametrize("shape", [(39,), (39, 1), (41, 2), (3, 39, 2)])
def test_a_signal_of_another_length_is_not_passed_over(name: str, shape: tuple[int, ...]) -> None:
    """As of 40 states and the 39 inputs between them."""
    plain = (3, 40, 1) if len(shape) == 3 else (40, 1)
    arrays = {"t": np.arange(40.0), "q_0": np.zeros(plain), "mass": np.ones(5)}
    assert "mass" not in from_arrays(arrays)
    with pytest.raises(ValueError, match=rf"{name} has {shape[-2:][0]} rows, t 40; save arrays"):
        from_arrays({**arrays, name: np.zeros(shape)})
    with pytest.raises(ValueError, match=r"u_motor has 20 rows, t 40"):
        from_arrays({**arrays, "u_motor": np.zeros(20)})
    with pytest.raises(ValueError, match=r"u_motor has 20 rows, t 40"):
        from_arrays({**arrays, "u_motor": np.zeros((20, 2))})  # as many numbers as times


def test_arrays_of_one_name_in_several_structures_are_kept_apart(tmp_path: Path) -> None:
    t = np.arange(4.0)
    log = {"left": {"t": t, "q": t + 1}, "right": {"t": t, "q": t + 2}, "rate": 100.0}
    scipy.io.savemat(tmp_path / "x.mat", log)
    found = table_of(tmp_path / "x.mat")
    assert list(found) == ["t", "left_q", "right_q"]
    np.testing.assert_array_equal(found.right_q, t + 2)


def test_a_ros_bag_gives_the_same_motion(tmp_path: Path) -> None:
    rosbag2 = pytest.importorskip("rosbags.rosbag2")
    from rosbags.typesys import Stores, get_typestore

    types = get_typestore(Stores.ROS2_HUMBLE)
    joint, head, time = (
        types.types[name]
        for name in (
            "sensor_msgs/msg/JointState", "std_msgs/msg/Header", "builtin_interfaces/msg/Time",
        )
    )  # fmt: skip
    with rosbag2.Writer(tmp_path / "bag", version=9) as writer:
        topic = writer.add_connection("/joints", joint.__msgtype__, typestore=types)
        for row in motion().itertuples():
            stamp = int(1.7e18) + round(row.t * 1e9)
            message = joint(
                head(time(stamp // 10**9, stamp % 10**9), "base"), ["0"],
                np.array([row.q_0]), np.array([]), np.array([row.u_0]),
            )  # fmt: skip
            writer.write(topic, stamp, types.serialize_cdr(message, joint.__msgtype__))
    motion().to_parquet(tmp_path / "plain.parquet", index=False)
    expected, found = load(tmp_path / "plain.parquet"), load(tmp_path / "bag")
    torch.testing.assert_close(found.train.q, expected.train.q, rtol=1e-9, atol=1e-7)


def matlab_file(**arrays: np.ndarray) -> bytes:
    stream = io.BytesIO()
    scipy.io.savemat(stream, arrays)
    return stream.getvalue()


@pytest.mark.parametrize("kept", [140, 190, 250])
def test_a_matlab_file_that_is_cut_off_is_refused(kept: int, tmp_path: Path) -> None:
    (tmp_path / "x.mat").write_bytes(matlab_file(t=np.arange(4.0), q=np.arange(4.0))[:kept])
    with pytest.raises(ConfigError, match="it is damaged"), readable("x.mat"):
        table_of(tmp_path / "x.mat")


@pytest.mark.parametrize(
    ("place", "value"),
    [(128, 77), (135, 200), (145, 8), (168, 133), (176, 133), (180, 60)],
    ids=["matrix", "size", "complex", "name", "numbers", "numbers beyond"],
)
def test_a_matlab_file_whose_elements_do_not_fit_is_refused(
    place: int, value: int, tmp_path: Path
) -> None:
    """SciPy ends Python by a segmentation fault for some of them."""
    content = bytearray(matlab_file(t=np.arange(4.0)))
    assert content[place] != value
    content[place] = value
    with pytest.raises(ValueError, match="it is damaged"):
        check_elements(bytes(content))


def joint_state(t: float, **position: float) -> SimpleNamespace:
    """A message as rosbags reads it."""
    stamp = SimpleNamespace(sec=int(t), nanosec=round(t % 1 * 1e9))
    return SimpleNamespace(
        header=SimpleNamespace(stamp=stamp), name=list(position),
        position=np.array([*position.values()]), velocity=np.array([]), effort=np.array([]),
    )  # fmt: skip


def test_joint_states_have_their_joints_in_any_order_and_some_have_not_all() -> None:
    states = [
        joint_state(5.0, arm=9.0),
        joint_state(5.25, arm=1.0, hand=2.0),
        joint_state(5.5, hand=4.0, arm=3.0),
    ]
    found = joint_states(Path("bag"), states)
    expected = {"t": [0.0, 0.25], "q_arm": [1.0, 3.0], "q_hand": [2.0, 4.0]}
    assert found.to_dict("list") == expected


def test_joint_states_of_two_publishers_are_refused() -> None:
    states = [joint_state(0.0, hand=1.0), joint_state(0.1, arm=2.0), joint_state(0.2, arm=3.0)]
    with pytest.raises(ConfigError, match=r"several publishers; its messages have arm \(2\); hand"):
        joint_states(Path("bag"), states)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        (".", None, "the folder has no"),
        ("x*.csv", None, "no file matches"),
        ("absent.csv", None, "No such file"),
        ("absent.mat", None, "No such file"),
        ("x.xlsx", b"", r"expected a file that ends in \.csv, .*save the sheet as CSV"),
        ("x.csv.gz", b"", r"expected a file that ends in \.csv, .*unpack it"),
        ("x.jsonl", b"", r"expected a file that ends in \.csv, .*DataFrame\.to_csv"),
        ("x.txt", b"", "it is empty"),
        ("bare.csv", b"0.0,1.0,2.0\n0.1,1.0,2.0\n", r"first line has numbers \(0.0, 1.0, 2.0\)"),
        ("bare.csv", b"0,0;1,0;2,5\n0,1;1,0;2,0\n", r"first line has numbers \(0,0, 1,0, 2,5\)"),
        ("absent", None, "there is no such file or folder"),
        ("x.npz", b"nonsense", "no archive of arrays"),
        ("x.npz", saved(np.save, np.ones(9)), "no archive of arrays"),
        (
            "x.npz",
            encrypted(saved(np.savez, t=np.ones(9))),
            r"cannot be read \(File 't.npy' is encrypted",
        ),
        ("x.npz", saved(np.savez, t=np.array([None])), "array t: .*leave t out of the file"),
        ("x.mat", b"nonsense", "cannot be read"),
        ("x.db3", b"nonsense", "ROS bag"),
        ("x.parquet", b"PAR1 nonsense", "cannot be read"),
        ("empty.parquet", b"", "cannot be read"),
        ("empty.csv", b"", "cannot be read"),
        (
            "ragged.csv",
            b"trajectory,t,q_x,q_theta\n0,0,0,0\n0,0.1,0,0,5\n",
            "5 cells, the line of names 4",
        ),
        ("bytes.csv", b"\xff\xfe\x00\x81,\n\x9d", "cannot be read"),
        ("odd.csv", "時間,q_x\n0,1\n".encode("shift-jis") + b"\x81", "no text in a known encoding"),
    ],
)
def test_unreadable_files_are_refused_in_one_line(name, content, message, tmp_path: Path) -> None:
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    for read in (load, lambda path: RecordedData(system=stated("cartpole"), path=path)):
        with pytest.raises(ConfigError, match=message):
            read(path)


def test_a_data_frame_is_refused_with_the_way_to_write_it() -> None:
    with pytest.raises(ConfigError, match="to_parquet"):
        load(motion())
