"""How far a sweep has come: a line whenever a job has ended."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from symo_exp.training import stopping
from symo_exp.training.outcome import Outcome

SECONDS = 0.5


class Watch:
    """Looks at the outcomes in the folders of a sweep's jobs, whichever processes do them."""

    def __init__(self, folders: Sequence[Path]) -> None:
        self._open = set(folders)
        self._counts: Counter[str] = Counter()
        self._total = len(folders)
        self._look()
        self._ended_before = self._ended
        self._start = time.monotonic()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)

    def __enter__(self) -> None:
        self._thread.start()

    def __exit__(self, *error: Any) -> None:
        self._over.set()
        self._thread.join()

    def _watch(self) -> None:
        seen = self._ended
        while True:
            last = self._over.wait(SECONDS)
            running = self._look()
            if self._ended != seen:
                seen = self._ended
                print(self._line(running), flush=True)
            if last:
                return

    @property
    def _ended(self) -> int:
        return self._counts.total()

    def _look(self) -> int:
        """Count those that have ended since; how many are running."""
        running = 0
        for folder in [*self._open]:
            status = Outcome.read(folder).status
            if status in ("finished", "failed", "refused", "interrupted"):
                self._counts[status] += 1
                self._open.remove(folder)
            running += status == "running"
        return running

    def _line(self, running: int) -> str:
        parts = [f"{self._counts['finished']} of {self._total} jobs finished"]
        bad = self._ended - self._counts["finished"]
        if bad:
            parts.append(f"{bad} not well")
        if running:
            parts.append(f"{running} running")
        if self._open and stopping.requested() is None:
            pace = (time.monotonic() - self._start) / (self._ended - self._ended_before)
            parts.append(f"about {duration(pace * len(self._open))} left")
        return ", ".join(parts)


def duration(seconds: float) -> str:
    """In the unit that a human would choose."""
    for unit, size in (("days", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 1.5 * size:
            return f"{seconds / size:.0f} {unit}"
    return f"{seconds:.0f} s"
