"""Figures of motions: over time, in phase space, what was learned, drift.

They are drawn from tables with a row for each node (``Rollouts.columns``), which studies leave
among the files of a run.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple
from urllib.parse import unquote, urlsplit

import numpy as np
import pandas as pd

from symo_exp.report.figures import Figure, Panel
from symo_exp.report.looks import Pair, axis_label, pair_name
from symo_exp.runs.folder import STUDIES
from symo_exp.tracking.store import Store, connect

if TYPE_CHECKING:
    from torch import Tensor

POINTS = 600
"""Of a line at most: more are not seen, and weigh on the page."""
TITLES = {
    "test_trajectory": "a motion without input",
    "long_term": "a long motion without input",
    "forced": "a motion under a sinusoidal input of 10 s",
    "forced_fast": "a motion under a sinusoidal input of 2 s",
}
LEARNED = "learned_quantities"
FIRST = "Each method's run of the lowest seed, from the same start; the first of its motions."
LONG = 10.0
"""Seconds that are shown of a motion."""
LOST = 1.5
"""A prediction that is so many times faster than the truth ever is has nothing more to show."""
Tables = Mapping[Pair, pd.DataFrame]


class Studied(NamedTuple):
    """``tables`` hold the numbers of one study, by what ran it."""

    study: str
    system: str
    time_step: float
    tables: Tables


def motion_figures(runs: pd.DataFrame, drifting: pd.DataFrame, store: Store | None) -> list[Figure]:
    """All figures of the studies that the runs have done; ``drifting`` are those of floors."""
    made: list[Figure] = []
    for one in studied(runs, (*TITLES, LEARNED), store):
        key, tables = f"{one.study}_{one.system}", first(one.tables)
        long = max(table.t.max() for table in tables.values())
        if one.study == LEARNED:
            made.append(
                learned(key, f"{one.system}: what was learned, along a true motion", tables)
            )
        else:
            made.append(motion(key, f"{one.system}: {TITLES[one.study]}, {long:g} s", tables))
        if one.study == "long_term":
            title = f"{one.system}: phase space of a long motion"
            made.append(phase_space(f"{key}_phase_space", title, first(one.tables, np.inf)))
    return [*made, *drift(studied(drifting, ["drift"], store))]


def studied(runs: pd.DataFrame, names: Iterable[str], store: Store | None) -> list[Studied]:
    """The studies of the given runs, of which each method has one a system: the lowest seed.

    Only runs whose measures tell of a study are asked for its file.
    """
    found = []
    for name in names:
        told = runs[runs.metric.str.startswith(f"{name}_") & (runs.files != "")]
        told = told.drop_duplicates("run_id").sort_values("seed", kind="stable")
        for (system, time_step), here in told.groupby(["system", "time_step"]):
            tables = {
                (row["method"], row["integrator"]): table
                for row in here[here.seed == here.seed.min()].to_dict("records")
                if (table := _read(store, row["run_id"], row["files"], name)) is not None
            }
            if tables:
                found.append(Studied(name, str(system), float(time_step), tables))
    return found


def motion(key: str, title: str, tables: Tables) -> Figure:
    """Every coordinate over time, the squared error of the configuration, and the energy."""
    names, tables = coordinates(tables), {pair: kept(table) for pair, table in tables.items()}
    panels = [over_time(tables, f"q_{name}", f"q_true_{name}", axis_label(name)) for name in names]
    errors = {
        pair: table.assign(
            error=sum((table[f"q_{n}"] - table[f"q_true_{n}"]) ** 2 for n in names) / len(names)
        )
        for pair, table in tables.items()
    }
    panels.append(over_time(errors, "error", None, "squared error [m², rad²]", log=True))
    panels.append(over_time(tables, "energy", "energy_true", "energy [J]"))
    return Figure(key, title, FIRST, panels)


def phase_space(key: str, title: str, tables: Tables) -> Figure:
    """A panel for each method, the truth under it; angles are wrapped."""
    name = coordinates(tables)[0]
    labels = axis_label(name), axis_label(name, velocity=True)
    panels = [
        Panel(pair_name(*pair), *labels, phase_rows(pair, table, name, wrap=True, count=POINTS),
              y_log=False, mark="points")
        for pair, table in ((pair, kept(table)) for pair, table in tables.items())
    ]  # fmt: skip
    return Figure(key, title, f"{FIRST} Angles are wrapped.", panels)


def learned(key: str, title: str, tables: Tables) -> Figure:
    """Energies and inertia, learned and true, along a true motion."""
    columns = next(iter(tables.values())).columns
    panels = [
        over_time(tables, column, f"{column}_true", "[kg, kg m, kg m²]", column.replace("_", " H"))
        if column.startswith("inertia")
        else over_time(tables, column, f"{column}_true", f"{column} energy [J]")
        for column in columns if f"{column}_true" in columns
    ]  # fmt: skip
    return Figure(key, title, f"{FIRST} Potentials are shifted by a constant each.", panels)


def drift(found: Iterable[Studied]) -> Iterable[Figure]:
    """The true systems over small and large steps: energy lost, and volume of phase space."""
    found = sorted(found, key=lambda one: (one.system, one.time_step))
    caption = (
        "Above: distance of the energy from the start's. Below: a small volume around the start, "
        "carried along; a symplectic integrator keeps it."
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
            below.append(over_time(rows, "volume", None, "phase-space volume, of the first", step))
        title = f"{system}: the true system in integrators, small steps and large"
        yield Figure(f"drift_{system}", title, caption, above + below, columns=len(above))


def over_time(
    tables: Tables, column: str, truth: str | None, label: str, title: str = "", *,
    log: bool = False,
) -> Panel:  # fmt: skip
    """A column of every table over time; ``truth`` is that of the truth, in the first of them."""
    parts = [rows(table.t, table[column], pair) for pair, table in tables.items()]
    if truth is not None:
        table = next(iter(tables.values()))
        parts.insert(0, rows(table.t, table[truth]))
    return Panel(title, "time [s]", label, pd.concat(parts), y_log=log, mark="line")


def phase_rows(
    pair: Pair, table: pd.DataFrame, name: str, *, wrap: bool, count: int | None = None
) -> pd.DataFrame:
    """Rows of a coordinate and its velocity, of the truth and of a model.

    A line through them has gaps where an angle jumps and where another trajectory begins.
    """
    parts = []
    for who, field in ((None, "_true"), (pair, "")):
        x, y = table[f"q{field}_{name}"].to_numpy(), table[f"v{field}_{name}"].to_numpy()
        x = wrapped(x) if wrap else x
        another = np.diff(table.trajectory, append=table.trajectory.iloc[-1]) != 0
        with np.errstate(invalid="ignore"):
            jumps = np.abs(np.diff(x, append=x[-1])) > (np.pi if wrap else np.inf)
        parts.append(rows(x, np.where(another | jumps, np.nan, y), who, count or len(x)))
    return pd.concat(parts)


def rows(x: Iterable, y: Iterable, pair: Pair | None = None, count: int = POINTS) -> pd.DataFrame:
    """Points to draw, of a model or else of the truth, thinned to about ``count``."""
    table = pd.DataFrame({"x": x, "y": y})
    method, integrator = pair or ("", "")
    source = "ours" if pair else "truth"
    table = table.iloc[:: max(1, len(table) // count)]
    return table.assign(method=method, integrator=integrator, source=source)


def kept(table: pd.DataFrame) -> pd.DataFrame:
    """The motions, of a prediction that is lost only what comes before."""
    names = [c.removeprefix("v_true_") for c in map(str, table) if c.startswith("v_true_")]
    gone = pd.Series(False, index=table.index)
    for name in names:
        fastest = table[f"v_true_{name}"].abs().max() or 1.0
        gone |= ~(table[f"v_{name}"].abs() <= LOST * fastest)  # NaN is lost, too
    gone = gone.groupby(table.trajectory).cummax()
    predicted = [c for n in names for c in (f"q_{n}", f"v_{n}")] + ["energy"]
    own = [column for column in predicted if column in table]
    return table.assign(**{column: table[column].mask(gone) for column in own})


def wrapped(angle: np.ndarray) -> np.ndarray:
    """Angles in (−π, π]."""
    finite = np.where(np.isfinite(angle), angle, np.nan)
    return np.asarray(np.pi - np.mod(np.pi - finite, 2 * np.pi))


def unbroken(angle: pd.Series) -> pd.Series:
    """The angle wrapped, with a gap where it jumps."""
    values = wrapped(angle.to_numpy())
    with np.errstate(invalid="ignore"):
        jumps = np.abs(np.diff(values, append=values[-1])) > np.pi
    return pd.Series(np.where(jumps, np.nan, values), angle.index)


def coordinates(tables: Tables) -> list[str]:
    """The names of the coordinates in tables of a motion and its truth."""
    columns = next(iter(tables.values())).columns
    return [c.removeprefix("q_true_") for c in columns if c.startswith("q_true_")]


def first(tables: Tables, seconds: float = LONG) -> Tables:
    """The first motion in each table."""
    return {pair: t[(t.trajectory == 0) & (t.t <= seconds)] for pair, t in tables.items()}


def ranking(errors: Tensor) -> dict[str, int]:
    """The motions that are predicted ``best``, ``median`` and ``worst``."""
    order = errors.argsort(stable=True).tolist()
    return {"best": order[0], "median": order[(len(order) - 1) // 2], "worst": order[-1]}


def _read(store: Store | None, run_id: str, files: str, study: str) -> pd.DataFrame | None:
    """From where the files lie, if this machine can reach it, else through the store."""
    name, parts = f"{STUDIES}/{study}.parquet", urlsplit(files)
    if parts.scheme in ("", "file"):
        path = Path(unquote(parts.path) if parts.scheme else files) / name
        return pd.read_parquet(path) if path.exists() else None
    if store is None:
        return None
    with tempfile.TemporaryDirectory(prefix="symo_exp-") as copy:
        try:
            return pd.read_parquet(connect(store).download_artifacts(run_id, name, copy))
        except Exception:  # gone, or away: the figure does without
            return None
