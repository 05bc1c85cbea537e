"""The series of a run, ``series.csv``: a row per epoch, a column per quantity."""

from __future__ import annotations

import csv
import io
import os
import time
from collections.abc import Mapping
from pathlib import Path

from symo_exp.files import write_text

EPOCH, TIME = "epoch", "time"
"""The first columns: the number of the epoch, and when it ended [s since 1970]."""

Row = dict[str, float]


class Series:
    """Rows appended at the end of epochs; a resumed training first cuts those to be repeated.

    A row that cannot be written, for instance on a full disk, waits for the next one.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._columns = _header(path)
        self._waiting: list[Row] = []

    def append(self, epoch: int, values: Mapping[str, float]) -> None:
        """Append a row.

        Raises:
            OSError: If nothing can be written; the row is kept for the next call.
        """
        self._waiting.append({EPOCH: epoch, TIME: time.time(), **values})
        self.flush()

    def flush(self, *, settle: bool = False) -> None:
        """Write waiting rows; with ``settle`` flush them to the disk."""
        new = [name for row in self._waiting for name in row if name not in self._columns]
        if new:  # a quantity that was not there before: seldom, so the file is written anew
            before, rows = self._columns, read(self.path) + self._waiting
            self._columns = [*before, *dict.fromkeys(new)]
            try:
                self._replace(rows)
            except OSError:
                self._columns = before
                raise
        elif self._waiting:
            size = self.path.stat().st_size
            try:
                with self.path.open("a", encoding="utf-8", newline="") as file:
                    file.write(self._text(self._waiting))
            except OSError:
                os.truncate(self.path, size)
                raise
        self._waiting = []
        if settle and self.path.exists():
            with self.path.open("rb") as file:
                os.fsync(file.fileno())

    def cut(self, epochs: int) -> None:
        """Keep the rows of the first ``epochs`` epochs."""
        rows = [row for row in read(self.path) if row[EPOCH] < epochs]
        if self.path.exists():
            self._replace(rows)

    def _replace(self, rows: list[Row]) -> None:
        write_text(self.path, ",".join(self._columns) + "\n" + self._text(rows))

    def _text(self, rows: list[Row]) -> str:
        out = io.StringIO()
        writer = csv.DictWriter(out, self._columns, restval="", lineterminator="\n")
        writer.writerows({k: int(v) if k == EPOCH else repr(v) for k, v in r.items()} for r in rows)
        return out.getvalue()


def read(path: Path) -> list[Row]:
    """Return all complete rows; quantities that an epoch lacks are absent from its row."""
    columns = _header(path)
    if not columns:
        return []
    rows = []
    for line in path.read_text(encoding="utf-8").split("\n")[1:-1]:  # the last one may be torn
        cells = dict(zip(columns, line.split(","), strict=False))
        row = {name: float(cell) for name, cell in cells.items() if cell}
        rows.append({**row, EPOCH: int(row[EPOCH])})
    return rows


def _header(path: Path) -> list[str]:
    try:
        with path.open(encoding="utf-8") as file:
            first = file.readline()
    except OSError:
        return []
    return first.rstrip("\n").split(",") if first.endswith("\n") else []
