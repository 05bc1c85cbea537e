"""Coordinates that start anew at the ends of their range."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from symo_exp.data.table import read_recordings
from symo_exp.errors import ConfigError
from symo_exp.systems.recorded import Recorded

T = 0.01 * np.arange(2000)
PATH = 9.0 * np.sin(0.9 * T) + 4.0 * np.sin(2.3 * T) + 0.5 * T
TURN = 2.0 * np.pi


def strokes(noise: float) -> np.ndarray:
    """Motions from one end of a rail to the other, from rest to rest, one below the other."""
    one = 0.5 - 0.5 * np.cos(np.pi * np.arange(200) / 199)
    return np.tile(one, 10) + np.random.default_rng(0).normal(0.0, noise, 2000)


def read(q: np.ndarray, folder: Path, **columns: np.ndarray) -> int:
    """Return in how many recordings a table is read."""
    pd.DataFrame({"t": T, "q_0": q, **columns}).to_csv(folder / "x.csv", index=False)
    system = Recorded(time_step=0.01, names=("0",), inputs=(), angular="all")
    return len(read_recordings(folder / "x.csv", system).recordings)


@pytest.mark.parametrize(
    ("q", "period"),
    [
        (np.arctan(np.tan(PATH)), "3.14"),
        ((PATH / TURN) % 1.0, "1"),  # turns
        (PATH % (TURN / 5.0), "1.25"),  # a motor behind a gear
        (np.round(PATH / TURN * 4096) % 4096, "4096"),
        ((np.round(PATH * 2e4) + 32768) % 65536 - 32768, "65536"),  # a register of 16 bits
        (PATH % 3.0 + np.random.default_rng(0).normal(0.0, 1e-3, len(T)), "3"),
    ],
)
def test_a_coordinate_that_starts_anew_is_refused_with_the_period(
    q: np.ndarray, period: str, tmp_path: Path
) -> None:
    """Models would be trained on the jumps, or a recording would end at each."""
    with pytest.raises(ConfigError, match=rf"q_0 starts anew .* numpy.unwrap\(x, period={period}"):
        read(q, tmp_path)
    assert read(np.unwrap(q, period=float(period)), tmp_path) == 1


@pytest.mark.parametrize(
    ("q", "count"),
    [
        ((PATH + np.pi) % TURN - np.pi, 1),  # data.wrapped is for these
        (np.degrees(PATH) % 360.0, 1),
        (np.floor(T) % 2.0, 1),  # two places only
        (strokes(1e-9), 10),
        (strokes(1e-4), 10),
        (np.sin(T), 1),
        (np.where(np.arange(2000) % 300 == 77, 0.0, 3.0 + np.sin(T)), 1),  # a sensor that fails
    ],
)
def test_other_jumps_do_not_count(q: np.ndarray, count: int, tmp_path: Path) -> None:
    assert read(q, tmp_path) == count


def test_recordings_that_are_numbered_do_not_start_anew(tmp_path: Path) -> None:
    q = np.tile(np.linspace(0.0, 1.0, 200), 10) + 0.01 * np.sin(T)
    with pytest.raises(ConfigError, match="number them in a column trajectory"):
        read(q, tmp_path)
    assert read(q, tmp_path, trajectory=np.arange(2000) // 200) == 10
