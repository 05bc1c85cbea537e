"""Tracking stores with runs that were never run."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from mlflow.entities import Metric, Param

from symo_exp.report import published
from symo_exp.tracking.runs import close_run, open_run
from symo_exp.tracking.store import Store, connect

MEASURES = {
    "train_mse": 1e-6,
    "test_mse": 2e-6,
    "integration_mse": 0.5,
    "energy_mse": 1e-3,
    "training_seconds": 40.0,
}


def add_run(
    store: Store,
    *,
    experiment: str = "thesis",
    metrics: dict[str, float] | None = None,
    status: str = "FINISHED",
    reason: str = "",
    parameters: dict[str, Any] | None = None,
    **cell: Any,
) -> str:
    """One run; ``cell`` has the columns of the report, the rest is as in the defaults."""
    cell = {
        "system": "pendulum", "method": "symo", "integrator": "midpoint", "n_traj": 32,
        "noise_std": 0.0, "seed": 0, **cell,
    }  # fmt: skip
    cell.setdefault("time_step", published.TIME_STEPS.get(cell["system"], 0.1))
    names = {
        "method": "model", "n_traj": "data.n_traj", "noise_std": "data.noise_std",
        "time_step": "system.time_step",
    }  # fmt: skip
    told = {names.get(key, key): value for key, value in cell.items()}
    told |= {"preset": "default", "optimizer": "adam", **(parameters or {})}
    run = open_run(store, experiment, name="made")
    values = MEASURES if metrics is None else metrics
    connect(store).log_batch(
        run,
        params=[Param(key, str(value)) for key, value in told.items()],
        metrics=[Metric(key, value, 0, 0) for key, value in values.items()],
    )
    if status != "RUNNING":
        close_run(store, run, status, reason)
    return run


def add_published(store: Store, rows: Any, factor: float = 1.0, seeds: Iterable[int] = (0,)) -> int:
    """A run for each cell of rows of the published table, ``factor`` times as bad."""
    count = 0
    for key, values in rows.groupby(published.CELL):
        metrics = {}
        for row in values.to_dict("records"):
            for name in (row["metric"], published.like(row["metric"], row["over"])):
                metrics[name] = factor * row["value"]
        for seed in seeds:
            add_run(
                store, metrics=metrics, seed=seed, **dict(zip(published.CELL, key, strict=True))
            )
            count += 1
    return count


def folder_of(store: Store) -> Path:
    """What ``--directory`` takes."""
    assert store.database is not None
    return store.database.parent
