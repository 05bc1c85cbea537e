"""Settings that map the columns of a table which is not read as it is."""

from __future__ import annotations

import itertools
import re
import shlex
import warnings
from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from symo_exp.data.naming import (
    CONVERSIONS,
    INPUT,
    PLACE,
    SPEED,
    is_wanted,
    kind_of_column,
    names,
    says_time,
    short_name,
    short_names,
    slope_of,
    split_times,
    unit_of,
    units_of_angles,
    unread_unit,
)
from symo_exp.data.paths import few
from symo_exp.shell import text_value
from symo_exp.systems.recorded import without_unit

Columns = Mapping[str, str | None]
"""This project's names of columns to those of the file; the name of one that is left out to null.
"""
OTHERS = ("trajectory", "split", "t")
"""Columns that belong to no coordinate or input."""
RATE = re.compile(
    r"v|w|a|d|omega|gyro?|acc|accel|acceleration|vel|velocity|rates?|angular|linear|twist|imu", re.I
)
"""A word of the name of a velocity or an acceleration, without its axis."""
GUESSES = 4
"""Columns that are suggested as coordinates without a word that says so, at most."""
RISES = 0.99
"""Share of the rows in which a clock rises."""
STRIDE, ALIKE = 10, 0.95
"""Rows over which a column is compared with the sum of its rate, and their correlation at least."""
UNNAMED = re.compile(r"$|__index_")
"""The beginning of the name of an index that was written along without one."""
LISTS = (list, tuple, dict, np.ndarray)
"""Types of cells with several numbers."""
WRITTEN = re.compile(r"(?!.*\d-\d+-\d)[-+.,'\s()\[\]]*\d[-+\d.,'\se()\[\]]*", re.I)
"""A number, or several, in another form than numbers are read in; no date."""
KEY = re.compile(r"[\w/+.$%*@?| ()\[\]{}:=,\\-]+", re.ASCII)
"""Names of columns that can be typed as keys of a setting."""


def suggestion(
    found: Sequence[str], new: Sequence[str], table: pd.DataFrame, columns: Columns | None
) -> str:
    """Return what makes a table readable: settings beside those given, or a change of the file.

    The settings guess what the columns hold. Names say it first. Columns whose names say nothing
    are taken for times if they rise like those of a clock, and for coordinates if no name says so.

    Args:
        found: Names of the file.
        new: Names of this project.
        table: The rows.
        columns: The setting so far.

    Returns:
        Nothing without a guess.
    """
    every = list(zip(found, new, strict=True))
    free = [
        theirs for theirs, ours in every
        if theirs == ours and theirs not in OTHERS and re.search(r"\w", theirs)
        and not re.match(r"[qvu]_.|__index_", theirs)
    ]  # fmt: skip
    mapping = dict(columns or {})
    stamps = split_times(free)
    free = [name for name in free if name not in itertools.chain(*stamps)]
    times = (
        [x for x, ours in every if ours == "t"]
        or _times(free, table, named=bool(stamps))
        or [x for x in found if UNNAMED.match(x) and found.count(x) == 1 and _measures(table[x])]
    )
    added = ""
    if times and times[0] != "t":
        mapping["t"] = times[0]
    elif stamps and not times:
        seconds, rest = stamps[0]
        added = f"add a column t with {seconds} + 1e-9 * {rest} to the file"
    free = [name for name in free if not says_time(name)]
    text = [name for name in free if not is_number(table[name])]
    free = [name for name in free if name not in text]
    unread = _unread_places(free, table)
    free = [name for name in free if name not in unread]
    if not names("q", new):
        places = [name for name in unread if kind_of_column(name) != "v"]
        if places and "q" not in map(kind_of_column, free):
            return converting(places)
        inputs = [] if names("u", new) else [name for name in free if kind_of_column(name) == "u"]
        mapping |= _places(free, table, inputs)
    mapped = [theirs for ours, theirs in mapping.items() if ours[:2] == "q_" and theirs]
    told = _told_text([name for name in text if name not in mapping.values()], table)
    guessed = bool(mapped) and not any(map(kind_of_column, mapped))
    if mapping == dict(columns or {}) or not (mapped or names("q", new)) or (guessed and told):
        return "; ".join(filter(None, (told, added)))
    silent = [x for x in free if x not in mapping.values() and _may_move(x, table[x])]
    silent = [*unread, *silent]
    notes = ["a guess, since no name says coordinate"] * guessed
    notes += [f"without {few(silent)}"] * bool(silent)
    mend = (f"{added}, and " if added else "") + "map them"
    mend += f" ({'; '.join(notes)})" * bool(notes) + f": {as_setting(mapping)}"
    if units_of_angles(mapped) == {"deg"}:
        mend += " data.degrees=true"
    return "; ".join(filter(None, (told, mend)))  # settings are last, where they can be copied


def _unread_places(columns: Sequence[str], table: pd.DataFrame) -> list[str]:
    """Return columns of coordinates and velocities whose names end with units that are not read.

    Columns that rise like the times of a clock are none: clocks count ticks as well.
    """
    return [
        name for name in columns
        if unread_unit(name) and kind_of_column(name) in ("q", "v", "")
        and not _is_clock(table[name])
    ]  # fmt: skip


def converting(columns: Sequence[str]) -> str:
    """Return what to do about columns whose names end with units that are not read."""
    units = list(dict.fromkeys(map(unread_unit, columns)))
    remedies = dict.fromkeys(CONVERSIONS[unit] for unit in units)
    return (
        f"{few(columns)}: numbers in {' and '.join(units)}, by their names, are not read; convert "
        f"them in the file ({'; '.join(remedies)}) and rename the columns"
    )


def _told_text(columns: Sequence[str], table: pd.DataFrame) -> str:
    """Return what to do about columns with numbers that are not read as such, such as lists."""
    found: dict[str, object] = {}
    for name in columns:
        for cell in table[name].dropna().iloc[:9]:
            if isinstance(cell, LISTS) or WRITTEN.fullmatch(str(cell)):
                found.setdefault(name, cell)
    if not found:
        return ""
    return (
        f"{few(list(found))}: not read as numbers, such as {repr(next(iter(found.values())))[:40]};"
        " write numbers as 1234.5, without units and separators of thousands, each in a column of "
        "its own"
    )


def _places(free: Sequence[str], table: pd.DataFrame, inputs: Sequence[str]) -> dict[str, str]:
    """Return columns of coordinates, their velocities and the inputs."""
    stems = {name: without_unit(name) for name in free}
    if pose := _pose(stems):
        return pose | {f"u_{key}": x for key, x in zip(short_names(inputs), inputs, strict=True)}
    kinds = {name: kind_of_column(name) for name in free}
    speeds = {name: stem for name in free if (stem := slope_of(stems[name], stems.values()))}
    moving = [x for x in free if stems[x] in speeds.values() and _may_move(x, table[x])]
    places = [x for x in free if (kinds[x] == "q" or x in moving) and x not in speeds]
    places = places or _movements([x for x in free if x not in speeds], table)[:GUESSES]
    mixed = ["deg"] if len(units_of_angles(places)) > 1 else []
    kept = {"mm", "cm", *mixed}  # names keep the units that no setting of all columns says
    keys = short_names([stems[x] for x in places], PLACE)
    units = [unit_of(x) for x in places]
    ours = [f"{key}_{x}" if x in kept else key for key, x in zip(keys, units, strict=True)]
    found = {f"q_{name}": x for name, x in zip(ours, places, strict=True)}
    rates = {short_name(stem, PLACE): name for name, stem in speeds.items()}
    rates |= {short_name(stems[name], SPEED): name for name in free if kinds[name] == "v"}
    if keys and set(keys) <= set(rates):
        found |= {f"v_{name}": rates[key] for name, key in zip(ours, keys, strict=True)}
    return found | suggested_inputs(inputs, keys)


def suggested_inputs(given: Sequence[str], coordinates: Sequence[str]) -> dict[str, str]:
    """Return columns of inputs, measured ones if there are, named as coordinates where they can."""
    every = [x for x in given if not is_wanted(x)] or given
    keys = short_names([without_unit(name) for name in every], INPUT)
    if not set(keys) <= set(coordinates):
        keys = short_names(every)
    return {f"u_{key}": name for key, name in zip(keys, every, strict=True)}


def _times(free: Sequence[str], table: pd.DataFrame, *, named: bool) -> list[str]:
    """Return columns of times, by their names or else by their values, likely ones first.

    Of clocks, those that count rows are last. Where times are ``named``, values say nothing.
    """
    if (found := [name for name in free if says_time(name)]) or named:
        return sorted(found, key=lambda name: not _is_clock(table[name]))
    clocks = [name for name in free if not kind_of_column(name) and _is_clock(table[name])]
    counts = [x for x in clocks if (_numbers(table[x]).diff().iloc[1:] == 1).all()]
    return [x for x in clocks if x not in counts] + counts


def is_number(values: pd.Series) -> bool:
    """Return whether most values are numbers; empty cells are none."""
    return bool(_numbers(values.dropna()).notna().mean() > 0.5)


def _numbers(values: pd.Series) -> pd.Series:
    return pd.to_numeric(values, errors="coerce")


def _is_clock(values: pd.Series) -> bool:
    """Return whether values rise from row to row, except at restarts, or are dates."""
    if is_number(values):
        rises = _numbers(values).dropna().diff().iloc[1:]
        return bool((rises > 0).mean() > RISES)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # words that are no dates
        dates = pd.to_datetime(values.iloc[:9], errors="coerce", utc=True, format="mixed")
    return bool(dates.notna().all() and dates.nunique() > 1)


def _measures(values: pd.Series) -> bool:
    """Return whether values are those of a clock and do not number the rows."""
    return _is_clock(values) and values.dtype.kind not in "iu"


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
    return not kind_of_column(name) and not _is_clock(values) and values.nunique() > 1


def _pose(stems: Mapping[str, str]) -> dict[str, str]:
    """Return the columns of a quaternion, and of a position if there is one; else nothing.

    Four names that differ in the last letter, ``w``, ``x``, ``y`` or ``z``, are a quaternion.

    Args:
        stems: Names without units by those of the file.
    """
    ends = {(stem[:-1], stem[-1:].lower()): name for name, stem in stems.items()}
    vectors = [stem for stem, end in ends if end == "x" and {(stem, "y"), (stem, "z")} <= set(ends)]
    turns = [stem for stem in vectors if (stem, "w") in ends]
    forces = [stem for stem in vectors if kind_of_column(ends[stem, "x"]) == "u"]
    others = (stem for stem in vectors if stem not in (*turns, *forces))
    places = [x for x in others if not any(map(RATE.fullmatch, re.split(r"[^a-zA-Z]+", x)))]
    if not turns:
        return {}
    found = {f"q_{axis}": ends[places[0], axis] for axis in "xyz"} if places else {}
    return found | {f"q_R_{part}": ends[turns[0], part] for part in "wxyz"}


def as_setting(mapping: Columns) -> str:
    """Return ``data.columns`` as it can be typed."""
    pairs = (
        f"{_escaped(ours)}: {'null' if theirs is None else text_value(theirs)}"
        for ours, theirs in mapping.items()
    )
    return shlex.quote("data.columns={" + ", ".join(pairs) + "}")


def omitting(left_out: Sequence[str], columns: Columns | None = None) -> str:
    """Return the setting that leaves columns out, beside those that are given."""
    kept = {ours: theirs for ours, theirs in (columns or {}).items() if ours not in left_out}
    others = {name: None for name in left_out if name not in (columns or {})}
    if odd := [name for name in others if not KEY.fullmatch(name)]:
        return f"data.columns={{NAME: null}}, with an ASCII name in the file instead of {few(odd)}"
    return as_setting({**kept, **others})


def _escaped(key: str) -> str:
    """Return a key as Hydra reads it, where it can."""
    return re.sub(r"([\\()\[\]{}:=,])", r"\\\1", key)
