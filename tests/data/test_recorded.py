"""Recordings of a user: read without loss, or refused in one line."""

from __future__ import annotations

import itertools
import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch

from symo_exp.data.delays import delayed, lagging
from symo_exp.data.draws import generate, uniform
from symo_exp.data.recorded import RecordedData, recorded_system
from symo_exp.data.resample import Samples
from symo_exp.data.table import read_recordings
from symo_exp.errors import ConfigError
from symo_exp.mechanics.types import Trajectories
from symo_exp.systems.base import System
from symo_exp.systems.chain import ChainPendulum
from symo_exp.systems.simulation import Solver
from symo_exp.systems.table import system as stated
from tests.data.small import write_recordings


def trajectories(system: System, count: int = 6, steps: int = 9) -> Trajectories:
    solver = Solver("DOP853", 1e-9, 1e-9)
    starts = uniform(system.box, count, 0)
    return generate(system, starts, steps=steps, forced=True, solver=solver)


def recorded(system: System, path: Path, **arguments: object) -> RecordedData:
    data = RecordedData(system=system, path=path, **arguments)  # type: ignore[arg-type]
    data.prepare_data()
    data.setup()
    return data


@pytest.mark.parametrize("suffix", [".parquet", ".csv"])
@pytest.mark.parametrize("system", [stated("cartpole"), ChainPendulum(3)])
def test_written_recordings_are_read_back(system: System, suffix: str, tmp_path: Path) -> None:
    truth, path = trajectories(system), tmp_path / f"mine{suffix}"
    write_recordings(path, truth, system.coordinates, system.time_step)
    data = recorded(system, path, n_val=1, n_test=2, n_integration=1, dtype="float64")
    parts = [data.trajectories(part) for part in ("train", "val", "test")]
    found = [*itertools.chain(*parts), *data.integration.each()]
    assert [len(part) for part in parts] == [3, 1, 2]
    for field, expected in (
        pair
        for one, i in zip(found, [0, 1, 2, 3, 4, 5, 4], strict=True)
        for pair in zip(one, truth.each()[i], strict=True)
    ):
        torch.testing.assert_close(field, expected, rtol=1e-12, atol=1e-14)
    assert len(data.train.q) == 3 * 8
    assert sum(len(batch.q) for batch in data.batches(0)) == 24


@pytest.mark.parametrize(("part", "setting"), [("train", "seconds"), ("val", "val_seconds")])
def test_a_part_is_reduced_and_the_others_are_not(part: str, setting: str, tmp_path: Path) -> None:
    system, path = stated("cartpole"), tmp_path / "mine.parquet"
    write_recordings(path, trajectories(system, steps=60), system.coordinates, system.time_step)
    whole = recorded(system, path, n_val=2)
    some = recorded(system, path, n_val=2, **{setting: 30 * system.time_step})
    lengths = [
        {
            name: sum(len(t.q) for t in getattr(one.load(), name))
            for name in ("train", "val", "test")
        }
        for one in (whole, some)
    ]
    assert {name for name in lengths[0] if lengths[0][name] != lengths[1][name]} == {part}
    assert lengths[1][part] == pytest.approx(30, abs=4)


@pytest.fixture
def table(tmp_path: Path) -> pd.DataFrame:
    system = stated("cartpole")
    write_recordings(
        tmp_path / "x.parquet", trajectories(system), system.coordinates, system.time_step
    )
    return pd.read_parquet(tmp_path / "x.parquet")


def save(table: pd.DataFrame, tmp_path: Path) -> Path:
    path = tmp_path / "changed.csv"
    table.to_csv(path, index=False)
    return path


def test_names_order_and_extra_columns_do_not_matter(table: pd.DataFrame, tmp_path: Path) -> None:
    plain = recorded(stated("cartpole"), save(table, tmp_path))
    table["comment"] = "spare"
    table["trajectory"] = table["trajectory"].map(lambda k: f"run {9 - k}")
    shuffled = table.sample(frac=1, random_state=0).sort_values("trajectory", ascending=False)
    again = recorded(stated("cartpole"), save(shuffled[shuffled.columns[::-1]], tmp_path))
    for a, b in zip(plain.train, again.train, strict=True):
        torch.testing.assert_close(a, b)


@pytest.mark.parametrize("index", [["t"], ["trajectory", "t"], []], ids="-".join)
def test_columns_stored_as_an_index_are_read(
    table: pd.DataFrame, index: list[str], tmp_path: Path
) -> None:
    plain, path = recorded(stated("cartpole"), save(table, tmp_path)), tmp_path / "indexed.parquet"
    other = table.set_index(index) if index else table.set_index(table.index[::-1])
    other.to_parquet(path)
    for a, b in zip(plain.train, recorded(stated("cartpole"), path).train, strict=True):
        torch.testing.assert_close(a, b)


def test_names_of_columns_in_capitals_and_categories_are_read(
    table: pd.DataFrame, tmp_path: Path
) -> None:
    parts = ["train", "test", "train", "val", "train", "none"]
    table["split"] = [parts[k] for k in table["trajectory"]]
    plain = recorded(stated("cartpole"), save(table, tmp_path))
    table["trajectory"] = table["trajectory"].astype(str).astype("category")
    kept = table[table["split"] != "none"]  # its category remains
    kept = kept.rename(columns={"trajectory": "Trajectory", "split": "Split"})
    kept.to_parquet(tmp_path / "x.parquet", index=False)
    again = recorded(stated("cartpole"), tmp_path / "x.parquet")
    for part in ("train", "val", "test"):
        for a, b in zip(getattr(plain, part), getattr(again, part), strict=True):
            torch.testing.assert_close(a, b)


def test_missing_velocities_are_central_differences(tmp_path: Path) -> None:
    """Second order: a quarter of the error at half the step."""
    errors = []
    for h in (0.02, 0.01):
        system = ChainPendulum(1, time_step=h)
        truth = trajectories(system, 4, round(0.4 / h))
        write_recordings(tmp_path / "x.parquet", truth, system.coordinates, h)
        table = pd.read_parquet(tmp_path / "x.parquet").drop(columns="v_theta_1")
        found = recorded(system, save(table, tmp_path), n_traj=2, dtype="float64")
        errors.append((found.trajectories("train")[0].v - truth.v[0]).abs().max().item())
    assert 3 < errors[0] / errors[1] < 5


@pytest.mark.parametrize(
    "change",
    [
        {"t": lambda row: row.t + 1e-6},
        {"q_x": lambda _: 1e300},
        {"u_0": lambda _: -1e101},
        {"q_x": lambda _: -9999.0},
        {"q_theta": lambda _: 65535},
    ],
)
def test_a_repeated_time_and_numbers_that_are_no_measurements_are_left_out(
    change, table: pd.DataFrame, tmp_path: Path
) -> None:
    """A slope over a microsecond is that of noise, and powers of 1e300 overflow."""
    table = table.drop(columns=["v_x", "v_theta"])
    plain = recorded(stated("cartpole"), save(table, tmp_path))
    row = table.iloc[[14]].assign(t=lambda x: x.t + 1e-9, q_theta=0.2).assign(**change)
    changed = pd.concat([table, row]).sort_values(["trajectory", "t"], kind="stable")
    again = recorded(stated("cartpole"), save(changed, tmp_path))
    for part in ("train", "val", "test"):
        for a, b in zip(getattr(plain, part), getattr(again, part), strict=True):
            torch.testing.assert_close(a, b)


@pytest.mark.parametrize("quick", [1e-3, 0.2])
def test_the_only_motion_of_a_log_at_rest_is_no_failure_of_a_sensor(
    quick: float, tmp_path: Path
) -> None:
    """Far from all other positions, and there at once if it is quick."""
    t = 0.01 * np.arange(1000)
    x = 1e-6 * np.sin(97 * t) + quick * np.arange(1000).clip(960, 990) - 960 * quick
    log = pd.DataFrame({"t": t, "q_x": x, "u_x": 0.0 * t})
    path = save(log, tmp_path)
    (found,) = read_recordings(path, recorded_system(path, time_step=0.01, angular=[])).recordings
    # old versions of pandas round the last digit
    np.testing.assert_allclose(found.samples.q[:, 0], x, rtol=1e-12, atol=1e-15)


def test_missing_inputs_are_zero(table: pd.DataFrame, tmp_path: Path) -> None:
    data = recorded(stated("cartpole"), save(table.drop(columns="u_0"), tmp_path))
    assert (data.train.u == 0).all()


@pytest.mark.parametrize(
    "cut", [{}, {"leave_out": [[3.0, 3.4]]}, {"fold": [0, 3]}, {"seconds": 2.0, "val_seconds": 1.0}]
)
@pytest.mark.parametrize(("delay", "lag"), [(0.2, 0.0), (0.0, 0.4), (-0.2, 0.4)])
def test_pieces_continue_the_inputs_before_them(
    delay: float, lag: float, cut: dict, tmp_path: Path
) -> None:
    path, h = tmp_path / "mine.csv", 0.05
    t = h * np.arange(240)
    whole = Samples(t, np.exp(0.1 * t)[:, None], None, np.cos(3 * t)[:, None])
    pd.DataFrame({"t": t, "q_a": whole.q[:, 0], "u_a": whole.u[:, 0]}).to_csv(path, index=False)
    system = recorded_system(path, time_step=h, angular="none")
    data = recorded(system, path, input_delay=delay, input_lag=lag, dtype="float64", **cut)
    expected = lagging(delayed(whole, delay), lag).u
    for part in ("train", "val", "test"):
        for q, _, u in data.trajectories(part):
            rows = np.abs(whole.q.T - q.numpy()).argmin(1)
            np.testing.assert_allclose(u, expected[rows], atol=1e-9)


def test_ragged_trajectories_keep_all_their_nodes(table: pd.DataFrame, tmp_path: Path) -> None:
    short = table.drop(index=range(12, 20))  # the second trajectory keeps two nodes
    with pytest.raises(ConfigError, match="trajectory 1 has 2 node"):
        recorded(stated("cartpole"), save(short, tmp_path))
    short = table.drop(index=[*range(17, 20), *range(43, 50)])
    data, whole = (
        recorded(stated("cartpole"), save(t, tmp_path), n_test=2) for t in (short, table)
    )
    assert [len(t.q) for t in data.trajectories("train")] == [10, 7, 10]
    rows = torch.tensor([*range(13), *range(16, 24)])
    for window, full in zip(data.train, whole.train, strict=True):
        assert torch.equal(window, full[rows])
    assert data.integration.q.shape == (2, 3, 2)  # up to the end of the shortest
    assert [len(data.trajectories(part)) for part in ("val", "test")] == [1, 2]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t.drop(columns="q_theta"), "no column q_theta"),
        (lambda t: t.drop(columns="v_x"), "no column v_x"),
        (lambda t: t.drop(columns="t"), "no column t"),
        (lambda t: t.drop(columns="trajectory").iloc[:9], "number trajectories apart"),
        (lambda t: t.assign(t=2 * t["t"]), "a sample every 0.1 s"),
        (lambda t: t[(t["t"] < 0.19) | (t["t"] > 0.32)], "nothing is left for train; train: gaps"),
        (
            lambda t: (
                t.iloc[[*range(9), *range(60)]]
                .assign(v_x=range(69))
                .sort_values(["trajectory", "t"])
            ),
            "9 of 69 rows",
        ),
        (
            lambda t: t.assign(t=t["t"] + 1.7e9).iloc[[1, 0, *range(2, 10)]],
            "goes back in time after t=1700000000.05; give",
        ),
        (
            lambda t: (
                t.assign(t=t["t"] + 1.7e9).iloc[[0, 1, 1, *range(2, 9)]].assign(v_x=range(10))
            ),
            "first t=1700000000.05; at most",
        ),
        (lambda t: pd.concat([t, t.iloc[:2]]), "trajectory 0 goes back in time after t=0.45"),
        (lambda t: t.assign(q_x=t["q_x"].where(t.index % 9 > 0)), "most of them in column q_x"),
        (lambda t: t.assign(v_x=t["v_x"].where(t.index % 9 > 0, math.inf)), "in column v_x"),
        (lambda t: t.iloc[:0], "has 0 trajectories, too few"),
        (lambda t: t.assign(q_x="high"), "q_x holds values that are not numbers"),
        (lambda t: t.assign(trajectory=t["trajectory"].where(t.index != 3)), "without a traj"),
        (
            lambda t: t.assign(q_theta=(10 * t["t"] + math.pi) % (2 * math.pi) - math.pi),
            "turns q_theta by 5.78 rad",
        ),
        (lambda t: t.iloc[:20], "has 2 trajectories, too few"),
        (lambda t: t.iloc[:2].drop(columns="trajectory"), "the recording has 2 nodes; at least"),
        (
            lambda t: t.iloc[[1, 0, *range(2, 10)]].drop(columns="trajectory"),
            "the recording goes back in time after t=0.05; give each",
        ),
    ],
)
def test_malformed_tables_are_refused_in_one_line(
    change, message: str, table: pd.DataFrame, tmp_path: Path
) -> None:
    path = save(change(table), tmp_path)
    with pytest.raises(ConfigError) as error:
        RecordedData(system=stated("cartpole"), path=path)
    assert message in str(error.value)
    assert str(error.value).startswith(f"data.path={path}")


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ({"n_traj": 5}, "data.n_traj=5: expected a whole number from 1 to 4"),
        ({"input_delay": float("nan")}, "data.input_delay=nan: expected a"),
        *(({"input_delay": x}, f"data.input_delay={x}: expected a") for x in (-1e4, 1e4)),
        ({"input_lag": 1e300}, "data.input_lag=1e+300: expected a"),
    ],
)
def test_settings_out_of_range_are_refused_by_name(
    setting: dict, message: str, table: pd.DataFrame, tmp_path: Path
) -> None:
    with pytest.raises(ConfigError) as error:
        RecordedData(system=stated("cartpole"), path=save(table, tmp_path), **setting)
    assert message in str(error.value)
