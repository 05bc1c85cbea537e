"""A tracker without a store: the run folder has everything."""

from __future__ import annotations

from collections.abc import Sequence

from symo_exp.runs.folder import RunFolder


class Nowhere:
    """Publishes nothing."""

    flush_seconds = float("inf")

    def check(self) -> None:
        """Do nothing: there is no store to reach."""

    def is_published(self, folder: RunFolder) -> bool:
        """Return true: there is nothing to publish."""
        return True

    def publish(self, folder: RunFolder) -> None:
        """Do nothing."""

    def show(self, varied: Sequence[str]) -> None:
        """Do nothing."""

    def page(self) -> str:
        """Return no page."""
        return ""

    def close_dead(self) -> None:
        """Do nothing."""
