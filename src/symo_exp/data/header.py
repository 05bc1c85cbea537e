"""Columns of recordings, known before their rows are read."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from symo_exp.data.formats import (
    NUMBER,
    TEXT,
    TIME,
    Dialect,
    Location,
    columns_of,
    few,
    files,
    readable,
    shown,
    suffix,
)
from symo_exp.errors import ConfigError

Columns = Mapping[str, str | None]
"""This project's names of columns to those of the file; the name of one that is left out to null.
"""
OTHERS = ("trajectory", "split", "t")
"""Columns that belong to no coordinate or input."""
KINDS = {"q": "coordinate", "v": "coordinate", "u": "input"}
UNITS = {"d": 86400.0, "s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
"""Units of time [s]."""
TRAJECTORY = ("trajectory", "traj", "traj_id", "trajectory_id", "episode", "episode_id")
"""Names that are read as ``trajectory``, in any case."""

POSITION = re.compile(r"^(?:pos|position|angle)[_ ]|[_ ](?:pos|position|angle)$", re.I)
VELOCITY = re.compile(r"^(?:d|dot_|vel_|velocity_|omega_)(?=.)|_?(?:dot|vel|velocity)$")
RATE = re.compile(
    r"v|w|a|d|omega|gyro?|acc|accel|acceleration|vel|velocity|rates?|angular|linear|twist|imu", re.I
)
"""A word of the name of a velocity or an acceleration, without its axis."""
INPUT = re.compile(
    r"(?:u|tau|torques?|forces?|efforts?|currents?|motors?|inputs?|cmd|commands?|controls?|ctrl|act"
    r"|actions?|volt|volts|voltages?|pwm|duty|throttle|thrust|rudder|heat)\d*",
    re.I,
)
"""A word of an input's name."""
UNIT = re.compile(r"(_| *[\[(])((?:m|mm|cm|rad|deg|°)(?:/s)?|n ?m|n|v|a)[\])]?$", re.I)
"""A unit at the end of a name, after an underscore or in brackets."""


class Header(NamedTuple):
    """Columns by the names of this project.

    Attributes:
        names: Names in the order of the file; a column that is set aside begins with a dot.
        seconds: Unit of the times [s], if the name of their column states it.
        notes: Differences of the table from the file, a line each.
    """

    names: tuple[str, ...]
    seconds: float | None
    notes: tuple[str, ...]


def header(path: Location, columns: Columns | None = None) -> list[str]:
    """Return the columns of recordings, renamed by ``columns``, of all files alike.

    Args:
        path: A file, a folder, a glob pattern or a list of them.
        columns: A mapping of this project's names to those of the file; ``None`` instead of a name
            leaves the column out.

    Raises:
        ConfigError: If a file cannot be read or has no coordinates.
    """
    return list(headers(path, columns)[0][1].names)


def headers(path: Location, columns: Columns | None) -> list[tuple[Path, Header]]:
    """Return every file of a path with its columns; all have the same coordinates and inputs."""
    every = files(path)
    if twice := [file for file in every if every.count(file) > 1]:
        raise ConfigError(f"{shown(path)}: {twice[0]} is there twice; name each file once")
    found = [(file, header_of(path, file, columns)) for file in every]
    kinds = [{name for name in one.names if name[:2] in ("q_", "v_", "u_")} for _, one in found]
    for (file, _), here in zip(found[1:], kinds[1:], strict=True):
        if here != kinds[0]:
            raise ConfigError(
                f"{shown(path)}: {file.name} has the columns {few(sorted(here))}, but "
                f"{found[0][0].name} has {few(sorted(kinds[0]))}; all files need the same"
            )
    return found


def header_of(path: Location, file: Path, columns: Columns | None) -> Header:
    """Return the columns of one file; ``path`` is what the user gave."""
    where = shown(path if isinstance(path, str | os.PathLike) and Path(path) == file else file)
    with readable(file):
        found = columns_of(file)
        note = Dialect.of(file).note if suffix(file) in TEXT else None
    if not any(found):
        raise ConfigError(f"{where}: cannot be read (it is empty)")
    if all(map(NUMBER.fullmatch, found)):
        raise ConfigError(
            f"{where}: the first line has numbers ({few(found)}), not names; add a line such as "
            "t,q_arm,u_motor"
        )
    if twice := sorted({name for name in found if name and found.count(name) > 1}):
        raise ConfigError(f"{where}: column {', '.join(twice)} occurs twice; rename one of the two")
    new, unit, notes = renamed(where, found, columns)
    if not names("q", new):
        raise ConfigError(
            f"{where}: no column q_<name> with a coordinate; it has {few(found)}; map them: "
            f"{suggestion(found)}"
        )
    return Header(tuple(new), unit, tuple(filter(None, (note, *notes))))


def names(kind: str, columns: Sequence[str]) -> tuple[str, ...]:
    """Return the names that follow ``q_``, ``v_`` or ``u_``."""
    return tuple(name[2:] for name in columns if name.startswith(f"{kind}_"))


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
    others = {
        "t": [name for name in found if TIME.fullmatch(name)],
        "trajectory": [name for name in found if name.lower() in TRAJECTORY],
        "split": [name for name in found if name.lower() == "split"],
    }
    return {
        ours: theirs[0] for ours, theirs in others.items() if len(theirs) == 1 and ours not in taken
    }


def _unit(name: str) -> str | None:
    match = TIME.fullmatch(name)
    unit = match and (match[1] or match[2])
    return {"sec": "s", "day": "d", "days": "d"}.get(unit.lower(), unit.lower()) if unit else None


def suggestion(found: Sequence[str]) -> str:
    """Return settings that guess what the columns hold."""
    others = [n for n in found if n not in OTHERS and not re.match(r"[qvu]_.|__index_", n)]
    times = [name for name in others if TIME.fullmatch(name)]
    free = [n for n in others if n not in times and n.lower() not in TRAJECTORY]
    kinds = {name: _kind(name) for name in free}
    stems = {name: UNIT.sub("", name) for name in free}
    inputs = [name for name in free if kinds[name] == "u"]
    mapping = {"t": times[0]} if times and "t" not in found else {}
    if pose := _pose(stems):
        return as_setting(mapping | pose | {f"u_{_short(name)}": name for name in inputs})
    rates = {
        stem: name
        for name in free
        if kinds[name] in ("v", "") and (stem := VELOCITY.sub("", stems[name], 1)) != stems[name]
    }
    places = {
        POSITION.sub("", stems[name], count=1): name
        for name in free
        if kinds[name] in ("q", "") and name not in rates.values()
    }
    mapping |= {f"q_{_short(stem)}": name for stem, name in list(places.items())[:4]}
    if places and set(places) <= set(rates):
        mapping |= {f"v_{_short(stem)}": rates[stem] for stem in list(places)[:4]}
    mapping |= {f"u_{_short(name)}": name for name in inputs[:4]}
    text = as_setting(mapping or {"q_theta": "angle"})
    return text + " data.degrees=true" * any(map(in_degrees, places.values()))


def _pose(stems: Mapping[str, str]) -> dict[str, str]:
    """Return the columns of a quaternion, and of a position if there is one; else nothing.

    Four names that differ in the last letter, ``w``, ``x``, ``y`` or ``z``, are a quaternion.

    Args:
        stems: Names without units by those of the file.
    """
    ends = {(stem[:-1], stem[-1:].lower()): name for name, stem in stems.items()}
    vectors = [stem for stem, end in ends if end == "x" and {(stem, "y"), (stem, "z")} <= set(ends)]
    turns = [stem for stem in vectors if (stem, "w") in ends]
    others = (stem for stem in vectors if stem not in turns)
    places = [x for x in others if not any(map(RATE.fullmatch, re.split(r"[^a-zA-Z]+", x)))]
    if not turns:
        return {}
    found = {f"q_{axis}": ends[places[0], axis] for axis in "xyz"} if places else {}
    return found | {f"q_R_{part}": ends[turns[0], part] for part in "wxyz"}


def as_setting(mapping: Mapping[str, str]) -> str:
    """Return the setting that renames columns."""
    return "'data.columns={" + ", ".join(f"{a}: {_quoted(b)}" for a, b in mapping.items()) + "}'"


def in_degrees(name: str) -> bool:
    """Return whether a name ends with degrees as its unit."""
    unit = UNIT.search(name)
    return unit is not None and unit[2].lower() in ("deg", "°")


def _kind(name: str) -> str:
    """Return ``q``, ``v`` or ``u`` as the unit or a word of a name says, else nothing."""
    unit = UNIT.search(name)
    if unit and (unit[1] != "_" or len(unit[2]) > 1):  # _a may be a name
        if unit[2].lower().startswith(("n", "v", "a")):
            return "u"
        return "v" if unit[2].endswith("/s") else "q"
    words = re.split(r"[^a-zA-Z0-9]+", name)
    return "u" if any(map(INPUT.fullmatch, words)) else ""


def _short(stem: str) -> str:
    """Return a name without blanks and brackets; ``1`` of ``q1``."""
    if re.fullmatch(r"q\d+", stem):
        return stem[1:]
    return re.sub(r"\W+", "_", stem).strip("_")


def omitting(columns: Sequence[str]) -> str:
    """Return the setting that leaves columns out."""
    return "'data.columns={" + ", ".join(f"{_quoted(name)}: null" for name in columns) + "}'"


def _quoted(name: str) -> str:
    return name if re.fullmatch(r"[\w.-]+", name) else f'"{name}"'
