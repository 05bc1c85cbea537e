"""Figures of measures over training set size, noise, training time, time step or order."""

from __future__ import annotations

import functools
import re
from collections.abc import Iterable
from typing import NamedTuple

import pandas as pd

from symo_exp.report.cells import DEFAULTS, over_seeds
from symo_exp.report.figures import Figure, Panel
from symo_exp.report.looks import (
    all_angles,
    label_and_unit,
    measure_name,
    number,
    pair_names,
    short,
    unit,
)
from symo_exp.shipped import CONF
from symo_exp.words import counted

ERRORS = ("train_mse", "test_mse", "integration_mse")
GROUPS = {
    "errors": ("one-step and integration errors", ERRORS),
    "physics": ("energy, inertia and horizon", ("energy_mse", "inertia_mse", "valid_steps")),
}
FLOORED = ("test_mse", "integration_mse", "energy_mse", "valid_steps")
"""Measures that the true system in the same integrator bounds."""
OVER_ORDER = ("test_mse", "integration_mse_100", "energy_mse", "inertia_mse_aligned")
AT = 32
"""Number of training trajectories at which noises, orders and motions are compared, if there are
runs with it."""


class Axis(NamedTuple):
    """An x axis.

    Args:
        column: The column of the cells.
        label: The label, with a unit.
        log: Whether the axis is logarithmic.
        ticks: Whether there are ticks at the values alone.
        mark: How values are drawn (``Panel.mark``).
    """

    column: str
    label: str
    log: bool = True
    ticks: bool = False
    mark: str = "both"


SIZE = Axis("n_traj", "training trajectories", ticks=True)
NOISE = Axis("noise_std", "noise σ", ticks=True)
SECONDS = Axis("seconds", "training time [s]", mark="points")
STEP = Axis("time_step", "time step [s]")
ORDER = Axis("order", "order of the integrator", log=False, ticks=True)


def panels(rows: pd.DataFrame, axis: Axis, metrics: Iterable[str]) -> list[Panel]:
    """Return a panel for each system and measure: the column ``median`` over that of the axis.

    A column ``x`` replaces that of the axis.
    """
    rows = rows.assign(x=rows.get("x", rows[axis.column]).astype(float), y=rows["median"])
    rows = rows.dropna(subset="x").sort_values("x", kind="stable")
    several = rows.system.nunique() > 1
    made = []
    for system, own in rows.groupby("system"):
        angular = all_angles(own.metric, own.y)
        for metric in metrics:
            here, title = own[own.metric == metric], measure_name(metric, angular)
            made.append(
                Panel(
                    f"{system}: {title}" if several else title, axis.label, unit(metric, angular),
                    here, axis.log, metric != "valid_steps", axis.mark,
                    tuple(sorted(set(here.x))) if axis.ticks else (), system=str(system),
                )
            )  # fmt: skip
    return made


def seeds_caption(rows: pd.DataFrame) -> str:
    """Return a sentence on the lines and bands of learned cells."""
    most = rows[rows.source == "ours"].seeds.max()
    return (
        over_seeds(most, "Median over the seeds; the band is from the lowest to the highest") + "."
    )


def usual_sizes(rows: pd.DataFrame) -> pd.Series:
    """Return ``AT`` for each system that has it, the most frequent size for others."""
    there = rows.dropna(subset="n_traj").groupby("system").n_traj
    return there.agg(lambda sizes: AT if (sizes == AT).any() else sizes.mode().max()).astype(float)


def data_size(found: pd.DataFrame) -> list[Figure]:
    """Return errors over the number of training trajectories, a figure for each system and group.

    Args:
        found: Cells of learned models, of floors, and others to draw beside them.
    """
    clean = _with_floors(found[~(found.noise_std > 0)], SIZE)
    sizes = clean[clean.source == "ours"].groupby("system").n_traj.nunique()
    clean = clean[clean.system.isin(sizes.index[sizes > 1])]
    made = []
    for system, rows in clean.groupby("system"):
        for name, (topic, metrics) in GROUPS.items():
            floors = rows[(rows.source == "floor") & rows.metric.isin(metrics)]
            across = "" if floors.empty else " Lines across: the true system in that integrator."
            title = f"{system}: {topic} over the training set"
            drawn = panels(rows, SIZE, metrics)
            made.append(
                Figure(f"data_size_{system}_{name}", title, seeds_caption(rows) + across, drawn)
            )
    return made


def noise_figures(found: pd.DataFrame) -> list[Figure]:
    """Return errors over the noise of the training data, for systems with several noises."""
    noisy = found[(found.source == "ours") & (found.noise_std > 0)]
    sizes = usual_sizes(noisy)
    at = found.n_traj == found.system.map(sizes)
    rows = _with_floors(found[at | (found.source == "floor")], NOISE)
    ours = rows[rows.source == "ours"].groupby("system").noise_std.unique()
    made = []
    for system, noises in ours[ours.map(len) > 1].items():
        here = rows[(rows.system == system)]
        # published noises may go far beyond
        here = here[here.noise_std.isin(noises) | (here.source == "floor")]
        title = f"{system}: errors over the noise, {counted(sizes[system], 'trajectory')}"
        angular = all_angles(here.metric, here["median"])
        q = label_and_unit("rmse_1s", angular)[1]
        axis = NOISE._replace(label=f"{NOISE.label} [{q}; {q.replace(',', '/s,')}/s]")
        caption = f"{seeds_caption(here)} Tested on clean data."
        made.append(Figure(f"noise_{system}", title, caption, panels(here, axis, ERRORS)))
    return made


def speed(runs: pd.DataFrame) -> list[Figure]:
    """Return errors against the time of training, a point for each run of any settings.

    There is no panel of a single run.
    """
    learned = runs[(runs.source == "ours") & (runs.metric != "") & ~(runs.noise_std > 0)]
    learned = learned[learned.groupby("system").run_id.transform("nunique") > 1]
    if learned.empty:
        return []
    words = zip(learned.variant, learned.n_traj, learned.seed, strict=True)
    said = [
        ", ".join([v or DEFAULTS, *[counted(n, "trajectory")] * (n == n), f"seed {number(seed)}"])
        for v, n, seed in words
    ]
    learned = learned.assign(median=learned.value, text=said)
    noisy = " without noise" * bool((runs.noise_std > 0).any())
    caption = (
        f"Every run{noisy}; point at it for its settings. Processor time of all optimiser steps."
    )
    title = "Accuracy against the time of training"
    drawn = panels(learned, SECONDS, ("test_mse", "integration_mse"))
    return [Figure("speed", title, caption, drawn, columns=2)]


def steps(found: pd.DataFrame) -> list[Figure]:
    """Return the errors of the true systems over the time step."""
    true = found[found.source == "floor"]
    several = true.groupby("system").time_step.transform("nunique") > 1
    caption = (
        "True systems, nothing is learned. The slope is twice the order plus two for one step, "
        "and twice the order for the energy."
    )
    drawn = panels(true[several], STEP, ("test_mse", "energy_mse"))
    return [Figure("floors_over_steps", "The error of the integrators alone", caption, drawn)]


def over_order(found: pd.DataFrame) -> list[Figure]:
    """Return errors over the order of the integrator, with those of the true systems.

    There is a figure for all settings in which a method has been run with several orders.
    """
    ordered = found.assign(order=found.integrator.map(order_of), text=pair_names(found))
    ordered = ordered.assign(integrator="").dropna(subset="order")  # a line is through several
    clean = ordered[(ordered.source == "ours") & (ordered.noise_std == 0)]
    clean = clean[clean.n_traj == clean.system.map(usual_sizes(clean))]
    several = clean.groupby(["variant", "method"]).order.transform("nunique") > 1
    floors = ordered[(ordered.source == "floor") & (ordered["median"] > 0)]
    made = []
    for variant, mine in clean[several].groupby("variant"):
        settings = str(variant) or DEFAULTS
        rows = pd.concat([mine, floors[floors.system.isin(mine.system)]])
        title = f"Errors over the order of the integrator ({settings})"
        caption = f"{seeds_caption(rows)} Without colour: the true system in that integrator."
        drawn = panels(rows, ORDER, OVER_ORDER)
        made.append(Figure(f"order_{settings}", title, caption, drawn, columns=4))
    return made


@functools.cache
def order_of(integrator: str) -> int | None:
    """Return the order of convergence of an integrator of the configuration."""
    path = CONF / "integrator" / f"{integrator}.yaml"
    # as its first comment says: its class would take the seconds of an import of PyTorch
    said = re.search(r"order (\d+)", path.read_text(encoding="utf-8")) if path.is_file() else None
    return int(said[1]) if said else None


def _with_floors(found: pd.DataFrame, axis: Axis) -> pd.DataFrame:
    """Return learned and other cells, and floors as lines across the learned ones."""
    lines = found[found.source != "floor"].dropna(subset=axis.column)
    lines = lines.assign(x=lines[axis.column].astype(float))
    of, ours = ["system", "metric"], lines.source == "ours"
    text = [
        f"{short(low)} to {short(high)}, {counted(seeds, 'seed')}"
        for low, high, seeds in zip(lines.low, lines.high, lines.seeds, strict=True)
    ]
    ranges = pd.Series(text, index=lines.index, dtype=object)
    lines = lines.assign(text=ranges.where(ours, lines.get("text")))
    ends = lines[ours].groupby(of).x.agg(["min", "max"]).reset_index()
    lines = lines.merge(ends[of], on=of)
    floors = found[(found.source == "floor") & found.metric.isin(FLOORED)]
    level = floors.groupby([*of, "method", "integrator", "source"], as_index=False)["median"]
    across = ends.melt(of, value_name="x").merge(level.median(), on=of)
    return pd.concat([lines, across.drop(columns="variable")])
