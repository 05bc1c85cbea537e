"""How far a sweep has come and how it ended, as a person reads it."""

from __future__ import annotations

import math
import threading
import time
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from symo_exp.runs.folder import LOG, RunFolder
from symo_exp.training import stopping

MEASURES = ("train_mse", "test_mse", "integration_mse", "energy_mse", "inertia_mse")
"""The five that a line shows; the others are in the files of the run."""
RECORDED = "rmse_2s"
"""Of runs on recordings it is shown, too."""
SECONDS = 0.5


def written(x: float) -> str:
    """Three digits: ``1.38e-4``, ``0.498``."""
    if x == 0 or not math.isfinite(x) or 1e-2 <= abs(x) < 1e3:
        return f"{x:.3g}"
    digits, exponent = f"{x:.2e}".split("e")
    return f"{digits}e{int(exponent)}"


def one_line(measures: Mapping[str, float]) -> str:
    """The measures that a line shows, those that there are."""
    names = (name for name in (*MEASURES, RECORDED) if name in measures)
    return "  ".join(f"{name} {measures[name]:.3g}" for name in names)


def table(labels: Sequence[str], folders: Sequence[RunFolder]) -> str:
    """A row for each run, and for those that are not finished the reason and the log."""
    recorded = any(RECORDED in folder.measures() for folder in folders)
    shown = (*MEASURES, RECORDED) if recorded else MEASURES
    rows, failures = [["run", *shown, "seconds"]], []
    for label, folder in zip(labels, folders, strict=True):
        outcome, measures = folder.outcome(), folder.measures()
        finished = outcome.status == "finished"
        cells = (measures.get(name) if finished else None for name in shown)
        numbers = ["-" if x is None else f"{x:.3g}" for x in cells]
        rows.append([label, *numbers, f"{outcome.seconds:.0f}"])
        if not finished:
            failures.append(f"{outcome.status}: {label}: {outcome.reason} (log: {folder / LOG})")
    return "\n".join([*_columns(rows), *failures])


def _columns(rows: Sequence[Sequence[str]]) -> Iterable[str]:
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    for row in rows:
        first, *rest = row
        numbers = (cell.rjust(width) for cell, width in zip(rest, widths[1:], strict=True))
        yield "  ".join([first.ljust(widths[0]), *numbers])


class Watch:
    """A line whenever a run of the sweep has ended, whichever process does it.

    ``on_stop`` is called once, when the command has been asked to stop.
    """

    def __init__(self, folders: Sequence[RunFolder], on_stop: Any = None) -> None:
        self._open = set(folders)
        self._counts: Counter[str] = Counter()
        self._total = len(folders)
        self._on_stop = on_stop
        self._look()
        self._ended_before = self._counts.total()
        self._start = time.monotonic()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)

    def __enter__(self) -> None:
        self._thread.start()

    def __exit__(self, *error: Any) -> None:
        self._over.set()
        self._thread.join()

    def _watch(self) -> None:
        seen = self._counts.total()
        while True:
            last = self._over.wait(SECONDS)
            running = self._look()
            if self._counts.total() != seen and self._total > 1:
                seen = self._counts.total()
                print(self._line(running), flush=True)
            if self._on_stop is not None and stopping.requested() is not None:
                self._on_stop()
                self._on_stop = None
            if last:
                return

    def _look(self) -> int:
        """Count those that have ended since; how many are running."""
        running = 0
        for folder in [*self._open]:
            status = folder.outcome().status
            if status in ("finished", "failed", "refused", "interrupted"):
                self._counts[status] += 1
                self._open.remove(folder)
            running += status == "running"
        return running

    def _line(self, running: int) -> str:
        parts = [f"{self._counts['finished']} of {self._total} runs finished"]
        bad = self._counts.total() - self._counts["finished"]
        if bad:
            parts.append(f"{bad} not well")
        if running:
            parts.append(f"{running} running")
        if self._open and stopping.requested() is None:
            ended = self._counts.total() - self._ended_before
            pace = (time.monotonic() - self._start) / max(ended, 1)
            parts.append(f"about {duration(pace * len(self._open))} left")
        return ", ".join(parts)


def duration(seconds: float) -> str:
    """In the unit that a human would choose."""
    for unit, size in (("days", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 1.5 * size:
            return f"{seconds / size:.0f} {unit}"
    return f"{seconds:.0f} s"
