"""Artificial runs: as rows of the tidy table, in a tracking store, in a folder."""

import itertools
from pathlib import Path
from typing import Any

from mlflow.entities import Metric, Param

from symo_exp.report import runs
from symo_exp.runs.folder import About, RunFolder
from symo_exp.thesis import published
from symo_exp.tracking.store import Store, connect, experiment_id

MEASURES = {
    "train_mse": 1e-6,
    "test_mse": 2e-6,
    "integration_mse": 0.5,
    "energy_mse": 1e-3,
    "training_seconds": 40.0,
}
IDENTITIES = map(str, itertools.count())


def cell_of(given: dict[str, Any]) -> dict[str, Any]:
    """The columns of the settings of a run; those that are not given are the defaults."""
    cell = {
        "system": "pendulum", "method": "symo", "integrator": "midpoint", "n_traj": 32,
        "noise_std": 0.0, "seed": 0, "optimizer": "adam", **given,
    }  # fmt: skip
    return {"time_step": published.TIME_STEPS.get(cell["system"], 0.1), **cell}


def row(metrics=MEASURES, **given: Any) -> runs.Row:
    """One run for ``runs.tidy``."""
    known = dict.fromkeys(runs.COLUMNS, "") | {"experiment": "thesis", "status": "FINISHED"}
    known |= {"run_id": next(IDENTITIES), "started": "2026-01-01", "seconds": 40.0}
    known = {name: known[name] for name in (*runs.KNOWN, *runs.LATER, "variant", "files")}
    return {**known, **cell_of(given)}, metrics


def parameters(given: dict[str, Any]) -> dict[str, Any]:
    told = {runs.PARAMETERS[key]: value for key, value in cell_of(given).items()}
    return told | {"preset": "default"}


def add_run(
    store: Store, *, experiment="thesis", metrics=MEASURES, status="FINISHED", reason="",
    told=None, **cell: Any,
) -> str:  # fmt: skip
    """One run in a store; ``cell`` has the columns of the report, ``told`` other parameters."""
    client = connect(store)
    run = client.create_run(experiment_id(store, experiment), run_name="made").info.run_id
    client.log_batch(
        run,
        params=[Param(key, str(x)) for key, x in (parameters(cell) | (told or {})).items()],
        metrics=[Metric(key, value, 0, 0) for key, value in metrics.items()],
    )
    if reason:
        client.set_tag(run, "reason", reason)
    if status != "RUNNING":
        client.set_terminated(run, status=status)
    return run


def add_folder(
    path: Path, status="finished", metrics=MEASURES, experiment="mine", **cell: Any
) -> RunFolder:
    """One run in a folder of its own."""
    folder = RunFolder(path)
    folder.path.mkdir(parents=True)
    folder.describe(About("made", {**parameters(cell), "experiment": experiment}))
    seconds = metrics.get("training_seconds", 0.0)
    (folder / "series.csv").write_text(f"epoch,time,training_seconds\n0,1.0,1.0\n1,2.0,{seconds}\n")
    folder.write_measures(metrics)
    folder.record(status, "" if status == "finished" else "out of memory")
    return folder


def repeated(rows: Any, factor: float = 1.0) -> list[runs.Row]:
    """A run for each cell of rows of the published table, ``factor`` times as bad."""
    made = []
    for key, values in rows.groupby(published.CELL):
        metrics = {}
        for one in values.itertuples():
            metrics |= dict.fromkeys((one.metric, one.like), factor * one.value)
        made.append(row(metrics, **dict(zip(published.CELL, key, strict=True))))
    return made
