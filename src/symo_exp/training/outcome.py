"""How far each run of a command has come: a small file in its folder, and the table of all."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Literal

from symo_exp.files import write_whole

Status = Literal["waiting", "running", "finished", "failed", "refused", "interrupted"]
FILE = "outcome.json"
MEASURES = ("train_mse", "test_mse", "integration_mse", "energy_mse", "inertia_mse")
"""The five that a line shows; the others are in the files of the run."""


@dataclass(frozen=True)
class Outcome:
    """A finished run has measures, one that ended otherwise a reason: bad input is refused, not
    failed. A run that goes on names its process (see ``tracking.process``)."""

    status: Status
    reason: str = ""
    measures: dict[str, float] = field(default_factory=dict)
    seconds: float = 0.0
    process: dict[str, str] = field(default_factory=dict)

    def write(self, folder: Path) -> None:
        text = json.dumps(asdict(self), indent=1) + "\n"
        write_whole(folder / FILE, lambda path: path.write_text(text, encoding="utf-8"))

    @staticmethod
    def read(folder: Path) -> Outcome:
        """What the run left; one that has left nothing that can be read waits to be started."""
        try:
            return Outcome(**json.loads((folder / FILE).read_text(encoding="utf-8")))
        except (OSError, ValueError, TypeError):
            return Outcome("waiting", "it did not run")

    @staticmethod
    def forget(folder: Path) -> None:
        (folder / FILE).unlink(missing_ok=True)


def one_line(measures: Mapping[str, float]) -> str:
    """The five measures; a method without an inertia has four."""
    return "  ".join(f"{name} {measures[name]:.3g}" for name in MEASURES if name in measures)


def table(labels: Sequence[str], outcomes: Sequence[Outcome], logs: Sequence[Path]) -> str:
    """A row for each run, and for those that are not finished the reason and the log."""
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
