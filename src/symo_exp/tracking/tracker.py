"""What the entry point asks of a tracker, whichever it is; Lightning sees a logger."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

from lightning.pytorch.loggers import Logger


class Tracker(Logger):
    """Keeps what a run leaves: parameters, series, measures, files, how it ended."""

    @abstractmethod
    def check(self) -> None:
        """Raise ``ConfigError`` if nothing could be kept. Quick: asked before any training."""

    @abstractmethod
    def run(
        self, *, name: str, parameters: Mapping[str, Any], folder: Path | None = None
    ) -> AbstractContextManager[None]:
        """Open a run and close it: FINISHED, FAILED on an error, KILLED on an interruption.

        ``folder`` is the run's own: what is known there of an earlier start is continued.
        """

    @abstractmethod
    def deliver(self, folder: Path) -> None:
        """Keep what a finished run has left in its folder for this."""

    @abstractmethod
    def log_measures(self, measures: Mapping[str, float]) -> None:
        """Keep the final measures of the run."""

    @abstractmethod
    def log_run_folder(self, folder: Path) -> None:
        """Keep the files of a run folder (see ``artifacts``)."""

    @abstractmethod
    def state_dict(self) -> dict[str, Any]:
        """What is not kept yet, as plain values: it travels in the checkpoint."""

    @abstractmethod
    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """What ``state_dict`` gave, in a process that goes on with the training."""

    @property
    @abstractmethod
    def address(self) -> str:
        """Where to look, for a human; empty if nowhere."""

    def log_hyperparams(self, params: Any, *args: Any, **kwargs: Any) -> None:
        """Ignored: the parameters of a run are its configuration, given to ``run``."""
