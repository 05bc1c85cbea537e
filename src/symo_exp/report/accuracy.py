"""How accurate the methods get: over the order of the integrator, and by what optimiser."""

from __future__ import annotations

import functools
import pkgutil

import pandas as pd
import yaml

from symo_exp.configuration import CONF
from symo_exp.report.charts import Chart, Panel, Series, Source
from symo_exp.report.labels import measure_name, pair_name, short, systems_in_order
from symo_exp.report.style import TRUE, look
from symo_exp.report.tables import Table

MEASURES = (
    "test_mse",
    "integration_mse",
    "integration_mse_100",
    "valid_steps",
    "energy_mse",
    "inertia_mse_aligned",
    "training_seconds",
)
OVER_ORDER = ("test_mse", "integration_mse_100", "energy_mse", "inertia_mse_aligned")
N_TRAJ = 32


@functools.cache
def order_of(integrator: str) -> int | None:
    """The order of convergence of an integrator of the configuration."""
    path = CONF / "integrator" / f"{integrator}.yaml"
    if not path.is_file():
        return None
    choices = yaml.safe_load(path.read_text(encoding="utf-8"))
    chosen = choices["variational"] or choices["explicit"]
    # no tolerance decides an order
    counts = {key: value for key, value in chosen.items() if isinstance(value, int)}
    return int(pkgutil.resolve_name(chosen["_target_"])(**counts).order)


def table(found: pd.DataFrame) -> Table:
    """Every variant, integrator and size that has been run, system by system."""
    learned = found[~found.method.isin(TRUE) & (found.noise_std == 0)]
    rows = []
    keys = ["system", "n_traj", "variant", "method", "integrator"]
    for key, cell in learned.groupby(keys):
        system, n_traj, variant, method, integrator = map(str, key)
        by_metric = {row["metric"]: row for row in cell.to_dict("records")}
        values = [by_metric.get(metric, {}).get("median") for metric in MEASURES]
        name = pair_name(method, integrator)
        seeds = str(int(cell.seeds.max()))
        rows.append([system, n_traj, variant or "defaults", name, seeds, *map(short, values)])
    systems = systems_in_order({row[0] for row in rows})
    rows.sort(key=lambda row: (systems.index(row[0]), int(row[1]), row[2], row[3]))
    return Table(
        key="accuracy",
        title="Accuracy by settings, method and integrator",
        header=["system", "n", "settings", "method", "seeds", *map(measure_name, MEASURES)],
        rows=rows,
        notes=["Medians over the seeds. Training: processor time of all optimiser steps."],
        words=4,
    )


def over_order(found: pd.DataFrame, floors: pd.DataFrame) -> list[Chart]:
    """Errors over the order of the integrator, beside those of the true systems in it.

    Of every variant in which a method has been run with more than one integrator, at 32
    trajectories.
    """
    clean = found[(found.noise_std == 0) & (found.n_traj == N_TRAJ) & ~found.method.isin(TRUE)]
    several = clean.groupby(["variant", "method"]).integrator.transform("nunique") > 1
    charts = []
    for variant, mine in clean[several].groupby("variant"):
        panels = [
            _panel(
                mine[(mine.system == system) & (mine.metric == metric)],
                floors[(floors.system == system) & (floors.metric == metric)],
                f"{system}: {measure_name(metric)}",
            )
            for system in systems_in_order(set(mine.system))
            for metric in OVER_ORDER
        ]
        name = str(variant) or "defaults"
        charts.append(
            Chart(
                key="order_" + "".join(c if c.isalnum() else "_" for c in name),
                title=f"Errors over the order of the integrator ({name})",
                caption="Median over the seeds; the band is from the lowest to the highest. Grey: "
                "the true system in that integrator.",
                panels=panels,
            )
        )
    return charts


def _panel(mine: pd.DataFrame, floors: pd.DataFrame, title: str) -> Panel:
    series = [_line(method, rows, "ours") for method, rows in mine.groupby("method")]
    series += [_line(method, rows, "floor") for method, rows in floors.groupby("method")]
    ticks = sorted({x for s in series for x in s.x})
    return Panel(title, "order of the integrator", "", series, ticks=ticks)


def _line(method: object, rows: pd.DataFrame, source: Source) -> Series:
    by_order = rows.assign(order=rows.integrator.map(order_of))
    by_order = by_order.dropna(subset="order").sort_values("order")
    names = [pair_name(str(method), name) for name in by_order.integrator]
    return Series(
        str(method), "", [float(x) for x in by_order.order], list(by_order["median"]),
        low=list(by_order.low), high=list(by_order.high), hover=names,
        source=source, name=look(str(method)).label,
    )  # fmt: skip
