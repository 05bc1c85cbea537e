"""Opening and closing runs, so that none stays RUNNING when nothing runs."""

from __future__ import annotations

import logging
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from symo_exp.tracking import process
from symo_exp.tracking.memory import recall
from symo_exp.tracking.revision import revision_tags
from symo_exp.tracking.store import Store, connect, experiment_id

if TYPE_CHECKING:
    from mlflow.entities import Run

log = logging.getLogger(__name__)

PARENT = "SYMO_EXP_PARENT_RUN"
"""Environment variable with the run id of the multirun that a job belongs to."""
PARENT_TAG = "mlflow.parentRunId"
FOLDER = "symo_exp.folder"
"""Tag with the run folder, by which a run whose process was killed is found again."""
REASON = "reason"
"""Tag that says why a run is FAILED or KILLED."""


def open_run(
    store: Store, experiment: str, *, name: str, parent: str | None = None, folder: str = ""
) -> str:
    """Create a run owned by this process and return its id; close those of dead processes.

    If one of the dead worked in the same run ``folder``, its run is continued instead.
    """
    experiment_ = experiment_id(store, experiment)
    for run in stale(store, experiment_):
        if folder and run.data.tags.get(FOLDER) == folder:
            reopen_run(store, run.info.run_id, parent)
            return str(run.info.run_id)
    close_stale(store, experiment_)
    tags = process.identity() | revision_tags()
    if folder:
        tags[FOLDER] = folder
    if parent:
        tags[PARENT_TAG] = parent
    with store.lock():
        created = connect(store).create_run(experiment_, run_name=name, tags=tags)
    return str(created.info.run_id)


def exists(store: Store, run_id: str) -> bool:
    """Whether the store still has this run."""
    from mlflow.exceptions import MlflowException

    try:
        return connect(store).get_run(run_id).info.lifecycle_stage == "active"
    except MlflowException as error:
        if error.error_code in ("RESOURCE_DOES_NOT_EXIST", "INVALID_PARAMETER_VALUE"):
            return False
        raise


def reopen_run(store: Store, run_id: str, parent: str | None = None) -> None:
    """Continue a run: it is RUNNING again and belongs to this process."""
    client = connect(store)
    tags = process.identity() | ({PARENT_TAG: parent} if parent else {})
    for key, value in tags.items():
        client.set_tag(run_id, key, value)
    if REASON in client.get_run(run_id).data.tags:
        client.delete_tag(run_id, REASON)
    client.update_run(run_id, status="RUNNING")


def address(store: Store, run_id: str) -> str:
    """Where a human finds the run."""
    if not store.uri.startswith("http"):
        return f"run {run_id} in {store}"
    experiment = connect(store).get_run(run_id).info.experiment_id
    return f"{store}/#/experiments/{experiment}/runs/{run_id}"


def told(store: Store, run_id: str) -> set[tuple[str, int]]:
    """Name and step of every value that the store has of this run."""
    client = connect(store)
    names = client.get_run(run_id).data.metrics
    return {(name, row.step) for name in names for row in client.get_metric_history(run_id, name)}


def close_run(store: Store, run_id: str, status: str, reason: str = "") -> None:
    """End a run as FINISHED, FAILED or KILLED."""
    client = connect(store)
    if reason:
        client.set_tag(run_id, REASON, reason[:500])
    elif REASON in client.get_run(run_id).data.tags:
        client.delete_tag(run_id, REASON)
    client.set_terminated(run_id, status=status)


def stale(store: Store, experiment_: str) -> list[Run]:
    """The RUNNING runs whose process, on this machine, has died."""
    host = process.identity()[process.HOST]
    ours = f"attributes.status = 'RUNNING' and tags.`{process.HOST}` = '{host}'"
    running = connect(store).search_runs([experiment_], filter_string=ours, max_results=1000)
    return [run for run in running if process.is_dead(run.data.tags)]


def close_stale(store: Store, experiment_: str) -> list[str]:
    """Mark them KILLED; returns their ids."""
    closed = []
    for run in stale(store, experiment_):
        tags = run.data.tags
        reason = f"process {tags[process.PID]} on {tags[process.HOST]} ended without closing it"
        close_run(store, run.info.run_id, "KILLED", reason)
        log.warning("run %s marked KILLED: %s", run.info.run_id, reason)
        closed.append(run.info.run_id)
    return closed


def parent_from_environment() -> str | None:
    """The multirun this job belongs to, if any."""
    return os.environ.get(PARENT) or None


def log_parameters(store: Store, run_id: str, parameters: Mapping[str, Any]) -> None:
    """Nested parameters under dotted names (``data.n_traj``), but for those it has already."""
    from mlflow.entities import Param

    there = connect(store).get_run(run_id).data.params
    params = [Param(k, str(v)) for k, v in flatten(parameters).items() if k not in there]
    for start in range(0, len(params), 100):  # MLflow's limit for one batch
        connect(store).log_batch(run_id, params=params[start : start + 100])


def flatten(nested: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """``{"data": {"n_traj": 8}}`` to ``{"data.n_traj": 8}``, without Hydra's own switches."""
    flat: dict[str, Any] = {}
    for key, value in nested.items():
        if key in ("_partial_", "_convert_", "_recursive_"):
            continue
        if isinstance(value, Mapping) and value:
            flat |= flatten(value, f"{prefix}{key}.")
        else:
            flat[f"{prefix}{key}"] = value
    return flat


def fail(folder: Path, store: Store, reason: str) -> None:
    """Close the run of a folder whose process is gone."""
    run_id = recall(folder, store)
    if run_id is None:
        return
    try:
        close_run(store, run_id, "FAILED", reason)
    except Exception as error:
        log.warning("run %s could not be closed: %s", run_id, error)
