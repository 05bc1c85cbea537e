"""Progress and result of a sweep in lines of 80 columns."""

from __future__ import annotations

import math
import re
import textwrap
import threading
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from symo_exp.evaluation.verdict import comparison, verdict
from symo_exp.job.lines import MEASURES, brief, parameter_lines, run_line, units_of
from symo_exp.process import phases, stopping
from symo_exp.process.terminal import fitted_lines
from symo_exp.report.looks import all_angles, duration, label_and_unit, written
from symo_exp.runs.folder import LOG, RunFolder
from symo_exp.runs.outcome import Outcome
from symo_exp.words import counted

ENDED = "finished", "failed", "refused", "interrupted"
WIDTH = 80
LISTED = 3
"""Runs with equal reasons that are named, at most."""
SECONDS, PAUSE = 0.5, 20.0
"""Least time between two looks at all runs [s], and over the time that a look takes."""


def table(labels: Sequence[str], folders: Sequence[RunFolder]) -> str:
    """Return a row per run, the best of each system marked; reasons of those that did not finish.

    Errors of different systems have nothing to do with each other.
    """
    outcomes = [folder.outcome() for folder in folders]
    found = [
        folder.measures() if outcome.status == "finished" else {}
        for folder, outcome in zip(folders, outcomes, strict=True)
    ]
    shown = [name for name in MEASURES if any(name in measures for measures in found)]
    abouts = [folder.about() for folder in folders]
    systems = [about and about.parameters.get("system") for about in abouts]
    columns = [_column(name, found, systems) for name in shown]
    columns.append(["time", *(f"{outcome.seconds:.0f} s" for outcome in outcomes)])
    room = WIDTH - sum(max(map(len, column)) + 2 for column in columns)
    names = ["", *_fitted([brief(label) for label in labels], max(room, 12))]
    lines = aligned(names, columns)
    if shown:
        best = "* the best" + " of its system" * (len({*systems} - {None}) > 1)
        told = "; ".join([*[best] * (len(folders) > 1), *units_of(shown, found)])
        lines += textwrap.wrap(told, WIDTH)
    verdicts = _verdicts(names[1:] if len(folders) > 1 else ["verdict"], found)
    parameters = parameter_lines(folders[0]) if len(folders) == 1 and found[0] else []
    return "\n".join(
        [*lines, *fitted_lines(parameters), *verdicts, *_unfinished(labels, folders, outcomes)]
    )


def aligned(names: Sequence[str], columns: Sequence[Sequence[str]]) -> list[str]:
    """Return a line for each name and its cells, names on the left and cells on the right."""
    first = [name.ljust(max(map(len, names))) for name in names]
    others = [[cell.rjust(max(map(len, column))) for cell in column] for column in columns]
    return ["  ".join(cells) for cells in zip(first, *others, strict=True)]


def _unfinished(
    labels: Sequence[str], folders: Sequence[RunFolder], outcomes: Sequence[Outcome]
) -> list[str]:
    """Return why runs did not finish, a line each; more than ``LISTED`` alike are counted."""
    alike: dict[tuple[str, str], list[str]] = {}
    for label, folder, outcome in zip(labels, folders, outcomes, strict=True):
        log = folder / LOG
        if outcome.status != "finished":
            reason = outcome.reason + f" (log: {log})" * log.exists()
            alike.setdefault((outcome.status, reason), []).append(label)
    return [
        f"{status}: {name}: {reason}"
        for (status, reason), names in alike.items()
        for name in (names if len(names) <= LISTED else [counted(len(names), "run")])
    ]


def _verdicts(names: Sequence[str], found: Sequence[Mapping[str, float]]) -> list[str]:
    """Return the verdicts on models of recordings beside the baseline, a line each."""
    lines = []
    for name, measures in zip(names, found, strict=True):
        _, unit = label_and_unit("rmse_1s", all_angles(measures.keys(), measures.values()))
        told = [text for text in (verdict(measures), comparison(measures, unit)) if text]
        if told:
            lines.append(f"{name}: {'; '.join(told)}")
    return lines


def _column(
    name: str, found: Sequence[Mapping[str, float]], systems: Sequence[object]
) -> list[str]:
    values = [measures.get(name, math.nan) for measures in found]
    there: dict[object, list[float]] = {system: [] for system in systems}
    for system, x in zip(systems, values, strict=True):
        there[system] += [] if math.isnan(x) else [x]
    best = {system: min(xs) for system, xs in there.items() if len(xs) > 1}
    unmarked = " " * (len(found) > 1)  # no place for a mark where there is nothing to compare
    cells = [
        f"{written(x)}{'*' if x == best.get(system) else unmarked}" if name in measures else "- "
        for x, measures, system in zip(values, found, systems, strict=True)
    ]
    return [MEASURES[name] + unmarked, *cells]


def _fitted(names: Sequence[str], room: int) -> list[str]:
    """Return names cut to ``room`` columns, or to as many more as tell different ones apart."""
    short = [_cut(name, room) for name in names]
    while len(set(short)) < len(set(names)):
        room += 1 + room // 100  # lists of files may be long
        short = [_cut(name, room) for name in names]
    return short


def _cut(text: str, room: int) -> str:
    """Return a name cut in that of a setting, whose value is told whole, or else in the middle."""
    over = len(text) - room
    if over <= 0:
        return text
    key = max(re.findall(r"\w+(?==)", text), key=len, default="")
    if len(key) > over + 1:
        return text.replace(f"{key}=", f"{key[: -over - 1]}…=")
    half = (room - 1) // 2
    return f"{text[:half]}…{text[len(text) - (room - half - 1) :]}"


class Watch:
    """Print a line whenever a run of the sweep ends, in any process.

    Args:
        folders: The runs.
        on_stop: Called once when the command is asked to stop.
        apart: The runs are in other processes; a terminal shows how many are running.
    """

    def __init__(
        self, folders: Sequence[RunFolder], on_stop: Any = None, *, apart: bool = False
    ) -> None:
        self._open = set(folders)
        self._counts: Counter[str] = Counter()
        self._total = len(folders)
        self._on_stop, self._apart = on_stop, apart
        self._running = 0
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
        pause = SECONDS
        while True:
            last = self._over.wait(pause)
            before, start = self._counts.total(), time.monotonic()
            ended = self._look()
            pause = max(SECONDS, PAUSE * (time.monotonic() - start))
            for place, folder in enumerate(ended if self._total > 1 else (), before + 1):
                phases.clear()
                print(f"{place} of {self._total}: {run_line(folder)}", flush=True)
            if self._total > 1 and (self._apart or ended) and not last:
                phases.say(self._line())
            if self._on_stop is not None and stopping.requested() is not None:
                self._on_stop()
                self._on_stop = None
            if last:
                return

    def _look(self) -> list[RunFolder]:
        """Return the runs that have ended since."""
        status = {folder: folder.outcome().status for folder in self._open}
        ended = [folder for folder in status if status[folder] in ENDED]
        self._counts.update(status[folder] for folder in ended)
        self._open.difference_update(ended)
        self._running = sum(one == "running" for one in status.values())
        return ended

    def _line(self) -> str:
        parts = [f"{self._counts['finished']} of {self._total} runs finished"]
        bad = self._counts.total() - self._counts["finished"]
        if bad:
            parts.append(f"{bad} failed")
        if self._running:
            parts.append(f"{self._running} running")
        ended = self._counts.total() - self._ended_before
        if self._open and ended and stopping.requested() is None:
            pace = (time.monotonic() - self._start) / ended
            parts.append(f"about {duration(pace * len(self._open))} left")
        return ", ".join(parts)
