"""The folder of a run, which contains all of its state; stores and reports are views of it.

| file | what it holds | written |
| --- | --- | --- |
| ``run.json`` | parameters, variant, code revision, digest of recordings | at the first start |
| ``config.yaml`` | the resolved configuration, which builds the model again | at each start |
| ``outcome.json`` | status, and the reason of an early end | at each change |
| ``series.csv`` | a row for each epoch (``runs.series``) | while it trains |
| ``checkpoints/`` | the state of the training | while it trains |
| ``metrics.json`` | the measures | at the end |
| ``parameters.csv`` | physical parameters: values, standard deviations, units | at the end |
| ``posterior.pt`` | the posterior of all parameters of the model | at the end |
| ``folds.json`` | the runs of a cross-validation with the same settings | by a search |
| ``*.parquet``, ``pictures/``, ``studies/`` | the numbers behind them | at the end |
| ``published.json`` | a cache: the store that has all of this | by the tracker |

A process that works on the run holds the lock of its folder. A run that says ``running`` while
the lock is free has died.
"""

from __future__ import annotations

import csv
import json
import logging
import math
import os
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from symo_exp.errors import without_passwords
from symo_exp.files import read_json, write_state, write_text, write_whole
from symo_exp.locks import where_possible
from symo_exp.runs.outcome import About, Outcome, Status, this_process

log = logging.getLogger(__name__)

CONFIG, CHECKPOINTS, LAST, PREVIOUS = "config.yaml", "checkpoints", "last.ckpt", "previous.ckpt"
CHECKPOINT = f"{CHECKPOINTS}/{LAST}"
SERIES, MEASURES, ROLLOUTS = "series.csv", "metrics.json", "rollouts.parquet"
WINDOWS, PICTURES, STUDIES, LOG = "windows.parquet", "pictures", "studies", "symo_exp.log"
PARAMETERS, POSTERIOR = "parameters.csv", "posterior.pt"
FILES = (
    CONFIG, SERIES, CHECKPOINT, MEASURES, PARAMETERS, POSTERIOR, ROLLOUTS, WINDOWS, PICTURES,
    STUDIES,
)  # fmt: skip
"""Files of a run that a store keeps."""
CANDIDATES, BEST = "candidates.csv", "best"
"""Of a search, beside the folders of its runs; the second is a link to one."""
ABOUT, OUTCOME, PUBLISHED, FOLDS = "run.json", "outcome.json", "published.json", "folds.json"

NOT_STARTED = "it did not run, or could not record how it ended"
DIED = "its process was killed, perhaps for want of memory"


class RunFolder:
    """The files of one run by name; no other module knows their paths."""

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path).absolute()

    def __str__(self) -> str:
        return os.path.relpath(self.path)

    def __truediv__(self, name: str) -> Path:
        return self.path / name

    # -- the lock -----------------------------------------------------------------------------

    @contextmanager
    def alone(self) -> Iterator[None]:
        """Hold the lock; wait for it while another process works on the same run."""
        with ExitStack() as stack:
            with where_possible():
                try:
                    stack.enter_context(self._lock().acquire(timeout=0))
                except Timeout:
                    log.info("%s: another process works on this run; waiting for it", self)
                    stack.enter_context(self._lock().acquire(poll_interval=0.5))
            yield

    def in_use(self) -> bool:
        """Return whether a process holds the lock; false where there are no locks."""
        if not (self / ".lock").exists():
            return False
        try:
            with self._lock().acquire(timeout=0):
                return False
        except Timeout:
            return True
        except (OSError, NotImplementedError):  # a place without locks, or only to be read
            return False

    def died(self) -> bool:
        """Return whether the process of the run was killed."""
        return self.outcome().status == "running" and not self.in_use()

    def _lock(self) -> FileLock:
        self.path.mkdir(parents=True, exist_ok=True)
        return FileLock(self / ".lock")

    # -- the outcome --------------------------------------------------------------------------

    def outcome(self) -> Outcome:
        """Return the outcome; a folder without a readable one waits to be started."""
        try:
            return Outcome(**self._read(OUTCOME))
        except TypeError:
            return Outcome("waiting", NOT_STARTED)

    def record(self, status: Status, reason: str = "", seconds: float = 0.0) -> None:
        """Write the status, and of a running one the process.

        Args:
            status: How the run stands.
            reason: Why it did not finish.
            seconds: Of work since the last record; those before are kept.
        """
        process = this_process() if status == "running" else {}
        spent = self.outcome().seconds + seconds
        self._write(OUTCOME, asdict(Outcome(status, reason, spent, process)))

    def await_start(self) -> None:
        """Record that the run, if it was started before, waits to be started again."""
        if (self / OUTCOME).exists():
            self.record("waiting", NOT_STARTED)

    def forget_outcome(self) -> None:
        """Delete the outcome."""
        (self / OUTCOME).unlink(missing_ok=True)

    def clear(self) -> None:
        """Delete everything that could be resumed, and the results.

        The outcome is the first: a process that is killed meanwhile leaves no finished run.
        """
        self.forget_outcome()
        for name in (CHECKPOINTS, STUDIES, PICTURES):
            shutil.rmtree(self / name, ignore_errors=True)
        results = MEASURES, PARAMETERS, POSTERIOR, ROLLOUTS, WINDOWS
        for name in (SERIES, ABOUT, PUBLISHED, *results):
            (self / name).unlink(missing_ok=True)

    def has_results(self) -> bool:
        """Return whether there is anything that a command would go on with."""
        return self.outcome().status == "finished" or any((self / CHECKPOINTS).glob("*.ckpt"))

    # -- description and results -----------------------------------------------------------------

    def about(self) -> About | None:
        """Return the description of the run, ``None`` in a new folder."""
        try:
            return About(**self._read(ABOUT))
        except TypeError:
            return None

    def describe(self, about: About) -> None:
        """Write the description; identity, time and sweep of the first start are kept.

        It is read by all who may read a store, and has no passwords.
        """
        before = self.about()
        if before is not None:
            about = replace(
                about,
                identity=before.identity,
                started=before.started,
                sweep=before.sweep or about.sweep,
            )
        self._write(ABOUT, asdict(about))

    def measures(self, studies: Iterable[str] | None = None) -> dict[str, float]:
        """Return the measures of the run and of some or all studies; none before their end."""
        found = self._read(MEASURES)
        if studies is None:
            studies = sorted(file.stem for file in (self / STUDIES).glob("*.json"))
        for name in studies:
            found |= self._read(f"{STUDIES}/{name}.json").get("measures", {})
        return {name: float(value) for name, value in found.items()}

    def has_damaged_measures(self) -> bool:
        """Return whether the file of the measures holds none, or something else."""
        try:
            found = self.measures(())
        except (TypeError, ValueError):
            found = {}
        return (self / MEASURES).exists() and not found

    def write_measures(self, measures: Mapping[str, float]) -> None:
        """Write the measures of the run."""
        self._write(MEASURES, _finite(measures))

    def parameters(self) -> list[dict[str, str]]:
        """Return the rows of ``parameters.csv``; none where there is no such file."""
        if not (self / PARAMETERS).exists():
            return []
        with (self / PARAMETERS).open(encoding="utf-8", newline="") as file:
            return list(csv.DictReader(file))

    def write_parameters(self, rows: Sequence[Mapping[str, Any]]) -> None:
        """Write the physical parameters, if there are any."""

        def write(path: Path) -> None:
            with path.open("w", encoding="utf-8", newline="") as file:
                table = csv.DictWriter(file, fieldnames=list(rows[0]), lineterminator="\n")
                table.writeheader()
                table.writerows(rows)

        if rows:
            write_whole(self / PARAMETERS, write)

    def write_posterior(self, state: Mapping[str, Any]) -> None:
        """Write the posterior of a model's parameters."""
        write_state(self / POSTERIOR, dict(state))

    def folds(self) -> list[RunFolder]:
        """Return the runs of a cross-validation with the same settings, those that exist."""
        paths = [self.path / name for name in self._read(FOLDS).get("runs", [])]
        return [RunFolder(os.path.normpath(path)) for path in paths if (path / CONFIG).exists()]

    def write_folds(self, runs: Sequence[RunFolder]) -> None:
        """Write which runs are those of a cross-validation with the same settings."""
        self._write(FOLDS, {"runs": [os.path.relpath(run.path, self.path) for run in runs]})

    def write_config(self, config: Mapping[str, Any]) -> None:
        """Write the resolved settings, without passwords."""
        import yaml

        text = yaml.safe_dump(dict(config), sort_keys=False, allow_unicode=True)
        write_text(self / CONFIG, without_passwords(text))

    def config(self) -> dict[str, Any]:
        """Return the resolved settings; none before the run starts, or if they cannot be read."""
        import yaml

        try:
            config = yaml.safe_load((self / CONFIG).read_text(encoding="utf-8"))
        except (OSError, ValueError, yaml.YAMLError):
            return {}
        return config if isinstance(config, dict) else {}

    def is_measured(self, reference: Any) -> bool:
        """Return whether the measures were computed, with these settings of a reference model.

        Those of a damaged file are to be computed again.
        """
        there = (self / MEASURES).exists() and not self.has_damaged_measures()
        config = self.config() if there else {}
        return bool(config) and bool(config.get("reference") == reference)

    def write_table(self, name: str, columns: Mapping[str, Any]) -> None:
        """Write columns of equal length as a Parquet file."""
        import pyarrow
        import pyarrow.parquet

        table = pyarrow.table(dict(columns))
        write_whole(
            self / name,
            lambda file: pyarrow.parquet.write_table(table, file, compression="zstd"),
        )

    def missing_studies(self, asked: Mapping[str, Any]) -> list[str]:
        """Return the names of the studies not yet done with these settings."""
        done = {name: self._read(f"{STUDIES}/{name}.json").get("settings") for name in asked}
        return [name for name, settings in asked.items() if done[name] != settings]

    def write_study(
        self,
        name: str,
        settings: Mapping[str, Any],
        measures: Mapping[str, float],
        columns: Mapping[str, Any],
    ) -> None:
        """Write a study; its settings are written last and mark it as done."""
        if columns:
            self.write_table(f"{STUDIES}/{name}.parquet", columns)
        told = {"settings": dict(settings), "measures": _finite(measures)}
        self._write(f"{STUDIES}/{name}.json", told)

    def files(self) -> list[Path]:
        """Return the existing ones of ``FILES``."""
        return [self / name for name in FILES if (self / name).exists()]

    # -- the store --------------------------------------------------------------------------------

    def published(self) -> dict[str, Any]:
        """Return the store that has all of this folder."""
        return self._read(PUBLISHED)

    def mark_published(self, store: Mapping[str, Any] | None) -> None:
        """Remember the store that has all of this; ``None``: the folder has changed."""
        if store is None:
            (self / PUBLISHED).unlink(missing_ok=True)
        else:
            self._write(PUBLISHED, dict(store))

    def _read(self, name: str) -> dict[str, Any]:
        return read_json(self / name)

    def _write(self, name: str, content: Mapping[str, Any]) -> None:
        text = json.dumps(dict(content), indent=1, default=str) + "\n"
        write_text(self / name, without_passwords(text))


def _finite(measures: Mapping[str, float]) -> dict[str, float | str]:
    """``"inf"`` and ``"nan"`` as words, since JSON has no such numbers."""
    return {k: x if math.isfinite(x) else str(float(x)) for k, x in measures.items()}
