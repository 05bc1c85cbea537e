"""Columns of recordings, known before their rows are read."""

from __future__ import annotations

import os
import re
import shlex
import warnings
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import pandas as pd

from symo_exp.data.formats import (
    IN_TIME,
    NUMBER,
    TEXT,
    TIME,
    TIME_UNITS,
    Dialect,
    Location,
    columns_of,
    few,
    files,
    readable,
    shown,
    suffix,
    table_of,
)
from symo_exp.errors import ConfigError
from symo_exp.shell import override_value

Columns = Mapping[str, str | None]
"""This project's names of columns to those of the file; the name of one that is left out to null.
"""
OTHERS = ("trajectory", "split", "t")
"""Columns that belong to no coordinate or input."""
KINDS = {"q": "coordinate", "v": "coordinate", "u": "input"}
UNITS = {"d": 86400.0, "h": 3600.0, "min": 60.0, "s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
"""Units of time [s]."""
TRAJECTORY = re.compile(
    r"(?:traj|trajectory|episode|run|trial|rollout|experiment)(?:[_ ]?(?:id|no|nr|number|index))?",
    re.I,
)
"""Names that are read as ``trajectory``."""

ANGLE = (
    "theta|phi|psi|alpha|beta|angle|ang|rot|joint|shoulder|elbow|hip|knee|ankle|wrist|pole|arm|link"
    "|pendulum|upper|lower|roll|pitch|yaw|motor|wheel"
)
SLIDE = "x|y|z|pos|position|cart|slide|slider|lin|linear|prismatic|height|stroke|carriage|table|d"
"""Words in the names of angles and of positions."""
PLACE = re.compile(r"(?:q|qpos|pos|positions?|angles?)(\d*)", re.I)
"""A word that says that a column is a coordinate, and the number of the coordinate."""
PLACES = re.compile(rf"(?:{ANGLE}|{SLIDE})\d*", re.I)
"""A word of a coordinate's name."""
RATE = re.compile(
    r"v|w|a|d|omega|gyro?|acc|accel|acceleration|vel|velocity|rates?|angular|linear|twist|imu", re.I
)
"""A word of the name of a velocity or an acceleration, without its axis."""
SPEED = re.compile(
    r"(?:d?dq|qd?d|dot|qvel|vel|velocity|velocities|speeds?|omega|rates?|rpm)(\d*)", re.I
)
"""A word that says that a column is a velocity, and the number of the coordinate."""
INPUT = re.compile(
    r"(?:u|tau|torques?|moments?|forces?|efforts?|currents?|motors?|inputs?|cmd|commands?|controls?"
    r"|ctrl|act|actions?|volt|volts|voltages?|pwm|duty|throttle|thrust|rudder|heat)(\d*)",
    re.I,
)
"""A word of an input's name, and the number of the coordinate."""
WANTED = re.compile(
    r"(?:ref|reference|des|desired|set|setpoint|sp|target|goal|cmd|command|commanded|demand|error"
    r"|err)\d*",
    re.I,
)
"""A word of the name of what a controller wants, which the machine need not do."""
OTHER = re.compile(
    r"(?:acc|accel|acceleration|ddot|ddq|qdd|jerk|bat|battery|vbus|supply|temp|temperature)\d*",
    re.I,
)
"""A word of the name of what is no coordinate, velocity or input."""
GUESSES = 4
"""Columns that are suggested as coordinates without a word that says so, at most."""
RISES = 0.99
"""Share of the rows in which a clock rises."""
STRIDE, ALIKE = 10, 0.95
"""Rows over which a column is compared with the sum of its rate, and their correlation at least."""
KEY = re.compile(r"[\w/+.$%*@?| ()\[\]{}:=,\\-]+", re.ASCII)
"""Names of columns that can be typed as keys of a setting."""
PLAIN = re.compile(r"q\W?\d*\W?")
"""Names of coordinates in other tables, which are no names of this project."""
UNIT = re.compile(r"(_| in | *[\[(])((?:m|mm|cm|rad|deg|°)(?:/s)?|n ?m|n|v|a)[\])]?$", re.I)
"""A unit at the end of a name, after an underscore or "in", or in brackets."""


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
    given: tuple[tuple[str, str | None], ...] = ()


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
    if not names("q", new) or "t" not in new:
        other = "" if where == shown(path) else ", or name the other files only, by data.path"
        raise ConfigError(f"{where}: {_lacking(file, found, new, columns, other)}")
    if doubt := _doubtful(found, new, columns):
        raise ConfigError(f"{where}: {doubt}")
    given = tuple((columns or {}).items())
    return Header(tuple(new), unit, tuple(filter(None, (note, *notes))), given)


def _lacking(
    file: Path, found: Sequence[str], new: Sequence[str], columns: Columns | None, other: str
) -> str:
    """Return a line on a table without coordinates or times, with settings that map them.

    ``other`` is what else to do if no setting can be suggested.
    """
    with readable(file):
        table = table_of(file).set_axis(pd.Index(found), axis=1)
    if not any(_is_number(table[name]) for name in found):
        return (
            f"no column has numbers; the line of names is {few(found)}; names are in the first "
            "line that is no comment (#)"
        )
    lacking = "t with times" if names("q", new) else "q_<name> with a coordinate"
    mend = suggestion(found, new, table, columns)
    return f"no column {lacking}; it has {few(found)}; " + (
        f"map them: {mend}" if mend else f"add it to the file{other}"
    )


def _doubtful(found: Sequence[str], new: Sequence[str], columns: Columns | None) -> str:
    """Return a line on columns whose names contradict what they are read as; else nothing."""
    given = dict(columns or {})
    read = [name for name in new if name.startswith("q_") and name not in given]
    wanted = [name for name in read if _is_wanted(name)]
    if wanted and len(wanted) < len(names("q", new)):
        return (
            f"{few(wanted)}: what a controller wants, as such names say, is no coordinate; rename "
            f"them, or leave them out, {omitting(wanted, columns)}"
        )
    unread = [name for name, ours in zip(found, new, strict=True) if name == ours]
    plain = [name for name in unread if PLAIN.fullmatch(name)]
    if read and plain:
        mapped = {f"q_{key}": x for key, x in zip(_keys(plain, PLACE), plain, strict=True)}
        return (
            f"{few(read)} would be coordinates by their names, and {few(plain)} would not; if the "
            f"latter are, map them: {as_setting({**given, **dict.fromkeys(read), **mapped})}"
        )
    inputs = [name for name in unread if _kind(name) == "u"]
    if inputs and not names("u", new):
        mend = as_setting({**given, **_inputs(inputs, names("q", new))})
        return (
            f"no column u_<name> with an input, but {few(inputs)}; map them, {mend}, or leave them "
            f"out, {omitting(inputs, columns)}"
        )
    return ""


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
        "trajectory": [name for name in found if TRAJECTORY.fullmatch(name)],
        "split": [name for name in found if name.lower() == "split"],
    }
    return {
        ours: theirs[0] for ours, theirs in others.items() if len(theirs) == 1 and ours not in taken
    }


def _unit(name: str) -> str | None:
    match = TIME.fullmatch(name) or IN_TIME.fullmatch(name)
    unit = match and (match[1] or match[2])
    return TIME_UNITS[unit.lower()] if unit else None


def suggestion(
    found: Sequence[str], new: Sequence[str], table: pd.DataFrame, columns: Columns | None
) -> str:
    """Return settings that guess what the columns hold, beside those given; ``""`` without a guess.

    Names say it first. Columns whose names say nothing are taken for times if they rise like those
    of a clock, and for coordinates if no name says so.

    Args:
        found: Names of the file.
        new: Names of this project.
        table: The rows.
        columns: The setting so far.
    """
    free = [
        theirs
        for theirs, ours in zip(found, new, strict=True)
        if theirs == ours and theirs not in OTHERS and re.search(r"\w", theirs)
        and not re.match(r"[qvu]_.|__index_", theirs)
    ]  # fmt: skip
    mapping = dict(columns or {})
    times = [x for x, ours in zip(found, new, strict=True) if ours == "t"] or _times(free, table)
    if times and times[0] != "t":
        mapping["t"] = times[0]
    free = [name for name in free if not _says_time(name) and _is_number(table[name])]
    if not names("q", new):
        inputs = [] if names("u", new) else [name for name in free if _kind(name) == "u"]
        mapping |= _places(free, table, inputs)
    mapped = [theirs for ours, theirs in mapping.items() if ours[:2] == "q_" and theirs]
    if mapping == dict(columns or {}) or not (mapped or names("q", new)):
        return ""
    text = as_setting(mapping) + " data.degrees=true" * (_angles_in(mapped) == {"deg"})
    text += ", a guess, since no name says coordinate" * (
        bool(mapped) and not any(map(_kind, mapped))
    )
    silent = [x for x in free if x not in mapping.values() and _may_move(x, table[x])]
    return text + f", which leaves out {few(silent)}" * bool(silent)


def _places(free: Sequence[str], table: pd.DataFrame, inputs: Sequence[str]) -> dict[str, str]:
    """Return columns of coordinates, their velocities and the inputs."""
    stems = {name: UNIT.sub("", name) for name in free}
    if pose := _pose(stems):
        return pose | {f"u_{key}": x for key, x in zip(_keys(inputs), inputs, strict=True)}
    kinds = {name: _kind(name) for name in free}
    speeds = {name: stem for name in free if (stem := _slope_of(stems[name], stems.values()))}
    places = [x for x in free if kinds[x] == "q" and x not in speeds]
    places = places or _movements([x for x in free if x not in speeds], table)[:GUESSES]
    mixed = len(_angles_in(places)) > 1  # names keep what the setting of all cannot say
    keys = _keys([x if mixed and in_degrees(x) else stems[x] for x in places], PLACE)
    found = {f"q_{key}": x for key, x in zip(keys, places, strict=True)}
    rates = {_key(stem, PLACE): name for name, stem in speeds.items()}
    rates |= {_key(stems[name], SPEED): name for name in free if kinds[name] == "v"}
    if keys and set(keys) <= set(rates):
        found |= {f"v_{key}": rates[key] for key in keys}
    return found | _inputs(inputs, keys)


def _inputs(given: Sequence[str], coordinates: Sequence[str]) -> dict[str, str]:
    """Return columns of inputs, measured ones if there are, named as coordinates where they can."""
    every = [x for x in given if not _is_wanted(x)] or given
    keys = _keys([UNIT.sub("", name) for name in every], INPUT)
    if not set(keys) <= set(coordinates):
        keys = _keys(every)
    return {f"u_{key}": name for key, name in zip(keys, every, strict=True)}


def _times(free: Sequence[str], table: pd.DataFrame) -> list[str]:
    """Return columns of times, by their names or else by their values, likely ones first.

    Of clocks, those that count rows are last.
    """
    if named := [name for name in free if _says_time(name)]:
        return sorted(named, key=lambda name: not _is_clock(table[name]))
    clocks = [name for name in free if not _kind(name) and _is_clock(table[name])]
    counts = [x for x in clocks if (_numbers(table[x]).diff().iloc[1:] == 1).all()]
    return [x for x in clocks if x not in counts] + counts


def _says_time(name: str) -> bool:
    """Return whether a name is one of times, or ends with a unit of time, but for ``_s``."""
    return bool(TIME.fullmatch(name) or ((match := IN_TIME.fullmatch(name)) and match[2]))


def _is_number(values: pd.Series) -> bool:
    """Return whether most values are numbers."""
    return bool(_numbers(values).notna().mean() > 0.5)


def _numbers(values: pd.Series) -> pd.Series:
    return pd.to_numeric(values, errors="coerce")


def _is_clock(values: pd.Series) -> bool:
    """Return whether values rise from row to row, but for restarts, or are dates."""
    if _is_number(values):
        rises = _numbers(values).dropna().diff().iloc[1:]
        return bool((rises > 0).mean() > RISES)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # words that are no dates
        dates = pd.to_datetime(values.iloc[:9], errors="coerce", utc=True, format="mixed")
    return bool(dates.notna().all() and dates.nunique() > 1)


def _movements(names: Sequence[str], table: pd.DataFrame) -> list[str]:
    """Return columns that may be coordinates by their values, without the rates of others."""
    found = [name for name in names if _may_move(name, table[name])]
    rises = {x: _numbers(table[x]).ffill().diff(STRIDE) for x in found}
    sums = {x: _numbers(table[x]).ffill().rolling(STRIDE).sum() for x in found}
    return [
        rate for rate in found
        if not any(rises[x].corr(sums[rate]) > ALIKE for x in found if x != rate)
    ]  # fmt: skip


def _may_move(name: str, values: pd.Series) -> bool:
    """Return whether a column may be of the machine though its name does not say so."""
    return not _kind(name) and not _is_clock(values) and values.nunique() > 1


def _angles_in(names: Sequence[str]) -> set[str]:
    """Return the units of angles at the ends of names, ``rad`` and ``deg``."""
    units = [unit[2].lower().replace("°", "deg") for x in names if (unit := UNIT.search(x))]
    return {unit for unit in units if unit in ("rad", "deg")}


def _is_wanted(name: str) -> bool:
    return any(map(WANTED.fullmatch, _words(name)))


def _slope_of(stem: str, stems: Collection[str]) -> str | None:
    """Return the name of which a name is the derivative, such as ``x`` of ``dx`` or ``xdot``."""
    for pattern in (r"d_?(.+)", r"(.+?)_?(?:dot|d|p)"):
        if (match := re.fullmatch(pattern, stem)) and match[1] in stems:
            return match[1]
    return None


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


def as_setting(mapping: Columns) -> str:
    """Return ``data.columns`` as it can be typed."""
    pairs = (f"{_escaped(ours)}: {_value(theirs)}" for ours, theirs in mapping.items())
    return shlex.quote("data.columns={" + ", ".join(pairs) + "}")


def in_degrees(name: str) -> bool:
    """Return whether a name ends with degrees as its unit."""
    unit = UNIT.search(name)
    return unit is not None and unit[2].lower() in ("deg", "°")


def _kind(name: str) -> str:
    """Return ``q``, ``v`` or ``u`` as the unit or a word of a name says, ``-`` for none of them.

    Nothing if the name does not tell.
    """
    unit, words = UNIT.search(name), _words(UNIT.sub("", name))
    wanted = _is_wanted(name)
    if any(map(OTHER.fullmatch, words)):
        return "-"
    if unit and (unit[1] != "_" or len(unit[2]) > 1):  # _a may be a name
        if unit[2].lower().startswith(("n", "v", "a")):
            return "u"
        return "-" if wanted else "v" if unit[2].endswith("/s") else "q"
    for kind, word in (("v", SPEED), ("q", PLACE), ("u", INPUT), ("q", PLACES)):
        if any(map(word.fullmatch, words)):
            return "-" if wanted and kind != "u" else kind
    return ""


def _words(name: str) -> list[str]:
    """Return the words of a name, also of one such as ``jointAngle``."""
    return re.findall(r"[A-Z]+\d*(?![a-z])|[A-Z]?[a-z]+\d*|\d+", name)


def _keys(stems: Sequence[str], kind: re.Pattern[str] | None = None) -> list[str]:
    """Return different names for columns, short ones if these differ."""
    short = [_key(stem, kind) for stem in stems] if kind else []
    every = (short, [_short(stem) for stem in stems])
    numbered = [f"{_short(stem)}_{i}" for i, stem in enumerate(stems)]
    return next((x for x in every if len(set(x)) == len(stems)), numbered)


def _key(stem: str, kind: re.Pattern[str]) -> str:
    """Return a name without the word that says of which kind it is: ``1`` of ``q1``."""
    words = _words(stem)
    kept = [match[1] if (match := kind.fullmatch(word)) else word for word in words]
    return "_".join(filter(None, kept)) or _short(stem)


def _short(stem: str) -> str:
    """Return a name without blanks, brackets and letters that keys of settings cannot have."""
    return re.sub(r"\W+", "_", stem, flags=re.ASCII).strip("_") or "x"


def omitting(left_out: Sequence[str], columns: Columns | None = None) -> str:
    """Return the setting that leaves columns out, beside those that are given."""
    kept = {ours: theirs for ours, theirs in (columns or {}).items() if ours not in left_out}
    others = {name: None for name in left_out if name not in (columns or {})}
    if odd := [name for name in others if not KEY.fullmatch(name)]:
        return f"data.columns={{NAME: null}}, with an ASCII name in the file instead of {few(odd)}"
    return as_setting({**kept, **others})


def _value(theirs: str | None) -> str:
    plain = re.fullmatch(r"(?!(?:null|true|false)$)[a-z_.][\w.-]*", theirs or "", re.A | re.I)
    return str(theirs) if plain else override_value(theirs, nested=True)


def _escaped(key: str) -> str:
    """Return a key as Hydra reads it, where it can."""
    return re.sub(r"([\\()\[\]{}:=,])", r"\\\1", key)
