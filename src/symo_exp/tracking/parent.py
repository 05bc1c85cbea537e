"""The parent run of a multirun: its jobs appear beneath it."""

from __future__ import annotations

import logging
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from symo_exp.tracking.runs import PARENT, close_run, log_parameters, open_run
from symo_exp.tracking.store import Store, check, find

log = logging.getLogger(__name__)


class _Parent(NamedTuple):
    store: Store
    run_id: str
    pid: int


_open: _Parent | None = None


def start_parent(
    *,
    experiment: str,
    tracking_uri: str | None = None,
    directory: str | Path = "mlruns",
    name: str = "multirun",
    parameters: Mapping[str, Any] | None = None,
    timeout: float = 5.0,
) -> str:
    """Open the run of a multirun, announce it to the jobs by the environment, return its id."""
    global _open
    store = find(tracking_uri, directory)
    check(store, timeout)
    run_id = open_run(store, experiment, name=name)
    _open = _Parent(store, run_id, os.getpid())
    os.environ[PARENT] = run_id
    log_parameters(store, run_id, parameters or {})
    return run_id


def end_parent(status: str = "FINISHED", reason: str = "") -> None:
    """Close what ``start_parent`` opened.

    Does nothing the second time, nor in a forked worker, so that it can be called from a
    ``finally`` and from ``atexit`` too: Hydra's ``on_multirun_end`` is not called when a job
    failed.
    """
    global _open
    if _open is None or _open.pid != os.getpid():
        return
    parent, _open = _open, None
    os.environ.pop(PARENT, None)
    try:
        close_run(parent.store, parent.run_id, status, reason)
    except Exception as error:  # a store that is away must not cost a sweep its end
        log.warning("the run %s of the sweep could not be closed: %s", parent.run_id, error)
