"""Tracking switched off."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any

from symo_exp.tracking.tracker import Tracker


class NoTracker(Tracker):
    """Keeps nothing; the run folder still has everything but the series."""

    @property
    def name(self) -> str:
        """None."""
        return "none"

    @property
    def version(self) -> str:
        """None."""
        return ""

    @property
    def address(self) -> str:
        """Nowhere."""
        return ""

    def check(self) -> None:
        """Nothing can be wrong."""

    def run(
        self, *, name: str, parameters: Mapping[str, Any], folder: Path | None = None
    ) -> AbstractContextManager[None]:
        """A run that leaves no trace."""
        return nullcontext()

    def deliver(self, folder: Path) -> None:
        """Nothing is left undone."""

    def state_dict(self) -> dict[str, Any]:
        """Nothing."""
        return {}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Nothing."""

    def log_metrics(self, metrics: Mapping[str, float], step: int | None = None) -> None:
        """Nothing."""

    def log_measures(self, measures: Mapping[str, float]) -> None:
        """Nothing."""

    def log_run_folder(self, folder: Path) -> None:
        """Nothing."""
