"""Five hundred malformed tables: each loads completely or is refused in one line."""

from __future__ import annotations

import contextlib
import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from symo_exp.data.header import header
from symo_exp.data.naming import names
from symo_exp.data.recorded import RecordedData, recorded_system
from symo_exp.errors import ConfigError
from symo_exp.systems.base import System
from symo_exp.systems.chain import ChainPendulum

H = 0.05
Generator = np.random.Generator


def sound(rng: Generator) -> pd.DataFrame:
    n, nodes = int(rng.integers(1, 4)), int(rng.integers(6, 40))
    step = float(rng.choice([H, H / 2, H / 7, 0.9 * H]))
    t = step * np.arange(nodes)
    if rng.random() < 0.5:
        t = t + rng.uniform(-0.2, 0.2, nodes) * step
    tables = []
    for label in range(int(rng.integers(3, 6))):
        columns = {"trajectory": np.full(nodes, label), "t": t}
        for i in range(n):
            columns[f"q_theta_{i + 1}"] = rng.uniform(0, 1) * np.sin((2 + i) * t + label)
        for i in range(n):
            columns[f"u_{i}"] = np.cos(3 * t + i)
        tables.append(pd.DataFrame(columns))
    return pd.concat(tables, ignore_index=True)


def somewhere(value: object) -> Callable[[pd.DataFrame, Generator], pd.DataFrame]:
    """The value in a cell of any column."""

    def change(t: pd.DataFrame, rng: Generator) -> pd.DataFrame:
        column = rng.choice(t.columns)
        t[column] = t[column].astype(object)
        t.loc[t.index[rng.integers(len(t))], column] = value
        return t

    return change


def throughout(value: object) -> Callable[[pd.DataFrame, Generator], pd.DataFrame]:
    """The value all along any column."""
    return lambda t, rng: t.assign(**{str(rng.choice(t.columns)): [value] * len(t)})


def renamed(name: str) -> Callable[[pd.DataFrame, Generator], pd.DataFrame]:
    return lambda t, rng: t.rename(columns={rng.choice(t.columns): name})


def wrapped(t: pd.DataFrame, rng: Generator) -> pd.DataFrame:
    return t.assign(q_theta_1=np.mod(9 * t["t"], 2 * np.pi))


def split(t: pd.DataFrame, rng: Generator) -> pd.DataFrame:
    return t.assign(split=rng.choice(["train", "val", "test", "extra", ""], len(t)))


def split_well(t: pd.DataFrame, rng: Generator) -> pd.DataFrame:
    words = ["train", "val", "test", "extra", "train"]
    return t.assign(split=[words[int(k)] if str(k).isdigit() else "x" for k in t["trajectory"]])


CHANGES: list[Callable[[pd.DataFrame, Generator], pd.DataFrame]] = [
    lambda t, rng: t,
    lambda t, rng: t.drop(columns=str(rng.choice(t.columns))),
    lambda t, rng: t.iloc[:0],
    lambda t, rng: t.iloc[:1],
    lambda t, rng: t.iloc[: int(rng.integers(len(t)))],
    lambda t, rng: t.drop(index=t.index[rng.integers(len(t), size=3)]),
    lambda t, rng: t.sample(frac=1, random_state=1),
    lambda t, rng: pd.concat([t, t.sample(2, replace=True, random_state=1)]),
    lambda t, rng: pd.concat([t, t]),
    lambda t, rng: t[t.columns[::-1]],
    lambda t, rng: t.iloc[::-1],
    lambda t, rng: t.assign(t=t["t"] + 1.7e9),
    lambda t, rng: t.assign(t=-t["t"]),
    lambda t, rng: t.assign(t=1e3 * t["t"]),
    lambda t, rng: t.assign(t=pd.to_datetime(t["t"], unit="s")),
    lambda t, rng: t.assign(t=t["t"].where(t.index % 9 != 5, t["t"] + 1)),
    wrapped, split, split_well,
    *map(somewhere, [np.nan, np.inf, None, "text", "", 1e300, -1, True, 1 + 2j, pd.Timestamp(0)]),
    *map(throughout, [np.nan, None, "1.5", 0, 1e308, True, "a,b\nc", b"bytes", {"a": 1}, [1, 2]]),
    *map(renamed, ["q_other", "v_theta_1", "v_other", "u_7", "q_", "x", "", "t", "split", "Q_a"]),
]  # fmt: skip
GARBAGE = [b"", b"\n", b"\x00" * 99, bytes(range(256)) * 9, b"PAR1" + b"\x07" * 60 + b"PAR1",
           b"q_a\n", b"t,t,q_a\n1,2,3\n", b'"', b"{'t': [1, 2]}", "τ,q_θ\n1,2\n".encode("utf-16"),
           b"trajectory,t,q_a\n" + b"0,1\n" * 4, b"a" * 200_000]  # fmt: skip


def saved(table: pd.DataFrame, rng: Generator, folder: Path) -> Path:
    """As Parquet or, also where that is impossible, as CSV."""
    if rng.random() < 0.5:
        try:
            table.to_parquet(folder / "x.parquet", index=False)
            return folder / "x.parquet"
        except Exception:
            pass
    table.to_csv(folder / "x.csv", index=False, quoting=csv.QUOTE_MINIMAL)
    return folder / "x.csv"


def system_of(path: Path, rng: Generator) -> System:
    if rng.random() < 0.2:
        return ChainPendulum(max(1, min(3, len(names("q", header(path))))), time_step=H)
    return recorded_system(path, time_step=H, angular="all")


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    "seed", [0, 1, *(pytest.param(k, marks=pytest.mark.slow) for k in range(2, 10))]
)
def test_every_table_loads_or_is_refused_in_a_line(seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    ends = {"loaded": 0, "refused": 0}
    for k in range(50):
        if k < 3:
            path = tmp_path / f"garbage{k}.{rng.choice(['csv', 'parquet'])}"
            path.write_bytes(GARBAGE[int(rng.integers(len(GARBAGE)))])
        else:
            table = sound(rng)
            for change in rng.choice(len(CHANGES), size=int(rng.integers(0, 3))):
                with contextlib.suppress(KeyError, TypeError, ValueError):  # one spoils the next
                    table = CHANGES[change](table, rng)
            path = saved(table, rng, tmp_path)
        try:
            data = RecordedData(
                system=system_of(path, rng), path=path, wrapped=bool(rng.random() < 0.2),
                dtype="float64",
            )  # fmt: skip
            data.setup()
        except ConfigError as error:
            if "\n" in str(error) or len(str(error)) > 600:
                pytest.fail(f"{seed}, {k}: {error}")
            ends["refused"] += 1
        else:
            assert all(field.isfinite().all() for field in data.train), (seed, k)
            assert all(len(t.q) >= 3 for t in data.trajectories("train")), (seed, k)
            ends["loaded"] += 1
        path.unlink()
    assert min(ends.values()) >= 5, ends
