"""MLflow as a view of run folders: ``publish(folder)`` updates the store.

It can be called at any time, any number of times and from any process: while a run trains, at its
end, or when the command is repeated. Nothing that the store has is sent again; the folder holds all
state. A call to MLflow takes 5 to 30 ms, about the same for one row as for fifty, so that series
are sent in batches; synchronously, because rows that MLflow queues itself are lost when the
process is killed.
"""

from __future__ import annotations

import logging
import math
import re
import time
from collections.abc import Iterable, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from symo_exp.checks import real, whole_number
from symo_exp.runs.folder import DIED, SERIES, About, Outcome, RunFolder
from symo_exp.runs.series import EPOCH, TIME, read
from symo_exp.tracking.page import NOTE, description, page, send_dataset, show
from symo_exp.tracking.store import Store, check, connect, experiment_id, find, is_away

if TYPE_CHECKING:
    from mlflow.entities import Run

log = logging.getLogger(__name__)

BATCH = 500
"""Rows in one request; MLflow accepts 1000, but the cost of a row grows above this."""
PARAMETERS = 100
"""Of them in one request: MLflow's limit."""
DENSE = 100
"""Epochs at the start that are all sent, however thin the rest: short runs lose nothing."""

IDENTITY, FOLDER, REASON = "symo_exp.run", "symo_exp.folder", "reason"
"""Tags: which run this is, where its folder lies, why it did not finish."""
PARENT = "mlflow.parentRunId"
STATUS = {
    "waiting": "SCHEDULED", "running": "RUNNING", "finished": "FINISHED", "failed": "FAILED",
    "refused": "FAILED", "interrupted": "KILLED",
}  # fmt: skip


class MlflowView:
    """One experiment of a tracking store; the settings are those of ``conf/logger/mlflow.yaml``."""

    def __init__(
        self,
        *,
        experiment: str = "symo_exp",
        tracking_uri: str | None = None,
        directory: str | Path = "mlruns",
        every_n_epochs: int = 5,
        flush_seconds: float = 10.0,
        timeout: float = 5.0,
    ) -> None:
        whole_number("logger.every_n_epochs", every_n_epochs)
        real("logger.timeout", timeout, above=0)
        real("logger.flush_seconds", flush_seconds, low=0)
        self.store = find(tracking_uri, directory)
        self.flush_seconds = flush_seconds
        self._experiment, self._every, self._timeout = experiment, every_n_epochs, timeout
        self._open: dict[str, _Opened] = {}

    def check(self) -> None:
        """Refuse a store that cannot be reached or written; fast."""
        check(self.store, self._timeout)

    def is_published(self, folder: RunFolder) -> bool:
        """Return whether this store has all of the run, without importing MLflow."""
        told = folder.published()
        return told.get("store") == str(self.store) and self.store.may_have(told.get("run_id", ""))

    def publish(self, folder: RunFolder) -> None:
        """Update the store.

        Raises:
            AwayError: If the store does not answer within ``timeout``.
        """
        about, outcome = folder.about(), folder.outcome()
        if about is None or self.is_published(folder):
            return
        self.check()  # answers sooner than MLflow, which tries again and again
        run = self._open.get(about.identity)
        if run is None:
            found = self._find(about, folder)
            run = self._open[about.identity] = _Opened(found, self.store)
            run.send_parameters(about)
            send_dataset(self.store, found, about.parameters)
        run.send_series(self._rows(folder, last=outcome.status == "finished"))
        if outcome.status == "finished":
            run.send_measures(folder.measures() | _parameters(folder))
            run.upload(folder)
        run.explain(description(about, outcome, folder.measures()))
        run.set_status(outcome)
        if outcome.status not in ("running", "waiting"):
            folder.mark_published({"store": str(self.store), "run_id": run.run_id})
            del self._open[about.identity]

    def close_dead(self) -> None:
        """Mark runs as failed that the store has as RUNNING and whose process has died."""
        client = connect(self.store)
        experiment = experiment_id(self.store, self._experiment)
        for run in client.search_runs([experiment], "attributes.status = 'RUNNING'"):
            path = Path(run.data.tags.get(FOLDER, "/nowhere"))
            if path.is_dir() and RunFolder(path).died():
                RunFolder(path).record("failed", DIED)
                self.publish(RunFolder(path))
                log.warning("%s: marked as failed, its process had ended", path)

    def _find(self, about: About, folder: RunFolder) -> Run:
        """Return the run of the store that belongs to the folder, created if there is none."""
        client = connect(self.store)
        parent = self._search(about.sweep) if about.sweep else None
        found = self._search(about.identity)
        tags = {PARENT: parent.info.run_id} if parent else {}
        if found is not None:
            for key, value in tags.items():
                client.set_tag(found.info.run_id, key, value)
            return found
        tags |= {**about.tags, IDENTITY: about.identity, FOLDER: str(folder.path)}
        experiment = experiment_id(self.store, self._experiment)
        with self.store.lock():
            return client.create_run(
                experiment, start_time=int(1e3 * about.started), run_name=about.name, tags=tags
            )

    def _search(self, identity: str) -> Run | None:
        wanted = f"tags.`{IDENTITY}` = '{identity}'"
        experiment = experiment_id(self.store, self._experiment)
        found = connect(self.store).search_runs([experiment], wanted, max_results=1)
        return found[0] if found else None

    def _rows(self, folder: RunFolder, *, last: bool) -> list[dict[str, float]]:
        """Return the thinned series; with ``last`` also its last row."""
        rows = read(folder / SERIES)
        kept = [r for r in rows if r[EPOCH] < DENSE or (r[EPOCH] + 1) % self._every == 0]
        return kept + rows[-1:] if last and rows and rows[-1] not in kept else kept

    def show(self, varied: Sequence[str]) -> None:
        """Set up the page of the experiment for a sweep, unless the store is unavailable."""
        try:
            self.check()
            show(self.store, experiment_id(self.store, self._experiment), varied)
        except Exception as error:
            if not is_away(error):
                raise

    def page(self) -> str:
        """Return the page of the experiment, empty while the store is unavailable."""
        try:
            self.check()
            return page(self.store, experiment_id(self.store, self._experiment))
        except Exception as error:
            if not is_away(error):
                raise
            return ""


def _parameters(folder: RunFolder) -> dict[str, float]:
    """Physical parameters and their standard deviations as metrics."""
    found = {}
    for row in folder.parameters():
        name = row["name"].replace("/", "_")
        found[f"parameter/{name}"] = float(row["value"])
        if not math.isnan(deviation := float(row["standard_deviation"])):
            found[f"parameter_deviation/{name}"] = deviation
    return found


@cache
def _allowed(name: str) -> str:
    """Return a name in the characters that MLflow takes; users and recordings have others."""
    return re.sub(r"[^\w.\- /]", "_", name)


class _Opened:
    """A run of the store and what it is known to have; a cache of one process."""

    def __init__(self, run: Run, store: Store) -> None:
        self.run_id, self._client = str(run.info.run_id), connect(store)
        self._status = ""
        self._parameters = run.data.params
        self._tags, self._values = dict(run.data.tags), dict(run.data.metrics)
        self._sent: dict[str, int] = {
            name: max(row.step for row in self._client.get_metric_history(self.run_id, name))
            for name in run.data.metrics
        }

    def send_parameters(self, about: About) -> None:
        """Send parameters that the store does not have: MLflow lets none be changed."""
        from mlflow.entities import Param

        given = {**about.parameters, "variant": about.variant} if about.parameters else {}
        named = {_allowed(name): str(value) for name, value in given.items()}
        new = [Param(name, x) for name, x in named.items() if name not in self._parameters]
        for start in range(0, len(new), PARAMETERS):
            self._client.log_batch(self.run_id, params=new[start : start + PARAMETERS])

    def send_series(self, rows: list[dict[str, float]]) -> None:
        """Send the rows after those that the store has."""
        self._send(
            (allowed, value, row[TIME], int(row[EPOCH]))
            for row in rows
            for name, value in row.items()
            if name not in (EPOCH, TIME)
            and row[EPOCH] > self._sent.get(allowed := _allowed(name), -1)
        )

    def send_measures(self, measures: dict[str, float]) -> None:
        """Send final numbers that the store does not have, at step 0: the last of them counts."""
        now = time.time()
        there = {_allowed(name): x for name, x in measures.items()}
        new = {name: x for name, x in there.items() if self._values.get(name) != x}
        self._send((name, x, now, 0) for name, x in new.items())
        self._values |= new

    def _send(self, values: Iterable[tuple[str, float, float, int]]) -> None:
        """Send values with their names, times [s since 1970] and steps."""
        from mlflow.entities import Metric

        new = [Metric(name, x, int(1e3 * at), step) for name, x, at, step in values]
        for start in range(0, len(new), BATCH):
            batch = new[start : start + BATCH]
            self._client.log_batch(self.run_id, metrics=batch, synchronous=True)
            self._sent |= {metric.key: metric.step for metric in batch}

    def upload(self, folder: RunFolder) -> None:
        """Send the files of the folder."""
        for path in folder.files():
            inside = path.relative_to(folder.path)
            if path.is_dir():
                self._client.log_artifacts(self.run_id, str(path), artifact_path=str(inside))
            else:
                parent = None if inside.parent == Path(".") else str(inside.parent)
                self._client.log_artifact(self.run_id, str(path), artifact_path=parent)

    def explain(self, told: str) -> None:
        """Set the description that MLflow shows."""
        if told and self._tags.get(NOTE) != told:
            self._client.set_tag(self.run_id, NOTE, told)
            self._tags[NOTE] = told

    def set_status(self, outcome: Outcome) -> None:
        """Set RUNNING, FINISHED, FAILED or KILLED, with the reason if there is one."""
        status = STATUS[outcome.status]
        if status == self._status:
            return
        if outcome.reason:
            self._client.set_tag(self.run_id, REASON, outcome.reason[:500])
            self._tags[REASON] = outcome.reason
        elif REASON in self._tags:
            self._client.delete_tag(self.run_id, REASON)
            del self._tags[REASON]
        if status in ("RUNNING", "SCHEDULED"):
            self._client.update_run(self.run_id, status=status)
        else:
            self._client.set_terminated(self.run_id, status=status)
        self._status = status
