"""Shocks are found in the motions of known systems, and left out of recordings."""

from __future__ import annotations

import json
import logging
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch

from symo_exp.data.recorded import RecordedData, recorded_system
from symo_exp.data.resample import LONGEST_GAP
from symo_exp.data.shocks import shocks
from symo_exp.data.table import read_recordings
from symo_exp.errors import ConfigError
from symo_exp.identify.recordings import examine
from symo_exp.mechanics.types import Coordinates
from symo_exp.systems.chain import ChainPendulum
from symo_exp.systems.simulation import Solver, simulate

H = 0.02
BEGIN, END = 2.0, 2.2
STRUCK = 1
"""The motion in which a machine is struck."""


@cache
def motions(n: int, blow: float, count: int = 6, steps: int = 300) -> list[pd.DataFrame]:
    """Of a chain that smooth torques drive, one of them struck by a torque that is not recorded."""
    system = ChainPendulum(n, time_step=H)
    q0, v0, _ = system.box.points(count, 1)
    wave = torch.arange(1, n + 1).double()

    def recorded(t: float) -> torch.Tensor:
        return (5.0 * torch.sin(2 * t * (1 + 0.3 * wave) + wave)).expand(count, n)

    def drive(t: float) -> torch.Tensor:
        struck = torch.zeros(count, n, dtype=torch.float64)
        struck[STRUCK] = blow * (BEGIN <= t < END)
        return recorded(t) + struck

    solver = Solver("DOP853", 1e-6, 1e-6)
    q, _, _ = simulate(system, 0.5 * q0, 0.3 * v0, drive, steps, solver)
    t = H * np.arange(q.shape[1])
    u = np.stack([recorded(at).numpy() for at in t], axis=1)
    rng = np.random.default_rng(0)
    frames = []
    for k in range(count):
        angles = q[k].numpy() + 1e-4 * rng.standard_normal((len(t), n))
        columns = {"trajectory": f"run's {k}", "t": t}
        columns |= {f"q_theta_{i}": angles[:, i] for i in range(n)}
        columns |= {f"u_{i}": u[k][:, i] for i in range(n)}
        frames.append(pd.DataFrame(columns))
    return frames


def found(frames: list[pd.DataFrame], n: int) -> list[list[tuple[int, int]]]:
    pairs = [(f.filter(like="q_").to_numpy(), f.filter(like="u_").to_numpy()) for f in frames]
    return shocks(pairs, ChainPendulum(n, time_step=H).coordinates, H)


@pytest.mark.parametrize("blow", [pytest.param(0.0, marks=pytest.mark.slow), 60.0])
def test_a_blow_is_found_and_nothing_else(blow: float) -> None:
    runs = found(motions(1, blow), 1)
    assert [k for k, each in enumerate(runs) if each] == [STRUCK] * bool(blow)
    if blow:
        ((first, last),) = runs[STRUCK]
        assert H * first <= BEGIN
        assert H * last >= END
        assert H * (last - first) < 2 * (END - BEGIN) + 10 * H


@pytest.mark.parametrize("blow", [0.0, 60.0])
@pytest.mark.parametrize("angular", [False, True])
@pytest.mark.parametrize("share", [0.0, pytest.param(0.01, marks=pytest.mark.slow), 0.1])
def test_a_coordinate_that_never_moves_hides_no_shock_and_adds_none(
    share: float, angular: bool, blow: float
) -> None:
    """But for rounding errors of a share of its samples; it has another place in each motion."""
    frames, rng, pairs = motions(1, blow), np.random.default_rng(0), []
    for k, frame in enumerate(frames):
        place, q = 0.3 + 0.1 * k, frame.filter(like="q_").to_numpy()
        rounded = np.where(rng.random((len(q), 1)) < share, np.nextafter(place, 9.0), place)
        pairs.append((np.concatenate([rounded, q], axis=1), frame.filter(like="u_").to_numpy()))
    runs = shocks(pairs, Coordinates(("still", "link"), (angular, True)), H)
    expected = found(frames, 1)
    assert [len(each) for each in runs] == [len(each) for each in expected]
    if blow:
        np.testing.assert_allclose(runs[STRUCK], expected[STRUCK], rtol=0.0, atol=2)


@pytest.mark.parametrize("n", [2, pytest.param(3, marks=pytest.mark.slow)])
def test_machines_that_nothing_strikes_have_no_shocks(n: int) -> None:
    assert not any(found(motions(n, 0.0), n))


def test_a_slide_that_sticks_while_a_link_swings_has_no_shocks() -> None:
    """Dry friction of up to 5 N holds it when the force is reduced from 6.5 to 4.5 N."""
    count, substeps = 6, 20
    rng, h = np.random.default_rng(0), H / substeps
    q, v = rng.uniform(-1, 1, (count, 2)), np.zeros((count, 2))
    phase, rows = rng.uniform(0, 6, count), []
    for t in H * np.arange(300):
        force = 6.5 * np.tanh(4 * np.sin(2 * t + phase))
        force[STRUCK] *= 0.7 if BEGIN <= t < BEGIN + 0.8 else 1.0
        rows.append(np.column_stack([q + 1e-4 * rng.standard_normal(q.shape), force]))
        for _ in range(substeps):
            v[:, 1] -= h * 20.0 * np.sin(q[:, 1])
            pushed = v[:, 0] + h * force
            v[:, 0] = np.sign(pushed) * np.maximum(np.abs(pushed) - 5.0 * h, 0.0)
            q = q + h * v
    names, angular = ("slide", "link"), (False, True)
    motions = [(each[:, :2], each[:, 2:]) for each in np.stack(rows, axis=1)]
    assert not any(shocks(motions, Coordinates(names, angular), H))


@pytest.mark.parametrize("pace", [1.0, 1e-4])
def test_a_blow_is_left_out_of_the_search_and_it_says_so(pace, workplace) -> None:
    """Also of a machine whose time step is 2 µs."""
    table = pd.concat(motions(1, 60.0))
    table.assign(t=pace * table.t).to_csv("mine.csv", index=False)
    told = examine({"path": "mine.csv", "time_unit": "s"})
    (setting,) = [one for one in told.settings if one.startswith("data.leave_out")]
    ((name, low, high),) = json.loads(setting.partition("=")[2])
    assert name == "run's 1"
    assert 1.9 * pace <= low < 2.0 * pace < 2.2 * pace < high < 2.4 * pace
    assert any("left out: run's 1" in note for note in told.notes)
    kept = examine({"path": "mine.csv", "time_unit": "s", "leave_out": []})
    assert not any("leave_out" in one for one in kept.settings)
    assert told.explained > kept.explained
    assert told.seconds < kept.seconds
    again = examine({"path": "mine.csv", "time_unit": "s", "leave_out": [[name, low, high]]})
    assert (again.seconds, again.explained) == (told.seconds, told.explained)


def read(frames: list[pd.DataFrame], path: Path, leave_out: object) -> RecordedData:
    pd.concat(frames).to_parquet(path, index=False)
    system = recorded_system(path, time_step=H, angular="all")
    data = RecordedData(system=system, path=path, dtype="float64", leave_out=leave_out)
    data.setup()
    return data


@pytest.mark.parametrize("length", [0.0, 0.5])
def test_nothing_is_interpolated_over_what_is_left_out(length, tmp_path, caplog) -> None:
    frames = [f.assign(t=f.t + 1000.0) for f in motions(1, 0.0, count=3)]
    with caplog.at_level(logging.INFO):
        data = read(frames, tmp_path / "x.parquet", [["run's 0", 2.0, 2.0 + length]])
    pieces = data.trajectories("train")
    assert len(pieces) == 2
    left_out = max(length / 2, LONGEST_GAP * H)
    assert H * len(pieces[0].q) == pytest.approx(2.0 + length / 2 - left_out, abs=2 * H)
    assert sum(len(one.q) for one in pieces) == pytest.approx(300 - 2 * left_out / H, abs=3)
    assert any("are cut there" in r.getMessage() for r in caplog.records)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ("2", "expected [[NAME,FROM,TO],...]"),
        ([["run's 9", 0, 1]], "of run's 0, run's 1"),
        ([[0, 1]], "of run's 0, run's 1"),
        ([["run's 0", 2, 1]], "expected [[NAME,FROM,TO],...]"),
        ([["run's 0", "a", 1]], "expected [[NAME,FROM,TO],...]"),
        ([["run's 0", 0, 99]], "leaves nothing of trajectory run's 0"),
    ],
)
def test_stretches_that_are_none_are_refused(given, message, tmp_path) -> None:
    with pytest.raises(ConfigError) as error:
        read(motions(1, 0.0, count=3), tmp_path / "x.parquet", given)
    assert message in str(error.value)


def test_a_table_is_read_once_although_it_is_divided_several_times(workplace, monkeypatch) -> None:
    times = []

    def read(*given):
        times.append(given)
        return read_recordings(*given)

    monkeypatch.setattr("symo_exp.identify.recordings.read_recordings", read)
    pd.concat(motions(1, 60.0)).to_csv("mine.csv", index=False)
    assert any("leave_out" in one for one in examine({"path": "mine.csv"}).settings)
    assert len(times) == 1
