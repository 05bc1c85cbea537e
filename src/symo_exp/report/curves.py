"""Figures of measures over the size of the training set, the noise, the time and the step."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np
import pandas as pd

from symo_exp.report import published
from symo_exp.report.charts import Chart, Panel, Series
from symo_exp.report.labels import (
    Pair,
    in_order,
    measure_name,
    pair_name,
    short,
    systems_in_order,
)
from symo_exp.report.style import TRUE

ERRORS, PHYSICS = ("train_mse", "test_mse", "integration_mse"), ("energy_mse", "inertia_mse")
REACH = ("integration_mse_100", "valid_steps")
FIGURES = {
    ("pendulum", ERRORS): "6.1", ("pendulum", PHYSICS): "6.2",
    ("acrobot", ERRORS): "6.8", ("acrobot", PHYSICS): "6.9",
    ("cartpole", ERRORS): "6.13", ("cartpole", PHYSICS): "6.14",
}  # fmt: skip
FLOORED = ("test_mse", "integration_mse", "energy_mse", "integration_mse_100", "valid_steps")
"""Measures for which the true system in the same integrator is a floor (of the last, a ceiling)."""
SPREAD = "Median over the seeds; the band is from the lowest to the highest."


def data_size(found: pd.DataFrame, floors: pd.DataFrame) -> list[Chart]:
    """Errors over the number of training trajectories, one figure for a system and a group."""
    clean = found[found.noise_std == 0]
    charts = []
    for system in _systems(clean, floors):
        mine, under = clean[clean.system == system], floors[floors.system == system]
        for name, metrics in (("errors", ERRORS), ("physics", PHYSICS), ("reach", REACH)):
            panels = [
                _panel(mine, under, system, metric, "n_traj", "training trajectories")
                for metric in metrics
            ]
            number = FIGURES.get((system, metrics), "")
            charts.append(
                Chart(
                    key=f"data_size_{system}_{name}",
                    title=f"{system}: {_topic(metrics)} over the training set",
                    caption=f"{SPREAD} Rings: published. Grey: the true system in that integrator.",
                    panels=panels,
                    number=number,
                )
            )
    return charts


def noise(found: pd.DataFrame, floors: pd.DataFrame, n_traj: int = 32) -> list[Chart]:
    """Errors over the noise in the training data."""
    fixed = found[found.n_traj == n_traj]
    noisy = fixed.groupby("system").noise_std.nunique() > 1
    charts = []
    for system in systems_in_order(set(noisy[noisy].index)):
        mine, under = fixed[fixed.system == system], floors[floors.system == system]
        panels = [
            _panel(mine, under, system, metric, "noise_std", "noise σ [m, rad; m/s, rad/s]")
            for metric in ERRORS
        ]
        charts.append(
            Chart(
                key=f"noise_{system}",
                title=f"{system}: errors over the noise, {n_traj} trajectories",
                caption=f"{SPREAD} σ = 0 stands at the left edge. Rings: published, there tested "
                "on noisy data; ours are tested on clean ones.",
                panels=panels,
                number="6.19" if system == "cartpole" else "",
            )
        )
    return charts


def speed(measures: pd.DataFrame) -> list[Chart]:
    """Accuracy against the time of a run: every run a point, all variants together."""
    learned = measures[(measures.noise_std == 0) & ~measures.method.isin(TRUE)]
    charts = []
    for metric in ("test_mse", "integration_mse"):
        panels = []
        for system in systems_in_order(set(learned.system)):
            mine = learned[(learned.system == system) & (learned.metric == metric)]
            series = []
            for (method, integrator), runs in _pairs(mine):
                said = [
                    f"{row['variant'] or 'defaults'}, {row['n_traj']} trajectories, "
                    f"seed {row['seed']}"
                    for row in runs.to_dict("records")
                ]
                series.append(
                    Series(
                        method, integrator, list(runs.seconds), list(runs.value),
                        hover=said, points=True,
                    )
                )  # fmt: skip
            panels.append(Panel(system, "training [s]", measure_name(metric), series, x_log=True))
        charts.append(
            Chart(
                key=f"speed_{metric}",
                title=f"{measure_name(metric)} against the time of training",
                caption="Every run; hover says which. Processor time of all optimiser steps.",
                panels=panels,
            )
        )
    return charts


def steps(measures: pd.DataFrame) -> list[Chart]:
    """The true systems over the time step: what an integrator alone misses, and its order."""
    true = measures[measures.method.isin(TRUE)]
    several = true.groupby("system").time_step.nunique() > 1
    panels = []
    for metric in ("test_mse", "energy_mse"):
        for system in systems_in_order(set(several[several].index)):
            mine = true[(true.system == system) & (true.metric == metric)]
            series = []
            for (method, integrator), runs in _pairs(mine):
                line = runs.groupby("time_step").value.median()
                series.append(
                    Series(method, integrator, list(line.index), list(line), source="floor")
                )
            panels.append(Panel(system, "time step [s]", measure_name(metric), series, x_log=True))
    return [
        Chart(
            key="floors_over_steps",
            title="The error of the integrators alone",
            caption="The true systems: nothing is learned. The slope is twice the order plus two "
            "for one step, twice the order for the energy.",
            panels=panels,
        )
    ]


def floors_of(found: pd.DataFrame) -> pd.DataFrame:
    """The cells of the true systems, at the step of the thesis."""
    return found[found.method.isin(TRUE) & at_usual_step(found)]


def learned_of(found: pd.DataFrame, variant: str) -> pd.DataFrame:
    """The cells of learned models of one variant, at the step of the thesis."""
    return found[(found.variant == variant) & ~found.method.isin(TRUE) & at_usual_step(found)]


def at_usual_step(rows: pd.DataFrame) -> np.ndarray:
    usual = rows.system.map(published.TIME_STEPS).fillna(rows.time_step).astype(float)
    return np.isclose(rows.time_step.astype(float), usual)


def _panel(
    found: pd.DataFrame, floors: pd.DataFrame, system: str, metric: str, axis: str, label: str
) -> Panel:
    mine = found[found.metric == metric]
    zero = _left_of(mine[axis]) if axis == "noise_std" else 0.0
    at = (lambda x: x if x > 0 else zero) if axis == "noise_std" else float
    series = [_line(pair, rows, axis, at) for pair, rows in _pairs(mine)]
    series += _published(system, metric, axis, at, set(mine.n_traj), set(mine[axis]))
    ends = [at(x) for x in (mine[axis].min(), mine[axis].max())] if len(mine) else []
    if metric in FLOORED and ends:
        series += _floors(floors[floors.metric == metric], ends)
    ticks = sorted({x for s in series for x in s.x}) if axis == "n_traj" else []
    y_log = metric != "valid_steps"
    return Panel(
        measure_name(metric), label, measure_name(metric), series,
        x_log=True, y_log=y_log, ticks=ticks,
    )  # fmt: skip


def _line(pair: Pair, rows: pd.DataFrame, axis: str, at: Callable[[float], float]) -> Series:
    rows = rows.sort_values(axis)
    said = [
        f"{short(row['low'])} to {short(row['high'])}, {_seeds(row['seeds'])}"
        for row in rows.to_dict("records")
    ]
    return Series(
        *pair, [at(x) for x in rows[axis]], list(rows["median"]),
        low=list(rows.low), high=list(rows.high), hover=said,
    )  # fmt: skip


def _published(
    system: str, metric: str, axis: str, at: Callable[[float], float],
    sizes: set[int], values: set[float],
) -> Iterable[Series]:  # fmt: skip
    table = published.published()
    there = table[(table.system == system) & (table.metric == metric)]
    there = there[at_usual_step(there)]
    if axis == "n_traj":
        there = there[there.noise_std == 0]
    else:  # the noise of our own axis: the thesis' data hold more than its figure
        there = there[there.n_traj.isin(sizes) & there.noise_std.isin(values)]
    for pair, rows in _pairs(there):
        rows = rows.sort_values(axis)
        said = [f"published, {published.note(metric, over)}" for over in rows.over]
        yield Series(
            *pair, [at(x) for x in rows[axis]], list(rows.value),
            source="published", hover=said, name=f"{pair_name(*pair)}, published",
        )  # fmt: skip


def _floors(rows: pd.DataFrame, ends: Sequence[float]) -> Iterable[Series]:
    for (method, integrator), cells in _pairs(rows):
        floor = float(cells["median"].median())
        yield Series(method, integrator, list(ends), [floor] * 2, source="floor")


def _pairs(rows: pd.DataFrame) -> list[tuple[Pair, pd.DataFrame]]:
    grouped = {(str(k[0]), str(k[1])): g for k, g in rows.groupby(["method", "integrator"])}
    return sorted(grouped.items(), key=lambda item: in_order(item[0]))


def _left_of(values: pd.Series) -> float:
    """Where zero is drawn on a logarithmic axis."""
    positive = values[values > 0]
    return float(positive.min()) / 4 if len(positive) else 1e-5


def _systems(*tables: pd.DataFrame) -> list[str]:
    return systems_in_order(set(tables[0].system))


def _topic(metrics: Sequence[str]) -> str:
    return {
        ERRORS: "train, test and integration errors",
        PHYSICS: "energy and inertia errors",
        REACH: "how long predictions hold",
    }[tuple(metrics)]


def _seeds(count: int) -> str:
    return "one seed" if count == 1 else f"{count} seeds"
