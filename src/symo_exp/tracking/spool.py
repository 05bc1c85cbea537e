"""What a finished run could not tell its store, kept in the run folder until the store is back."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from symo_exp.files import write_whole

FILE = "undelivered.json"

Rows = dict[tuple[str, int], tuple[float, int]]
"""Of a series: name and epoch, to value and time [ms]."""


class Letter(NamedTuple):
    name: str
    parameters: dict[str, Any]
    parent: str | None
    rows: Rows


def write(folder: Path, letter: Letter) -> None:
    plain = {**letter._asdict(), "rows": as_list(letter.rows)}
    text = json.dumps(plain, default=str) + "\n"
    write_whole(folder / FILE, lambda path: path.write_text(text, encoding="utf-8"))


def read(folder: Path) -> Letter:
    plain = json.loads((folder / FILE).read_text(encoding="utf-8"))
    return Letter(**{**plain, "rows": as_rows(plain["rows"])})


def waits(folder: Path) -> bool:
    """Whether something of this run is still to be delivered."""
    return (folder / FILE).exists()


def remove(folder: Path) -> None:
    (folder / FILE).unlink(missing_ok=True)


def as_list(rows: Mapping[tuple[str, int], tuple[float, int]]) -> list[list[Any]]:
    """Rows as plain lists, for a file."""
    return [[name, epoch, value, when] for (name, epoch), (value, when) in rows.items()]


def as_rows(plain: list[list[Any]]) -> Rows:
    """What ``as_list`` was given."""
    return {(name, int(epoch)): (float(value), int(when)) for name, epoch, value, when in plain}
