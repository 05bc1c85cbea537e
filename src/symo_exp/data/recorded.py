"""A user's own recordings, read from Parquet or CSV."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, NamedTuple, final

import numpy as np
import pandas as pd
import torch

from symo_exp.data.base import DataModule, Splits
from symo_exp.errors import ConfigError
from symo_exp.mechanics.types import Coordinates, Trajectories
from symo_exp.systems.base import System
from symo_exp.systems.checks import whole

TIME_TOLERANCE = 1e-3
"""How far a recorded step may be from ``system.time_step``, as a share of it."""


class Recording(NamedTuple):
    """One recorded trajectory: its label and arrays (T, n), (T, n), (T, m)."""

    label: object
    q: np.ndarray
    v: np.ndarray
    u: np.ndarray


@final
class RecordedData(DataModule):
    """Recorded trajectories in the place of simulated ones.

    ``path`` is a ``.parquet`` or ``.csv`` table with one row a node and the columns

    - ``trajectory``: which trajectory the row belongs to, a number or a name;
    - ``t``: time [s], in equal steps of ``system.time_step``;
    - ``q_<name>``: one for each coordinate of the system; angles [rad] must not be wrapped;
    - ``v_<name>``: velocities; without any, central differences of the positions;
    - ``u_0``, ``u_1``, …: the controls at the nodes; without any, zero.

    Trajectories count in the order in which they first appear: the last ``n_test`` are for
    testing, the ``n_val`` before them for validation, and training takes the first ``n_traj`` of
    the others (``None``: all). They must be equally long, unless ``segment`` cuts each into pieces
    of that many nodes which overlap by two, so that no window is lost but in a last, shorter
    piece; ``n_traj`` counts trajectories before they are cut, ``base`` (the other arguments of
    ``DataModule``) after. Rollouts are held against the first
    ``n_integration`` test trajectories, uncut, up to the end of the shortest.
    """

    recorded = True

    def __init__(
        self,
        *,
        system: System,
        path: str | os.PathLike[str],
        n_traj: int | None = None,
        n_val: int = 1,
        n_test: int = 1,
        n_integration: int = 16,
        segment: int | None = None,
        **base: Any,
    ) -> None:
        whole("data.n_val", n_val)
        whole("data.n_test", n_test)
        whole("data.n_integration", n_integration)
        if segment is not None:
            whole("data.segment", segment, low=3)
        recordings = read(path, system)
        available = len(recordings) - n_val - n_test
        if available < 1:
            raise ConfigError(
                f"data.path={path} has {len(recordings)} trajectories, too few for "
                f"data.n_val={n_val}, data.n_test={n_test} and at least one to train on"
            )
        n_traj = whole("data.n_traj", available if n_traj is None else n_traj, high=available)
        test = recordings[-n_test:]
        shortest = min(len(r.q) for r in test[:n_integration])
        self._splits = Splits(
            train=_stack(recordings[:n_traj], segment, "training"),
            val=_stack(recordings[available : available + n_val], segment, "validation"),
            test=_stack(test, segment, "test"),
            integration=_trajectories(_cut(test[:n_integration], shortest)),
        )
        super().__init__(n_traj=self.counts["train"], **base)

    @property
    def counts(self) -> dict[str, int]:
        return {name: len(split.q) for name, split in self._splits._asdict().items()}

    def load(self) -> Splits:
        return self._splits


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


def read(path: str | os.PathLike[str], system: System) -> list[Recording]:
    """The trajectories of a table in order of appearance; anything amiss is a ``ConfigError``."""
    table = _table(Path(path).expanduser())
    where = f"data.path={path}"
    names = system.coordinates.names
    q_columns = [f"q_{name}" for name in names]
    v_columns = [f"v_{name}" for name in names]
    u_columns = [f"u_{i}" for i in range(system.input_matrix.shape[1])]
    v_given = any(column in table for column in v_columns)
    u_given = any(column in table for column in u_columns)
    wanted = ["t", *q_columns, *(v_columns if v_given else []), *(u_columns if u_given else [])]
    missing = [column for column in ["trajectory", *wanted] if column not in table]
    if missing:
        raise ConfigError(
            f"{where}: no column {', '.join(missing)}; it has {', '.join(map(str, table.columns))}"
        )
    if table["trajectory"].isna().any():
        raise ConfigError(f"{where}: rows without a trajectory")
    for column in wanted:
        try:
            values = table[column].to_numpy(dtype=np.float64, na_value=np.nan)
        except (ValueError, TypeError):
            raise ConfigError(
                f"{where}: column {column} holds something that is no number"
            ) from None
        bad = np.flatnonzero(~np.isfinite(values))
        if len(bad):
            raise ConfigError(
                f"{where}: column {column} is empty or not finite in {len(bad)} row(s), "
                f"first in data row {bad[0] + 1}"
            )
        table[column] = values
    recordings = []
    for label, rows in table.groupby("trajectory", sort=False):
        rows = rows.sort_values("t", kind="stable")
        _check_times(where, label, rows["t"].to_numpy(), system.time_step)
        q = rows[q_columns].to_numpy()
        _check_angles(where, label, q, system.coordinates)
        recordings.append(
            Recording(
                label,
                q,
                rows[v_columns].to_numpy() if v_given else central_differences(q, system.time_step),
                rows[u_columns].to_numpy() if u_given else np.zeros((len(q), len(u_columns))),
            )
        )
    return recordings


def central_differences(q: np.ndarray, h: float) -> np.ndarray:
    """``(q_{k+1} − q_{k−1}) / 2h``, and one-sided of second order at both ends."""
    return np.asarray(np.gradient(q, h, axis=0, edge_order=2))


def _table(path: Path) -> pd.DataFrame:
    if path.suffix not in (".parquet", ".csv"):
        raise ConfigError(f"data.path={path}: expected a file that ends in .parquet or .csv")
    try:
        return pd.read_csv(path) if path.suffix == ".csv" else pd.read_parquet(path)
    except (OSError, ValueError, UnicodeDecodeError) as error:  # those of pandas and Arrow too
        reason = getattr(error, "strerror", None) or str(error).splitlines()[0]
        raise ConfigError(f"data.path={path}: cannot be read ({reason})") from error


def _check_times(where: str, label: object, t: np.ndarray, h: float) -> None:
    if len(t) < 3:
        raise ConfigError(f"{where}: trajectory {label} has {len(t)} node(s); a sample needs 3")
    gaps = np.diff(t)
    worst = int(np.argmax(np.abs(gaps - h)))
    if abs(gaps[worst] - h) > TIME_TOLERANCE * h:
        raise ConfigError(
            f"{where}: trajectory {label} steps by {gaps[worst]:.6g} s at t={t[worst]:.6g}, "
            f"but system.time_step={h:g}; set system.time_step or resample to equal steps"
        )


def _check_angles(where: str, label: object, q: np.ndarray, coordinates: Coordinates) -> None:
    for name, angular, turn in zip(*coordinates, np.abs(np.diff(q, axis=0)).max(0), strict=True):
        if angular and turn > np.pi:
            raise ConfigError(
                f"{where}: trajectory {label} turns q_{name} by {turn:.3g} rad in one step; angles "
                "must not be wrapped (numpy.unwrap mends them) and be in radians"
            )


def _stack(recordings: list[Recording], segment: int | None, purpose: str) -> Trajectories:
    if segment is None:
        lengths = sorted({len(r.q) for r in recordings})
        if len(lengths) > 1:
            raise ConfigError(
                f"data.segment=null, but the {purpose} trajectories have {lengths[0]} to "
                f"{lengths[-1]} nodes; set data.segment to cut them into equal pieces"
            )
        return _trajectories(recordings)
    pieces = _cut(recordings, segment)
    if not pieces:
        raise ConfigError(
            f"data.segment={segment}: no {purpose} trajectory has as many nodes, "
            f"the longest has {max(len(r.q) for r in recordings)}"
        )
    return _trajectories(pieces)


def _cut(recordings: list[Recording], nodes: int) -> list[Recording]:
    """Pieces of ``nodes`` nodes; the next begins two nodes before the end of the last."""
    return [
        Recording(r.label, *(field[start : start + nodes] for field in r[1:]))
        for r in recordings
        for start in range(0, len(r.q) - nodes + 1, nodes - 2)
    ]


def _trajectories(recordings: list[Recording]) -> Trajectories:
    fields = zip(*(recording[1:] for recording in recordings), strict=True)
    return Trajectories(*(torch.from_numpy(np.stack(field)) for field in fields))
