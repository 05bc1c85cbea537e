"""Opening and closing runs, so that none stays RUNNING when nothing runs."""

from __future__ import annotations

import logging
import os
from collections.abc import Mapping
from typing import Any

from symo_exp.tracking import process
from symo_exp.tracking.revision import revision_tags
from symo_exp.tracking.store import Store, connect, experiment_id

log = logging.getLogger(__name__)

PARENT = "SYMO_EXP_PARENT_RUN"
"""Environment variable with the run id of the multirun that a job belongs to."""
REASON = "reason"
"""Tag that says why a run is FAILED or KILLED."""


def open_run(store: Store, experiment: str, *, name: str, parent: str | None = None) -> str:
    """Create a run owned by this process and return its id; close those of dead processes."""
    experiment_ = experiment_id(store, experiment)
    close_stale(store, experiment_)
    tags = process.identity() | revision_tags()
    if parent:
        tags["mlflow.parentRunId"] = parent
    with store.lock():
        run = connect(store).create_run(experiment_, run_name=name, tags=tags)
    return str(run.info.run_id)


def reopen_run(store: Store, run_id: str) -> None:
    """Continue a run: it is RUNNING again and belongs to this process."""
    client = connect(store)
    for key, value in process.identity().items():
        client.set_tag(run_id, key, value)
    if REASON in client.get_run(run_id).data.tags:
        client.delete_tag(run_id, REASON)
    client.update_run(run_id, status="RUNNING")


def close_run(store: Store, run_id: str, status: str, reason: str = "") -> None:
    """End a run as FINISHED, FAILED or KILLED."""
    client = connect(store)
    if reason:
        client.set_tag(run_id, REASON, reason[:500])
    client.set_terminated(run_id, status=status)


def close_stale(store: Store, experiment_: str) -> list[str]:
    """Close the RUNNING runs whose process, on this machine, has died; returns their ids."""
    client = connect(store)
    host = process.identity()[process.HOST]
    ours = f"attributes.status = 'RUNNING' and tags.`{process.HOST}` = '{host}'"
    closed = []
    for run in client.search_runs([experiment_], filter_string=ours, max_results=1000):
        if process.is_dead(run.data.tags):
            pid = run.data.tags[process.PID]
            reason = f"process {pid} on {host} ended without closing the run"
            close_run(store, run.info.run_id, "KILLED", reason)
            log.warning("run %s marked KILLED: %s", run.info.run_id, reason)
            closed.append(run.info.run_id)
    return closed


def parent_from_environment() -> str | None:
    """The multirun this job belongs to, if any."""
    return os.environ.get(PARENT) or None


def log_parameters(store: Store, run_id: str, parameters: Mapping[str, Any]) -> None:
    """Nested parameters under dotted names (``data.n_traj``)."""
    from mlflow.entities import Param

    params = [Param(key, str(value)) for key, value in flatten(parameters).items()]
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
