"""No store: the folder of a run has everything."""

from __future__ import annotations

from collections.abc import Sequence

from symo_exp.runs.folder import RunFolder


class Nowhere:
    """Publishes nothing."""

    flush_seconds = float("inf")

    def check(self) -> None:
        """Nothing can be wrong."""

    def is_away(self, error: BaseException) -> bool:
        """It never is."""
        return False

    def is_published(self, folder: RunFolder) -> bool:
        """There is nothing to do."""
        return True

    def publish(self, folder: RunFolder) -> str:
        """There is no address either."""
        return ""

    def show(self, varied: Sequence[str]) -> None:
        """There is no page to set up,"""

    def page(self) -> str:
        """nor to open."""
        return ""

    def close_dead(self) -> None:
        """There are none."""
