"""A table of recordings: read, checked, and taken apart into trajectories."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
import pyarrow.parquet

from symo_exp.data.header import KINDS, OTHERS, few, header, located, readable
from symo_exp.data.resample import Samples
from symo_exp.errors import ConfigError
from symo_exp.mechanics.types import Coordinates, Trajectories
from symo_exp.systems.base import System


class Recording(NamedTuple):
    """One recorded trajectory: its name, its part (``""``: none is given) and its samples."""

    label: str
    part: str
    samples: Samples


class Table(NamedTuple):
    """The trajectories in order of appearance, and the columns that were not read."""

    recordings: tuple[Recording, ...]
    unread: tuple[str, ...]


def read(
    path: str | os.PathLike[str], system: System, columns: Mapping[str, str] | None = None
) -> Table:
    """The trajectories of a table, times rising; anything amiss is a ``ConfigError``."""
    found = header(path, columns)
    file = located(path)
    with readable(path):
        version = file.stat().st_mtime_ns
    return _read(str(path), file, version, tuple(found), system.coordinates, tuple(system.inputs))


@lru_cache(maxsize=4)  # the jobs of a sweep share it
def _read(
    path: str, file: Path, version: int, found: tuple[str, ...], coordinates: Coordinates,
    inputs: tuple[str, ...],
) -> Table:  # fmt: skip
    where = f"data.path={path}"
    wanted = {kind: [f"{kind}_{name}" for name in coordinates.names] for kind in "qv"}
    wanted["u"] = [f"u_{name}" for name in inputs]
    _check_places(where, found, wanted)
    for kind in "vu":  # these may be absent, all of them
        if not set(wanted[kind]) & set(found):
            wanted[kind] = []
    numbers = ["t", *wanted["q"], *wanted["v"], *wanted["u"]]
    if missing := [column for column in numbers if column not in found]:
        raise ConfigError(f"{where}: no column {', '.join(missing)}; it has {few(found)}")
    with readable(path):
        if file.suffix == ".csv":
            table = pd.read_csv(file)
        else:  # an index that was written along is a column like others
            table = pyarrow.parquet.read_table(file).to_pandas(ignore_metadata=True)
        table.columns = pd.Index(found)
    for column in numbers:
        table[column] = _numbers(where, column, table[column])
    columns = Columns(where, wanted, len(inputs))
    known = {*numbers, *OTHERS}
    unread = [c.lstrip(".") for c in found if c not in known and c[:8] != "__index_"]
    return Table(tuple(columns.apart(table)), tuple(unread))


class Columns(NamedTuple):
    """Which columns hold what; ``inputs`` is the number of inputs, recorded or not."""

    where: str
    wanted: Mapping[str, Sequence[str]]
    inputs: int

    def apart(self, table: pd.DataFrame) -> Iterator[Recording]:
        """The trajectories of a table that is sound as a whole."""
        for column in {"trajectory", "split"} & set(table.columns):
            if table[column].isna().any():
                raise ConfigError(f"{self.where}: rows without a {column}")
        groups = [("", table)] if "trajectory" not in table else _groups(table)
        for label, rows in groups:
            order = np.argsort(rows["t"].to_numpy(), kind="stable")
            _check_times(f"{self.where}: trajectory {label}", rows["t"].to_numpy(), order)
            parts = list(rows["split"].astype(str).unique()) if "split" in rows else [""]
            if len(parts) > 1:
                raise ConfigError(
                    f"{self.where}: trajectory {label} is of the splits {few(parts)}; a "
                    "trajectory belongs to one of them"
                )
            rows = rows.iloc[order]
            fields = {kind: rows[list(names)].to_numpy() for kind, names in self.wanted.items()}
            v = fields["v"] if self.wanted["v"] else None
            u = fields["u"] if self.wanted["u"] else np.zeros((len(rows), self.inputs))
            samples = Samples(rows["t"].to_numpy(), fields["q"], v, u)
            yield Recording(label, str(parts[0]), samples)


def _groups(table: pd.DataFrame) -> list[tuple[str, pd.DataFrame]]:
    try:
        return [(str(name), rows) for name, rows in table.groupby("trajectory", sort=False)]
    except TypeError:
        return [
            (str(n), rows) for n, rows in table.groupby(table["trajectory"].astype(str), sort=False)
        ]


def _check_places(where: str, found: Sequence[str], wanted: Mapping[str, Sequence[str]]) -> None:
    """Refuse columns that look as if they were to be read and are not."""
    for column in found:
        kind = column[0] if column[1:2] == "_" else ""
        if kind in KINDS and column not in wanted[kind]:
            there = few([name[2:] for name in wanted[kind]]) or "none"
            raise ConfigError(
                f"{where}: column {column} is of no {KINDS[kind]} of the system ({there}); rename "
                "it by data.columns or in the file"
            )


def _numbers(where: str, column: str, given: pd.Series) -> np.ndarray:
    try:
        values = given.to_numpy(dtype=np.float64, na_value=np.nan)
    except (ValueError, TypeError):
        raise ConfigError(f"{where}: column {column} holds something that is no number") from None
    bad = np.flatnonzero(~np.isfinite(values))
    if len(bad):
        raise ConfigError(
            f"{where}: column {column} is empty or not finite in {len(bad)} row(s), "
            f"first in data row {bad[0] + 1}"
        )
    return np.asarray(values)


def _check_times(where: str, t: np.ndarray, order: np.ndarray) -> None:
    """Rows may be shuffled, but a clock that was set back tells of two recordings."""
    if len(t) < 3:
        raise ConfigError(f"{where} has {len(t)} node(s); a sample needs 3")
    gaps = np.diff(t[order])
    if not gaps.all():
        at = t[order][int(np.argmin(gaps))]
        raise ConfigError(f"{where} steps by 0 s at t={at:.6g}; each time may be there once")
    back = np.flatnonzero(np.diff(t) < 0)
    if 0 < len(back) < len(t) / 4:
        raise ConfigError(
            f"{where} goes back in time after t={t[back[0]]:.6g}; number recordings apart in the "
            "column trajectory, or sort the rows by t"
        )


def write(
    path: str | os.PathLike[str],
    trajectories: Trajectories,
    coordinates: Coordinates,
    time_step: float,
) -> None:
    """Trajectories as a table that ``read`` takes."""
    count, nodes, _ = trajectories.q.shape
    columns: dict[str, np.ndarray] = {
        "trajectory": np.repeat(np.arange(count), nodes),
        "t": np.tile(time_step * np.arange(nodes), count),
    }
    for field in ("q", "v"):
        values = getattr(trajectories, field).flatten(0, 1).numpy()
        columns |= {f"{field}_{name}": values[:, i] for i, name in enumerate(coordinates.names)}
    u = trajectories.u.flatten(0, 1).numpy()
    columns |= {f"u_{i}": u[:, i] for i in range(u.shape[1])}
    table = pd.DataFrame(columns)
    if Path(path).suffix == ".csv":
        table.to_csv(path, index=False)
    else:
        table.to_parquet(path, index=False)
