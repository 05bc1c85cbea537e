"""Figures of motions: over time, in phase space, learned quantities, and drift.

Their data are the tables of studies, with a row for each node (``Rollouts.columns``).
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Mapping
from dataclasses import replace
from itertools import chain, repeat
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pandas as pd

from symo_exp.report.figures import Figure, Panel
from symo_exp.report.looks import (
    Pair,
    all_angles,
    axis_label,
    in_order,
    inertia_unit,
    pair_name,
    unit_choices,
)
from symo_exp.report.runs import local_folder, run_table
from symo_exp.runs.folder import STUDIES
from symo_exp.tracking.store import Store, connect

if TYPE_CHECKING:
    from torch import Tensor

POINTS = 600
"""Largest number of points of a line."""
TITLES = {
    "test_trajectory": "a motion without input",
    "long_term": "a long motion without input",
    "forced": "a motion under a sinusoidal input of 10 s",
    "forced_fast": "a motion under a sinusoidal input of 2 s",
}
LEARNED = "learned_quantities"
FIRST = "The run of the lowest seed of each method; the first of its motions, from one start."
LONG = 10.0
"""Time of a motion that is shown [s]: more oscillations cannot be told apart."""
LOST = 1.5
"""Velocity of a prediction, over the largest true one, from which it counts as lost."""
Tables = Mapping[Pair, pd.DataFrame]


class Studied(NamedTuple):
    """Tables of one study of a system, by method and integrator.

    ``angular`` says whether all coordinates are angles, ``None`` if only some are or it is unknown.
    """

    study: str
    system: str
    time_step: float
    tables: Tables
    angular: bool | None = None


def motion_figures(runs: pd.DataFrame, drifting: pd.DataFrame, store: Store | None) -> list[Figure]:
    """Return the figures of all studies.

    Args:
        runs: Runs of learned models.
        drifting: Runs of true systems, for the study ``drift``.
        store: Where the files of studies are, unless in folders.
    """
    made: list[Figure] = []
    for one in studied(runs, (*TITLES, LEARNED), store):
        key, tables = f"{one.study}_{one.system}", first(one.tables)
        long = max(table.t.max() for table in tables.values())
        if one.study == LEARNED:
            title = f"{one.system}: what was learned, along a true motion"
            made.append(learned_figure(key, title, tables, repeat(one.angular)).of(one.system))
        else:
            title = f"{one.system}: {TITLES[one.study]}, the first {long:g} s"
            made.append(motion_figure(key, title, tables, one.angular).of(one.system))
        if one.study == "long_term":
            title = f"{one.system}: phase space of a long motion"
            whole = phase_space_figure(
                f"{key}_phase_space", title, first(one.tables, np.inf), one.angular
            )
            made.append(whole.of(one.system))
    return [*made, *drift_figures(studied(drifting, ["drift"], store))]


def studied(runs: pd.DataFrame, names: Iterable[str], store: Store | None) -> list[Studied]:
    """Return the studies of the runs: for each system and method that of the lowest seed.

    Runs without its file are passed over: it is gone, or the measure of a study with a longer name,
    such as ``forced_fast``, begins in the same way.
    """
    found = []
    for name in names:
        told = runs[runs.metric.str.startswith(f"{name}_") & (runs.files != "")]
        told = told.drop_duplicates("run_id").sort_values("seed", kind="stable")
        for (system, time_step), here in told.groupby(["system", "time_step"]):
            tables: dict[Pair, pd.DataFrame] = {}
            for row in here.to_dict("records"):
                pair = row["method"], row["integrator"]
                if pair in tables:
                    continue
                table = _read(store, row["run_id"], row["files"], name)
                if table is not None:
                    tables[pair] = table
            if tables:
                tables = {pair: tables[pair] for pair in sorted(tables, key=in_order)}
                same = runs[runs.run_id.isin(here.run_id)]
                angular = all_angles(same.metric, same.value)
                found.append(Studied(name, str(system), float(time_step), tables, angular))
    return found


def motion_figure(key: str, title: str, tables: Tables, angular: bool | None = None) -> Figure:
    """Return the coordinates, the squared error of the configuration and the energy over time."""
    names = coordinates(next(iter(tables.values())))
    tables = {pair: kept(table) for pair, table in tables.items()}
    panels = [
        over_time(tables, f"q_{name}", f"q_true_{name}", axis_label(name, angular=angular))
        for name in names
    ]
    errors = {pair: _with_error(table, names) for pair, table in tables.items()}
    units = sorted({unit for name in names for unit in unit_choices(name, angular)})
    label = f"squared error [{', '.join(f'{unit}²' for unit in units)}]"
    panels.append(over_time(errors, "squared_error", None, label, log=True))
    panels.append(over_time(tables, "energy", "energy_true", "energy [J]"))
    return Figure(key, title, FIRST, panels)


def _with_error(table: pd.DataFrame, names: list[str]) -> pd.DataFrame:
    """Return the table with ``squared_error``, which those of earlier versions do not have."""
    if "squared_error" in table:
        return table
    error = sum((table[f"q_{name}"] - table[f"q_true_{name}"]) ** 2 for name in names)
    return table.assign(squared_error=error / len(names))


def phase_space_figure(key: str, title: str, tables: Tables, angular: bool | None = None) -> Figure:
    """Return a panel for each method, with the truth below it; what may be an angle is wrapped."""
    name = coordinates(next(iter(tables.values())))[0]
    labels = axis_label(name, angular=angular), axis_label(name, velocity=True, angular=angular)
    wrap = "rad" in unit_choices(name, angular)
    panels = [
        Panel(pair_name(*pair), *labels,
              phase_rows(pair, kept(table), name, wrap=wrap, count=POINTS),
              y_log=False, mark="points")
        for pair, table in tables.items()
    ]  # fmt: skip
    return Figure(key, title, FIRST + " Angles are wrapped." * wrap, panels)


def learned_figure(
    key: str, title: str, tables: Tables, angular: Iterable[bool | None] = ()
) -> Figure:
    """Return learned and true energies and inertia along a true motion.

    Args:
        key: The name of the files.
        title: The heading.
        tables: A table for each method, with the columns of ``beside_true``.
        angular: Which coordinates are angles; by their names if not given.
    """
    table = next(iter(tables.values()))
    known = list(zip(coordinates(table, "q_"), chain(angular, repeat(None)), strict=False))

    def unit(entry: str) -> str:
        # inertia_23; from ten coordinates on, two digits are not told apart
        rows = [int(digit) - 1 for digit in entry.removeprefix("inertia_")]
        at = [known[i] for i in rows if i < len(known)]
        return inertia_unit(*at) if len(at) == 2 else "kg, kg m, kg m²"

    panels = [
        over_time(
            tables, column, f"{column}_true", f"{column.replace('inertia_', 'H')} [{unit(column)}]",
            column.replace("_", " H"),
        )
        if column.startswith("inertia")
        else over_time(tables, column, f"{column}_true", f"{column} energy [J]")
        for column in map(str, table) if f"{column}_true" in table
    ]  # fmt: skip
    return Figure(key, title, f"{FIRST} Potentials are shifted by a constant each.", panels)


def drift_figures(found: Iterable[Studied]) -> Iterable[Figure]:
    """Yield figures of the true systems over small and large steps: energy error and volume."""
    found = sorted(found, key=lambda one: (one.system, one.time_step))
    caption = (
        "Above: difference of the energy from the initial one. Below: a small volume around the "
        "initial state, carried along; a symplectic integrator preserves it."
    )
    for system in dict.fromkeys(one.system for one in found):
        above, below = [], []
        for one in (one for one in found if one.system == system):
            rows = {
                pair: table.assign(
                    lost=(table.energy - table.energy_true).abs(), volume=np.exp(table.log_volume)
                )
                for pair, table in first(one.tables, np.inf).items()
            }
            step = f"step {one.time_step:g} s"
            above.append(over_time(rows, "lost", None, "energy error [J]", step, log=True))
            below.append(over_time(rows, "volume", None, "phase-space volume, relative", step))
        title = f"{system}: the true system in integrators, small steps and large"
        whole = Figure(f"drift_{system}", title, caption, above + below, columns=len(above))
        yield whole.of(system)


def over_time(
    tables: Tables, column: str, truth: str | None, label: str, title: str = "", *,
    log: bool = False,
) -> Panel:  # fmt: skip
    """Return a column of every table over time.

    Args:
        tables: A table for each method.
        column: The column of the predictions.
        truth: The column of the truth, in the first table.
        label: The label of the y axis.
        title: The heading.
        log: Whether the y axis is logarithmic.
    """
    parts = [points(table.t, table[column], pair) for pair, table in tables.items()]
    if truth is not None:
        table = next(iter(tables.values()))
        parts.insert(0, points(table.t, table[truth]))
    return Panel(title, "time [s]", label, pd.concat(parts), y_log=log, mark="line")


def phase_rows(
    pair: Pair, table: pd.DataFrame, name: str, *, wrap: bool, count: int | None = None
) -> pd.DataFrame:
    """Return a coordinate and its velocity, of the truth and of a model.

    Args:
        pair: The method and the integrator of the model.
        table: The motions.
        name: The name of the coordinate.
        wrap: Whether it is an angle that is wrapped.
        count: The number of points of a cloud; lines if not given, with gaps where an angle jumps
            and where another trajectory begins.
    """
    parts = []
    for who, field in ((None, "_true"), (pair, "")):
        pieces = []
        for _, one in table.groupby("trajectory", sort=False):
            x, y = one[f"q{field}_{name}"].to_numpy(), one[f"v{field}_{name}"].to_numpy()
            if wrap and count is None:
                x, y = unbroken(x, y)
            elif wrap:
                x = wrapped(x)
            pieces += [(x, y), ([np.nan], [np.nan])]
        x, y = (np.concatenate(side) for side in zip(*pieces, strict=True))
        parts.append(points(x, y, who, count or len(x)))
    return pd.concat(parts)


def points(x: Iterable, y: Iterable, pair: Pair | None = None, count: int = POINTS) -> pd.DataFrame:
    """Return ``count`` to twice as many points of a model, or of the truth without a pair.

    Those of a longer line are at equal distances.
    """
    table = pd.DataFrame({"x": x, "y": y})
    table = table.iloc[:: max(1, len(table) // count)]
    method, integrator = pair or ("", "")
    source = "ours" if pair else "truth"
    return table.assign(method=method, integrator=integrator, source=source)


def kept(table: pd.DataFrame) -> pd.DataFrame:
    """Return the motions, with predictions only until they are lost."""
    names = coordinates(table)
    gone = pd.Series(False, index=table.index)
    for name in names:
        fastest = table[f"v_true_{name}"].abs().max() or 1.0
        gone |= ~(table[f"v_{name}"].abs() <= LOST * fastest)  # NaN is lost, too
    gone = gone.groupby(table.trajectory).cummax()
    predicted = [c for n in names for c in (f"q_{n}", f"v_{n}")] + ["energy", "squared_error"]
    own = [column for column in predicted if column in table]
    return table.assign(**{column: table[column].mask(gone) for column in own})


def wrapped(angle: np.ndarray) -> np.ndarray:
    """Return angles in (−π, π]."""
    finite = np.where(np.isfinite(angle), angle, np.nan)
    return np.asarray(np.pi - np.mod(np.pi - finite, 2 * np.pi))


def unbroken(angle: np.ndarray, other: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return wrapped angles for a line, and another quantity at the same nodes.

    Where an angle jumps, the line is continued to ±π on both sides, with a gap between them: three
    nodes are added, at which the other quantity is interpolated.
    """
    values = wrapped(angle)
    with np.errstate(invalid="ignore"):
        at = np.flatnonzero(np.abs(np.diff(values)) > np.pi)
        turn = wrapped(np.diff(values)[at])  # the shorter way; 0 from one edge to the other
        edge = np.copysign(np.pi, turn)
        between = other[at] + (edge - values[at]) / turn * np.diff(other)[at]
    added = np.stack([edge, np.full_like(edge, np.nan), -edge], axis=1).ravel()
    places = np.repeat(at + 1, 3)
    return np.insert(values, places, added), np.insert(other, places, np.repeat(between, 3))


def wrapped_lines(panel: Panel) -> Panel:
    """Return a panel of an angle over time with wrapped lines."""
    parts = []
    for _, rows in panel.rows.groupby("source", sort=False):
        y, x = unbroken(rows.y.to_numpy(dtype=float), rows.x.to_numpy(dtype=float))
        looks = rows[["method", "integrator", "source"]].iloc[0]
        parts.append(pd.DataFrame({"x": x, "y": y}).assign(**looks.to_dict()))
    return replace(panel, rows=pd.concat(parts))


def coordinates(table: pd.DataFrame, prefix: str = "q_true_") -> list[str]:
    """Return the names of the coordinates; tables of learned quantities have the prefix ``q_``."""
    return [c.removeprefix(prefix) for c in map(str, table) if c.startswith(prefix)]


def first(tables: Tables, seconds: float = LONG) -> Tables:
    """Return the first motion of each table, until ``seconds``."""
    return {pair: t[(t.trajectory == 0) & (t.t <= seconds)] for pair, t in tables.items()}


def ranking(errors: Tensor) -> dict[str, int]:
    """Return the indices of the motions that are predicted ``best``, ``median`` and ``worst``.

    There is always a median; of fewer than three motions, the others only if they differ from it.
    """
    order = errors.argsort(stable=True).tolist()
    middle = order[(len(order) - 1) // 2]
    found = {"best": order[0], "median": middle, "worst": order[-1]}
    return {which: at for which, at in found.items() if which == "median" or at != middle}


def ranked_as(which: str, count: int) -> str:
    """Return the rank of a motion among ``count`` as the start of a title."""
    return f"{which} of {count}: " if count > 1 else ""


def _read(store: Store | None, run_id: str, files: str, study: str) -> pd.DataFrame | None:
    """Read the table of a study from a folder, or else through the store."""
    name = f"{STUDIES}/{study}.parquet"
    if (folder := local_folder(files)) is not None:
        return run_table(folder / name)
    if store is None:
        return None
    with tempfile.TemporaryDirectory(prefix="symo_exp-") as copy:
        try:
            return pd.read_parquet(connect(store).download_artifacts(run_id, name, copy))
        except Exception:  # the file is gone or the server away: there is no figure
            return None
