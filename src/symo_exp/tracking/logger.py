"""The MLflow tracker: a Lightning logger that writes seldom, and synchronously.

A call to MLflow costs 5 to 30 ms, about as much for one row as for fifty, so rows are collected
and sent in batches. Sent synchronously: rows that MLflow itself queues are lost when the process
is killed.
"""

from __future__ import annotations

import logging
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from symo_exp.tracking import artifacts, runs
from symo_exp.tracking.store import check, connect, find
from symo_exp.tracking.tracker import Tracker

log = logging.getLogger(__name__)

BATCH = 500
"""Rows in one request; MLflow accepts 1000, but the cost of a row grows above this."""
DENSE = 100
"""Epochs at the start that are all kept, however thin the rest: short runs lose nothing."""
RETRY_SECONDS = 60.0


class MlflowTracker(Tracker):
    """Series, parameters, measures and files of one run in MLflow.

    A store that fails during training does not stop it: rows wait and are sent later.
    """

    def __init__(
        self,
        *,
        experiment: str = "symo_exp",
        tracking_uri: str | None = None,
        directory: str | Path = "mlruns",
        every_n_epochs: int = 5,
        flush_seconds: float = 10.0,
        timeout: float = 5.0,
        run_id: str | None = None,
    ) -> None:
        """``run_id`` continues a run; the rest is explained in ``conf/logger/mlflow.yaml``."""
        super().__init__()
        self.store = find(tracking_uri, directory)
        self.run_id = run_id
        self._experiment = experiment
        self._every, self._flush_seconds, self._timeout = every_n_epochs, flush_seconds, timeout
        # (name, epoch) -> (value, time [ms]); MLflow wants at most one value for each
        self._rows: dict[tuple[str, int], tuple[float, int]] = {}
        self._latest: dict[tuple[str, int], tuple[float, int]] = {}
        self._due, self._enough = 0.0, BATCH

    @property
    def name(self) -> str:
        """The experiment."""
        return self._experiment

    @property
    def version(self) -> str | None:
        """The run id."""
        return self.run_id

    @property
    def address(self) -> str:
        """Where the run is found."""
        if self.store.uri.startswith("http"):
            run = connect(self.store).get_run(self._open_run)
            return f"{self.store}/#/experiments/{run.info.experiment_id}/runs/{self.run_id}"
        return f"run {self.run_id} in {self.store}"

    def check(self) -> None:
        """Whether the store can be reached and written."""
        check(self.store, self._timeout)

    @contextmanager
    def run(self, *, name: str, parameters: Mapping[str, Any]) -> Iterator[None]:
        """Open the run, send what is left at the end, and close it with how it ended."""
        self.check()
        if self.run_id is None:
            parent = runs.parent_from_environment()
            self.run_id = runs.open_run(self.store, self._experiment, name=name, parent=parent)
            runs.log_parameters(self.store, self.run_id, parameters)
        else:
            runs.reopen_run(self.store, self.run_id)
        self._due = time.monotonic() + self._flush_seconds
        try:
            yield
            self._flush(everything=True)
        except BaseException as error:
            status = "FAILED" if isinstance(error, Exception) else "KILLED"
            try:
                self._flush(everything=True)
                runs.close_run(self.store, self.run_id, status, _reason(error))
            except Exception as second:  # the first error is the one to tell
                log.warning("run %s could not be closed: %s", self.run_id, _reason(second))
            raise
        runs.close_run(self.store, self.run_id, "FINISHED")

    def log_metrics(self, metrics: Mapping[str, float], step: int | None = None) -> None:
        """Collect one value of each series; ``epoch`` among them is the abscissa."""
        now = int(time.time() * 1000)
        epoch = int(metrics.get("epoch", step or 0))
        rows = {(k, epoch): (float(v), now) for k, v in metrics.items() if k != "epoch"}
        if epoch < DENSE or epoch % self._every == 0:
            self._rows |= rows
            self._latest = {}
        else:  # dropped, unless no later epoch comes
            same = {key: row for key, row in self._latest.items() if key[1] == epoch}
            self._latest = same | rows
        if len(self._rows) >= self._enough or (self._rows and time.monotonic() >= self._due):
            self._try_flush()

    def log_measures(self, measures: Mapping[str, float]) -> None:
        """Send the final measures, at once, together with all that waits."""
        now = int(time.time() * 1000)
        self._rows |= {(key, 0): (float(value), now) for key, value in measures.items()}
        self._flush(everything=True)

    def log_run_folder(self, folder: Path) -> None:
        """Copy the files of the run folder to the run's artifacts."""
        client = connect(self.store)
        for path in artifacts.present(folder):
            inside = path.relative_to(folder)
            if path.is_dir():
                client.log_artifacts(self._open_run, str(path), artifact_path=str(inside))
            else:
                parent = None if inside.parent == Path(".") else str(inside.parent)
                client.log_artifact(self._open_run, str(path), artifact_path=parent)

    def finalize(self, status: str) -> None:
        """Lightning's end of training: send what waits. The run goes on to its evaluation."""
        self._rows |= self._latest
        self._try_flush()

    def _try_flush(self) -> None:
        """Send, or put off: a store that is away must neither stop nor slow the training."""
        try:
            self._flush()
            self._enough = BATCH
        except Exception as error:
            self._due = time.monotonic() + RETRY_SECONDS
            self._enough = sys.maxsize
            log.warning("%d rows wait for the tracking store: %s", len(self._rows), _reason(error))

    def _flush(self, everything: bool = False) -> None:
        from mlflow.entities import Metric

        if everything:
            self._rows |= self._latest
        client, run_id = connect(self.store), self._open_run
        while self._rows:
            keys = list(self._rows)[:BATCH]
            rows = [Metric(k, self._rows[k, e][0], self._rows[k, e][1], e) for k, e in keys]
            client.log_batch(run_id, metrics=rows, synchronous=True)
            for key in keys:
                del self._rows[key]
        self._due = time.monotonic() + self._flush_seconds

    @property
    def _open_run(self) -> str:
        if self.run_id is None:
            raise RuntimeError("no run is open: log inside `with tracker.run(...)`")
        return self.run_id


def _reason(error: BaseException) -> str:
    """Kind and first line of an error; Lightning hides an interruption behind SystemExit."""
    if isinstance(error, SystemExit) and isinstance(error.__context__, KeyboardInterrupt):
        return "KeyboardInterrupt"
    first = next(iter(str(error).strip().splitlines()), "")
    return f"{type(error).__name__}: {first}" if first else type(error).__name__
