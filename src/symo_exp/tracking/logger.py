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

from symo_exp.errors import ConfigError
from symo_exp.tracking import artifacts, runs, spool
from symo_exp.tracking.memory import recall, remember
from symo_exp.tracking.spool import Letter
from symo_exp.tracking.store import check, connect, find, is_away
from symo_exp.tracking.tracker import Tracker

log = logging.getLogger(__name__)

BATCH = 500
"""Rows in one request; MLflow accepts 1000, but the cost of a row grows above this."""
DENSE = 100
"""Epochs at the start that are all kept, however thin the rest: short runs lose nothing."""
RETRY_SECONDS = 60.0


class MlflowTracker(Tracker):
    """Series, parameters, measures and files of one run in MLflow.

    A store that fails does not stop a training: rows wait and are sent later, at the latest when
    the command is given again. A run that was cut is continued, and nothing is told twice.
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
        if every_n_epochs < 1:
            raise ConfigError(f"logger.every_n_epochs={every_n_epochs} must be at least 1")
        if not flush_seconds >= 0.0:
            raise ConfigError(f"logger.flush_seconds={flush_seconds} must be 0 or more seconds")
        if not timeout > 0.0:
            raise ConfigError(f"logger.timeout={timeout} must be above 0 seconds")
        self.store = find(tracking_uri, directory)
        self.run_id = run_id
        self._experiment = experiment
        self._every, self._flush_seconds, self._timeout = every_n_epochs, flush_seconds, timeout
        # (name, epoch) -> (value, time [ms]); MLflow wants at most one value for each
        self._rows: dict[tuple[str, int], tuple[float, int]] = {}
        self._latest: dict[tuple[str, int], tuple[float, int]] = {}
        self._told: set[tuple[str, int]] = set()
        self._due, self._enough = 0.0, BATCH
        self._about: Letter | None = None
        self._folder: Path | None = None
        self._files: Path | None = None
        self._is_open, self._address = False, ""

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
        return self._address or f"not yet in {self.store}"

    def check(self) -> None:
        """Whether the store can be reached and written."""
        check(self.store, self._timeout)

    @contextmanager
    def run(
        self, *, name: str, parameters: Mapping[str, Any], folder: Path | None = None
    ) -> Iterator[None]:
        """Open the run, send what is left at the end, and close it with how it ended.

        The run ``folder`` remembers the run of the store, so that one that was cut is continued;
        and it keeps what a finished run could not send (see ``deliver``).
        """
        self._about = Letter(name, dict(parameters), runs.parent_from_environment(), {})
        self._folder = folder
        try:
            self._open()
        except Exception as error:
            if not is_away(error):
                raise
            log.warning("the run starts without its tracking store: %s", _reason(error))
        self._due = time.monotonic() + self._flush_seconds
        try:
            yield
        except BaseException as error:
            status = "FAILED" if isinstance(error, Exception) else "KILLED"
            try:
                self._send()
                runs.close_run(self.store, self._open_run, status, _reason(error))
            except Exception as second:  # the first error is the one to tell
                log.warning("run %s could not be closed: %s", self.run_id, _reason(second))
            raise
        self._rows |= self._latest
        self._finish()

    def deliver(self, folder: Path) -> None:
        """Send what a finished run has kept in its folder because the store was away."""
        self._about, self._folder, self._files = spool.read(folder), folder, folder
        self._rows = dict(self._about.rows)
        self._finish()

    def _open(self) -> None:
        """Continue the run that the folder remembers, or open one."""
        assert self._about is not None
        self.check()
        about, folder = self._about, self._folder
        known = self.run_id or (recall(folder, self.store) if folder else None)
        if known is not None and runs.exists(self.store, known):
            runs.reopen_run(self.store, known, about.parent)
        else:
            where = str(folder.absolute()) if folder else ""
            known = runs.open_run(
                self.store, self._experiment, name=about.name, parent=about.parent, folder=where
            )
        if folder:
            remember(folder, self.store, known)
        runs.log_parameters(self.store, known, about.parameters)
        self._told = runs.told(self.store, known)
        self._address = runs.address(self.store, known)
        self.run_id, self._is_open = known, True

    def _finish(self) -> None:
        """Send all that is left and close the run; what cannot be sent now is kept."""
        assert self._about is not None
        try:
            self._send()
            if self._files is not None:
                self._upload(self._files)
            runs.close_run(self.store, self._open_run, "FINISHED")
        except Exception as error:
            if self._folder is None:
                raise
            spool.write(self._folder, self._about._replace(rows=self._rows))
            log.warning(
                "the tracking store is away (%s): %s is sent when the command is given again",
                _reason(error),
                self._folder / spool.FILE,
            )
        else:
            if self._folder is not None:
                spool.remove(self._folder)

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
            self._try_to_send()

    def log_measures(self, measures: Mapping[str, float]) -> None:
        """Collect the final measures, too; they are sent when the run is closed."""
        if self._about is None:
            raise RuntimeError("no run is open: log inside `with tracker.run(...)`")
        now = int(time.time() * 1000)
        self._rows |= {(key, 0): (float(value), now) for key, value in measures.items()}

    def log_run_folder(self, folder: Path) -> None:
        """Copy the files of the run folder to the run's artifacts when the run is closed."""
        self._files = folder

    def finalize(self, status: str) -> None:
        """Lightning's end of training: send what waits. The run goes on to its evaluation."""
        if status == "success":  # a training that was cut has had no last epoch
            self._rows |= self._latest
        self._try_to_send()

    def state_dict(self) -> dict[str, Any]:
        """What is not sent yet, for a checkpoint."""
        return {"rows": spool.as_list(self._rows), "latest": spool.as_list(self._latest)}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on with what was not sent when the checkpoint was written."""
        self._rows = spool.as_rows(state.get("rows", []))
        self._latest = spool.as_rows(state.get("latest", []))

    def _try_to_send(self) -> None:
        """Send, or put off: a store that is away must neither stop nor slow the training."""
        try:
            self._send()
            self._enough = BATCH
        except Exception as error:
            self._due = time.monotonic() + RETRY_SECONDS
            self._enough = sys.maxsize
            log.warning("%d rows wait for the tracking store: %s", len(self._rows), _reason(error))

    def _send(self) -> None:
        from mlflow.entities import Metric

        if not self._is_open:
            self._open()
        self.check()  # answers sooner than MLflow, which tries again and again
        client, run_id = connect(self.store), self._open_run
        self._rows = {key: row for key, row in self._rows.items() if key not in self._told}
        while self._rows:
            keys = list(self._rows)[:BATCH]
            rows = [Metric(k, self._rows[k, e][0], self._rows[k, e][1], e) for k, e in keys]
            client.log_batch(run_id, metrics=rows, synchronous=True)
            for key in keys:
                del self._rows[key]
        self._due = time.monotonic() + self._flush_seconds

    def _upload(self, folder: Path) -> None:
        client = connect(self.store)
        for path in artifacts.present(folder):
            inside = path.relative_to(folder)
            if path.is_dir():
                client.log_artifacts(self._open_run, str(path), artifact_path=str(inside))
            else:
                parent = None if inside.parent == Path(".") else str(inside.parent)
                client.log_artifact(self._open_run, str(path), artifact_path=parent)

    @property
    def _open_run(self) -> str:
        if self.run_id is None:
            raise RuntimeError("no run is open: log inside `with tracker.run(...)`")
        return self.run_id


def _reason(error: BaseException) -> str:
    """Kind and first line of an error."""
    first = next(iter(str(error).strip().splitlines()), "")
    return f"{type(error).__name__}: {first}" if first else type(error).__name__
