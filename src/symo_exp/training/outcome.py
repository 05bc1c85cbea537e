"""How each run of a command ended: a small file in its folder, and the table of all of them."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Literal

Status = Literal["finished", "failed", "refused"]
FILE = "outcome.json"
MEASURES = ("train_mse", "test_mse", "integration_mse", "energy_mse", "inertia_mse")
"""The five that a line shows; the others are in the files of the run."""


@dataclass(frozen=True)
class Outcome:
    """A finished run has measures, any other a reason; bad input is refused, not failed."""

    status: Status
    reason: str = ""
    measures: dict[str, float] = field(default_factory=dict)
    seconds: float = 0.0

    def write(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        new = folder / f".{FILE}.{os.getpid()}"
        new.write_text(json.dumps(asdict(self), indent=1) + "\n", encoding="utf-8")
        os.replace(new, folder / FILE)

    @staticmethod
    def read(folder: Path) -> Outcome:
        """What the run left; a run that left nothing was killed or never started."""
        try:
            return Outcome(**json.loads((folder / FILE).read_text(encoding="utf-8")))
        except FileNotFoundError:
            return Outcome("failed", "it did not run to its end")

    @staticmethod
    def forget(folder: Path) -> None:
        (folder / FILE).unlink(missing_ok=True)


def one_line(measures: Mapping[str, float]) -> str:
    """The five measures; a method without an inertia has four."""
    return "  ".join(f"{name} {measures[name]:.3g}" for name in MEASURES if name in measures)


def table(labels: Sequence[str], outcomes: Sequence[Outcome], logs: Sequence[Path]) -> str:
    """A row for each run, and for those that failed the reason and the log."""
    rows = [["run", *MEASURES, "seconds"]]
    for label, outcome in zip(labels, outcomes, strict=True):
        cells = (outcome.measures.get(name) for name in MEASURES)
        numbers = ["-" if x is None else f"{x:.3g}" for x in cells]
        rows.append([label, *numbers, f"{outcome.seconds:.0f}"])
    failures = [
        f"{outcome.status}: {label}: {outcome.reason} (log: {log})"
        for label, outcome, log in zip(labels, outcomes, logs, strict=True)
        if outcome.status != "finished"
    ]
    return "\n".join([*_columns(rows), *failures])


def _columns(rows: Sequence[Sequence[str]]) -> Iterable[str]:
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    for row in rows:
        first, *rest = row
        numbers = (cell.rjust(width) for cell, width in zip(rest, widths[1:], strict=True))
        yield "  ".join([first.ljust(widths[0]), *numbers])
