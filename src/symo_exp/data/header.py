"""The columns of a table of recordings, known before its rows are read."""

from __future__ import annotations

import csv
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import pyarrow.parquet

from symo_exp.errors import ConfigError

OTHERS = ("trajectory", "split", "t")
"""The columns that do not say of which coordinate or input they are."""
KINDS = {"q": "coordinate", "v": "coordinate", "u": "input"}


def header(path: str | os.PathLike[str], columns: Mapping[str, str] | None = None) -> list[str]:
    """The columns in their order, those that ``columns`` maps by their new names."""
    file, where = located(path), f"data.path={path}"
    with readable(path):
        if file.suffix == ".csv":
            with file.open(encoding="utf-8-sig", newline="") as text:
                found = next(csv.reader(text), [])
        else:
            found = [str(name) for name in pyarrow.parquet.read_schema(file).names]
    if not found:
        raise ConfigError(f"{where}: cannot be read (it is empty)")
    if twice := sorted({name for name in found if found.count(name) > 1}):
        raise ConfigError(f"{where}: column {', '.join(twice)} is there more than once")
    return renamed(where, found, columns)


def names(kind: str, columns: Sequence[str]) -> tuple[str, ...]:
    """What follows ``q_``, ``v_`` or ``u_`` in the columns that begin so."""
    return tuple(name[2:] for name in columns if name.startswith(f"{kind}_"))


def renamed(where: str, found: Sequence[str], columns: Mapping[str, str] | None) -> list[str]:
    """``found`` by the names of this project. A column whose own name is taken by the mapping is
    set aside: its name begins with a dot then."""
    if columns is None:
        return list(found)
    if not isinstance(columns, Mapping):
        raise ConfigError(
            f"data.columns={columns}: expected a mapping, data.columns={{t: time, q_arm: angle}}"
        )
    new = {str(theirs): str(ours) for ours, theirs in columns.items()}
    for theirs, ours in new.items():
        if theirs not in found:
            raise ConfigError(
                f"data.columns: {where} has no column {theirs} to be {ours}; it has {few(found)}"
            )
        if ours not in OTHERS and not re.fullmatch(r"[qvu]_.+", ours):
            raise ConfigError(
                f"data.columns: {ours}={theirs} cannot be; a column is to be one of "
                f"{', '.join(OTHERS)}, q_<name>, v_<name>, u_<name>"
            )
    if len(new) < len(columns):
        raise ConfigError(f"data.columns={dict(columns)}: one column cannot be two")
    taken = set(new.values())
    return [new.get(name, f".{name}" if name in taken else name) for name in found]


def located(path: str | os.PathLike[str]) -> Path:
    """The file, if its name ends as it should."""
    file = Path(str(path)).expanduser()
    if file.suffix not in (".parquet", ".csv"):
        raise ConfigError(f"data.path={path}: expected a file that ends in .parquet or .csv")
    return file


@contextmanager
def readable(path: str | os.PathLike[str]) -> Iterator[None]:
    """What is wrong with a file, in a line."""
    try:
        yield
    except (OSError, ValueError, csv.Error) as error:  # those of pandas and Arrow too
        reason = getattr(error, "strerror", None) or next(iter(str(error).splitlines()), "")
        raise ConfigError(f"data.path={path}: cannot be read ({reason})") from error


def few(words: Sequence[object]) -> str:
    """The first of them in a line."""
    text = ", ".join(map(str, words[:12]))
    return f"{text}, and {len(words) - 12} more" if len(words) > 12 else text
