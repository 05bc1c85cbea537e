"""Columns of recordings, known before their rows are read."""

from __future__ import annotations

import itertools
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import pandas as pd

from symo_exp.data.advice import (
    OTHERS,
    Columns,
    is_number,
    omitting,
    suggestion,
)
from symo_exp.data.clocks import IN_TIME, TIME, TIME_UNITS
from symo_exp.data.dialect import NUMBER, Dialect
from symo_exp.data.formats import columns_of, readable, table_of
from symo_exp.data.misread import Doubt, doubt_of
from symo_exp.data.naming import kind_of_column, names, split_times
from symo_exp.data.paths import TEXT, Location, few, files, shown, suffix
from symo_exp.errors import ConfigError

KINDS = {"q": "coordinate", "v": "coordinate", "u": "input"}
UNITS = {"d": 86400.0, "h": 3600.0, "min": 60.0, "s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
"""Units of time [s]."""
TRAJECTORY = re.compile(
    r"(?:traj|trajectory|episode|run|trial|rollout|experiment)"
    r"(?:[_ ]?(?:id|no|nr|number|index|#))?",
    re.I,
)
"""Names that are read as ``trajectory``."""


class Header(NamedTuple):
    """Columns by the names of this project.

    Attributes:
        names: Names in the order of the file; a column that is set aside begins with a dot.
        seconds: Unit of the times [s], if the name of their column states it.
        notes: Differences of the table from the file, a line each.
        given: The user's mapping of columns.
    """

    names: tuple[str, ...]
    seconds: float | None
    notes: tuple[str, ...]
    given: tuple[tuple[str, str | None], ...]


def header(path: Location, columns: Columns | None = None) -> list[str]:
    """Return the columns of recordings, renamed by ``columns``, of all files alike.

    Args:
        path: A file, a folder, a glob pattern or a list of them.
        columns: A mapping of this project's names to those of the file; ``None`` instead of a name
            leaves the column out.

    Raises:
        ConfigError: If a file cannot be read or has no coordinates.
    """
    return list(headers(path, columns, timed=False)[0][1].names)


def headers(
    path: Location, columns: Columns | None, *, timed: bool = True
) -> list[tuple[Path, Header]]:
    """Return every file of a path with its columns; all have the same coordinates and inputs.

    Without times they are refused if they have to be ``timed``.
    """
    every = files(path)
    if twice := [file for file in every if every.count(file) > 1]:
        raise ConfigError(f"{shown(path)}: {twice[0]} is there twice; name each file once")
    found = [(file, header_of(path, file, columns, timed)) for file in every]
    kinds = [{name for name in one.names if name[:2] in ("q_", "v_", "u_")} for _, one in found]
    for (file, _), here in zip(found[1:], kinds[1:], strict=True):
        if here != kinds[0]:
            raise ConfigError(
                f"{shown(path)}: {file.name} has the columns {few(sorted(here))}, but "
                f"{found[0][0].name} has {few(sorted(kinds[0]))}; all files need the same"
            )
    return found


def header_of(path: Location, file: Path, columns: Columns | None, timed: bool) -> Header:
    """Return the columns of one file; ``path`` is what the user gave."""
    where = shown(path if isinstance(path, str | os.PathLike) and Path(path) == file else file)
    with readable(file):
        found = columns_of(file)
        dialect = Dialect.of(file).notes if suffix(file) in TEXT else []
    _check_names(where, found)
    new, unit, notes = renamed(where, found, columns)
    if not names("q", new) or (timed and "t" not in new):
        other = "" if where == shown(path) else ", or name the other files only, by data.path"
        raise ConfigError(f"{where}: {_lacking(file, found, new, columns, other)}")
    given = dict(columns or {})
    if doubts := _told_doubts(where, found, new, given):
        raise ConfigError(f"{where}: {doubts}")
    return Header(tuple(new), unit, (*dialect, *notes), tuple(given.items()))


def _check_names(where: str, found: Sequence[str]) -> None:
    """Refuse a table without names, or with one of them twice."""
    if not any(found):
        raise ConfigError(f"{where}: cannot be read (it is empty)")
    if all(map(NUMBER.fullmatch, found)):
        raise ConfigError(
            f"{where}: the first line has numbers ({few(found)}), not names; add a line such as "
            "t,q_arm,u_motor"
        )
    if twice := sorted({name for name in found if name and found.count(name) > 1}):
        raise ConfigError(f"{where}: column {', '.join(twice)} occurs twice; rename one of the two")


def _lacking(
    file: Path, found: Sequence[str], new: Sequence[str], columns: Columns | None, other: str
) -> str:
    """Return a line on a table without coordinates or times, with settings that map them.

    ``other`` is what else to do if no setting can be suggested.
    """
    with readable(file):
        table = table_of(file).set_axis(pd.Index(found), axis=1)
    if not any(is_number(values) for _, values in table.items()):  # also those without a name
        return (
            f"no column has numbers; the line of names is {few(found)}; names are in the first "
            "line that is no comment (#)"
        )
    lacking = "t with times" if names("q", new) else "q_<name> with a coordinate"
    speeds = [name for name in found if name[:2] == "v_" or kind_of_column(name) == "v"]
    if speeds and not names("q", new):
        other = f", as the integral of a velocity ({few(speeds)}) over time{other}"
    elif names("q", new):
        other = f", or give data.sample_time=SECONDS, the time from a row to the next{other}"
    mend = suggestion(found, new, table, columns) or f"add it to the file{other}"
    return f"no column {lacking}; it has {few(found)}; {mend}"


def _told_doubts(where: str, found: Sequence[str], new: Sequence[str], given: Columns) -> str:
    """Return a line on all columns whose names contradict what they are read as.

    One setting resolves all of it: what the others contradict is that with the mapping so far.
    """
    doubts: list[Doubt] = []
    mapped, left = dict(given), list[str]()
    while doubt := doubt_of(found, new, {**mapped, **dict.fromkeys(left)}):
        doubts.append(doubt)
        if not (doubt.mapped or doubt.left):
            break
        mapped = {x: y for x, y in mapped.items() if y not in doubt.left} | dict(doubt.mapped)
        left += doubt.left
        new, _, _ = renamed(where, found, {**mapped, **dict.fromkeys(left)})
    told = "; ".join(doubt.told for doubt in doubts)
    if not doubts or (mapped == given and not left):
        return told
    if len(doubts) > 1:
        return f"{told}; all of this in one setting: {omitting(left, mapped)}"
    optional = doubts[0].optional
    rest = {x: y for x, y in mapped.items() if y not in optional}
    other = f", or leave them out, {omitting(optional, rest)}" if optional else ""
    return f"{told}: {omitting(left, mapped)}{other}"


def renamed(
    where: str, found: Sequence[str], columns: Columns | None
) -> tuple[list[str], float | None, list[str]]:
    """Return columns by the names of this project, the unit of time [s] and notes for the log.

    The unit is ``None`` where no name states it.

    A column that is left out, or whose own name is taken by the mapping, is set aside: its name
    begins with a dot then.
    """
    new = _mapping(where, found, columns)
    notes, free = [], [name for name in found if name not in new]
    for ours, theirs in _aliases(free, {*new.values(), *free}).items():
        new[theirs] = ours
        notes.append(f"column {theirs} is read as {ours}")
    taken = set(new.values())
    result = [new.get(name, f".{name}" if name in taken else name) for name in found]
    unit = next((_unit(theirs) for theirs, ours in new.items() if ours == "t"), None)
    if unit not in (None, "s"):
        notes.append(f"times are in {unit}, as their column's name says")
    return result, None if unit is None else UNITS[unit], notes


def _mapping(where: str, found: Sequence[str], columns: Columns | None) -> dict[str, str]:
    """Return the user's mapping by the names in the file."""
    if columns is None:
        return {}
    if not isinstance(columns, Mapping):
        raise ConfigError(
            f"data.columns={columns}: expected a mapping, 'data.columns={{t: time, q_arm: angle}}'"
        )
    new = {
        str(ours if theirs is None else theirs): f".{ours}" if theirs is None else str(ours)
        for ours, theirs in columns.items()
    }
    for theirs, ours in new.items():
        omitted = ours == f".{theirs}"
        if theirs not in found:
            given = f"{theirs}=null" if omitted else f"{ours}={theirs}"
            raise ConfigError(
                f"data.columns: {given}, but {where} has no such column; it has {few(found)}"
            )
        if not omitted and ours not in OTHERS and not re.fullmatch(r"[qvu]_.+", ours):
            raise ConfigError(
                f"data.columns: {ours}={theirs} is not allowed; expected one of "
                f"{', '.join(OTHERS)}, q_<name>, v_<name>, u_<name>"
            )
    if len(new) < len(columns):
        raise ConfigError(f"data.columns={dict(columns)}: one column has two names; give it one")
    return new


def _aliases(found: Sequence[str], taken: set[str]) -> dict[str, str]:
    """Unambiguous other names of ``t``, ``trajectory`` and ``split``."""
    parts = list(itertools.chain(*split_times(found)))
    others = {
        "t": [name for name in found if TIME.fullmatch(name) and name not in parts],
        "trajectory": [name for name in found if TRAJECTORY.fullmatch(name)],
        "split": [name for name in found if name.lower() == "split"],
    }
    return {
        ours: theirs[0] for ours, theirs in others.items() if len(theirs) == 1 and ours not in taken
    }


def _unit(name: str) -> str | None:
    match = TIME.fullmatch(name) or IN_TIME.fullmatch(name)
    unit = match[1] or match[2] if match else name if name.lower() in TIME_UNITS else None
    return TIME_UNITS[unit.lower()] if unit else None
