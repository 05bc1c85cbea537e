"""Tables of recordings: read, checked and divided into trajectories."""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
import pandas as pd

from symo_exp.checks import one_of
from symo_exp.data.advice import OTHERS, Columns, as_setting, omitting
from symo_exp.data.formats import readable, table_of
from symo_exp.data.header import KINDS, UNITS, Header, headers
from symo_exp.data.paths import Location, few, shown, titled
from symo_exp.data.resample import Samples
from symo_exp.data.wraps import SAME, wraps_of
from symo_exp.errors import ConfigError
from symo_exp.mechanics.types import Coordinates
from symo_exp.systems.base import System

DROPPED = 0.05
"""Share of the rows, without a number or with an earlier time, up to which they are left out."""
FEWEST = 3
"""Samples of a recording, at least."""
REPEATED = 0.01
"""Time between samples over the usual one up to which a time repeats an earlier one."""
HUGE = 1e100
"""Size of a number beyond which it is none of a measurement, and its powers overflow."""
THOUSANDS = r"\s*[-+]?\d{1,3}(?:[.,' ]\d{3})+(?:[.,]\d+)?\s*"
"""A number with separators of thousands."""
FAR = 100.0
"""Distance from the median over the usual range beyond which a coordinate may be a sensor's
failure."""
JUMP, FEW_ROWS = 2.0, 10
"""Step from a row to the next over the largest elsewhere beyond which it is a jump, and the rows
between two of them, on average, from which a column may tell recordings apart."""
LEAP, TURNS = 4.0, (2 * math.pi, 360.0)
"""Speed from a row to the next, over that just before and after and the largest elsewhere, beyond
which another recording begins, and jumps of angles at which none does."""
VARIED = 2.0
"""Usual change of a position over its smallest, from which changes are not single steps of an
encoder."""
COUNTERS = (2.0**16, 2.0**32)
"""Values of a counter of times, after which it starts anew."""
SLOW, FAST = 1.0, 5e-6
"""Times between samples from which, and up to which, the unit of time has to be given."""
EPOCH = (1e9, 4.1e9)
"""Seconds since 1970 of the years 2001 to 2099."""
ORIGINS = {"d": (25569.0, 719529.0), "ms": (0.0,), "us": (0.0,), "ns": (0.0,)}
"""1970 in the units in which dates are: serial days of spreadsheets and of MATLAB, and counts."""
MINUTES = r"\s*(\d+):(\d\d(?:[.,]\d+)?)\s*"
"""Minutes and seconds, as spreadsheets write short times; hours and minutes look the same."""


class Recording(NamedTuple):
    """One recorded trajectory.

    Attributes:
        label: Its name.
        part: The split it belongs to, ``""`` where none is given.
        samples: The measured samples.
        whole: Those of the recording that it is a piece of, with inputs as they act.
    """

    label: str
    part: str
    samples: Samples
    whole: Samples

    def acting(self) -> Samples:
        """Return the samples with inputs as they act."""
        rows = np.searchsorted(self.whole.t, self.samples.t)
        return self.samples._replace(u=self.whole.u[rows])


class RecordingTable(NamedTuple):
    """The recordings of one or several files, in their order.

    Attributes:
        recordings: The trajectories.
        notes: Differences of the table from the files and columns that were not read, a line each.
    """

    recordings: tuple[Recording, ...]
    notes: tuple[str, ...] = ()


def read_recordings(
    path: Location,
    system: System,
    columns: Columns | None = None,
    time_unit: str | None = None,
) -> RecordingTable:
    """Return the trajectories of a path, their times rising, in seconds.

    With several files a trajectory is named ``<file>`` or ``<file>/<trajectory>``, where ``<file>``
    has no suffix and, if the same name is in several folders, begins with those that differ.

    Args:
        path: A file, a folder, a glob pattern or a list of them.
        system: Whose coordinates and inputs are read.
        columns: A mapping of this project's column names to those of the files; ``None`` instead of
            a name leaves the column out.
        time_unit: ``d``, ``h``, ``min``, ``s``, ``ms``, ``us`` or ``ns``; ``None`` takes that of
            the column's name or of its values.

    Raises:
        ConfigError: If a file cannot be read or is not sound.
    """
    if time_unit is not None:
        one_of("data.time_unit", time_unit, tuple(UNITS))
    found = headers(path, columns)
    recordings: list[Recording] = []
    notes: list[str] = []
    labels = _labels([file for file, _ in found])
    for (file, head), label in zip(found, labels, strict=True):
        with readable(path):
            version = file.stat().st_mtime_ns
        seconds = head.seconds if time_unit is None else UNITS[time_unit]
        where = shown(path if len(found) == 1 else file)
        inputs = tuple(system.inputs)
        one = _read(where, file, version, head, seconds, system.coordinates, inputs)
        notes += [*head.notes, *one.notes]
        for each in one.recordings:
            name = label if len(one.recordings) == 1 else f"{label}/{each.label}"
            recordings.append(each._replace(label=name) if len(found) > 1 else each)
    recordings, copies = _without_copies(recordings)
    return RecordingTable(tuple(recordings), (*dict.fromkeys(notes), *copies))


def _without_copies(recordings: Sequence[Recording]) -> tuple[list[Recording], list[str]]:
    """Return the recordings without those that have the samples of an earlier one, and a line.

    A model would be trained on the samples that it is validated and tested on. Recordings in which
    nothing moves are no copies of each other.
    """
    kept: dict[object, Recording] = {}
    copies = []
    for i, one in enumerate(recordings):
        q, u = one.samples.q, one.samples.u
        first = kept.setdefault((q.tobytes(), u.tobytes()) if np.ptp(q, axis=0).any() else i, one)
        if first is not one:
            copies.append(f"{one.label} of {first.label}")
    told = f"copies are left out: {few(copies)} (their samples are the same)"
    return list(kept.values()), [told] if copies else []


def _labels(files: Sequence[Path]) -> list[str]:
    """Return a name for each file that no other one has."""
    whole = [file.absolute() for file in files]
    top = os.path.commonpath([file.parent for file in whole])
    below = [file.relative_to(top) for file in whole]
    plain = [one.with_suffix("").as_posix() for one in below]
    choices = [one.stem for one in files], plain, [one.as_posix() for one in below]
    return next(names for names in choices if len(set(names)) == len(names))


@lru_cache(maxsize=64)  # shared by the jobs of a sweep
def _read(
    where: str, file: Path, version: int, head: Header, seconds: float | None,
    coordinates: Coordinates, inputs: tuple[str, ...],
) -> RecordingTable:  # fmt: skip
    wanted = _wanted(where, head, coordinates, inputs)
    numbers = ["t", *wanted["q"], *wanted["v"], *wanted["u"]]
    with readable(file):
        table = table_of(file)
        table.columns = pd.Index(head.names)
    notes: list[str] = []
    table["t"], seconds = _from_dates(where, table["t"], seconds, notes)
    for column in numbers:
        table[column] = _numbers(where, column, table[column])
    for column in wanted["q"]:
        table[column] = _without_failures(table[column].to_numpy())
    notes += filter(None, (_told_failures(x, table[x].to_numpy()) for x in wanted["u"]))
    table = _without_gaps(where, table, numbers, notes, dict(head.given))
    table["t"] = _going_on(table, notes)
    if seconds is None:
        _check_seconds(where, table["t"].to_numpy())
    else:
        table["t"] *= seconds
    table = _numbered(table, notes)
    _check_order(where, table)
    known = {*numbers, *OTHERS}
    table = _without_repeats(where, table, known, notes)
    others = [c for c in head.names if c and c not in known and c[:8] != "__index_"]
    _check_jumps(where, table, wanted["q"], others, dict(head.given))
    flat = [f"q_{name}" for name in coordinates.flat]
    _refuse_wraps(where, table, flat)
    table = _split_at_leaps(table, flat, notes)
    recordings = tuple(_divided(where, table, wanted, len(inputs)))
    if (used := sum(len(one.samples.t) for one in recordings)) < len(table):
        notes.append(
            f"{used} of {len(table)} rows are used: in the others, a sensor slower than the log "
            "repeats its positions"
        )
    unread = [c.lstrip(".") for c in others]
    notes += [f"columns that are not read: {few(unread)}"] if unread else []
    return RecordingTable(recordings, tuple(notes))


def _wanted(
    where: str, head: Header, coordinates: Coordinates, inputs: Sequence[str]
) -> dict[str, list[str]]:
    """Return the columns that are read, by their kind; velocities and inputs may be absent."""
    found, given = head.names, dict(head.given)
    wanted = {
        "q": [f"q_{name}" for name in coordinates.measured],
        "v": [f"v_{name}" for name in coordinates.names],
        "u": [f"u_{name}" for name in inputs],
    }
    _check_places(where, found, wanted, given)
    for kind in "vu":
        if not set(wanted[kind]) & set(found):
            wanted[kind] = []
    columns = ["t", *wanted["q"], *wanted["v"], *wanted["u"]]
    if missing := [column for column in columns if column not in found]:
        mapping = {column: column[2:] if column[2:] in found else "NAME" for column in missing}
        raise ConfigError(
            f"{where}: no column {', '.join(missing)}; it has {few(found)}; map it: "
            f"{as_setting({**given, **mapping})}"
        )
    return wanted


def _divided(
    where: str, table: pd.DataFrame, wanted: Mapping[str, Sequence[str]], inputs: int
) -> Iterator[Recording]:
    """Yield the trajectories of a table; ``inputs`` counts inputs, recorded or not."""
    for column in {"trajectory", "split"} & set(table.columns):
        if table[column].isna().any():
            raise ConfigError(
                f"{where}: rows without a {column}; give each row one, or leave out the column "
                f"that is read as {column}"
            )
    for label, rows in _groups(table):
        if len(rows) < FEWEST:
            raise ConfigError(
                f"{where}: {titled(label)} has {len(rows)} node(s); at least {FEWEST} are needed"
            )
        parts = list(rows["split"].astype(str).str.lower().unique()) if "split" in rows else [""]
        if len(parts) > 1:
            raise ConfigError(
                f"{where}: {titled(label)} is in the splits {few(parts)}; a trajectory "
                "belongs to one of them"
            )
        rows = _without_holds(rows.sort_values("t", kind="stable"), wanted)
        fields = {kind: rows[list(names)].to_numpy() for kind, names in wanted.items()}
        v = fields["v"] if wanted["v"] else None
        u = fields["u"] if wanted["u"] else np.zeros((len(rows), inputs))
        samples = Samples(rows["t"].to_numpy(), fields["q"], v, u)
        yield Recording(label, str(parts[0]), samples, whole=samples)


def _groups(table: pd.DataFrame) -> list[tuple[str, pd.DataFrame]]:
    """Return the rows of each trajectory, by its name."""
    if "trajectory" not in table:
        return [("", table)]
    names = table["trajectory"].map(str, na_action="ignore").astype(object)
    return list(table.groupby(names, sort=False))


def _check_places(
    where: str, found: Sequence[str], wanted: Mapping[str, Sequence[str]], given: Columns
) -> None:
    """Refuse columns that look like a coordinate or an input and are not one of the system's."""
    in_order: dict[str, str] = {}  # of kinds none of whose names differ in number
    for kind, names in wanted.items():
        others = [x for x in found if x[:2] == f"{kind}_" and x not in names]
        missing = [name for name in names if name not in found]
        if len(others) == len(missing):
            in_order |= dict(zip(missing, others, strict=True))
    for column in found:
        kind = column[0] if column[1:2] == "_" else ""
        if kind in KINDS and column not in wanted[kind]:
            there = few([name[2:] for name in wanted[kind]]) or "none"
            mend = f"or leave it out, {omitting([column], given)}"
            if column in in_order.values():
                mend = f"if the order is the same by {as_setting({**given, **in_order})}"
            raise ConfigError(
                f"{where}: column {column} belongs to no {KINDS[kind]} of the system ({there}); "
                f"rename it by data.columns or in the file, {mend}"
            )


def _from_dates(
    where: str, times: pd.Series, seconds: float | None, notes: list[str]
) -> tuple[pd.Series, float | None]:
    """Return times and their unit [s]; dates and times of a clock are counted from the first."""
    if pd.api.types.is_timedelta64_dtype(times):
        return times.dt.total_seconds(), 1.0
    dated = pd.api.types.is_datetime64_any_dtype(times)
    numbers = times.isna() if dated else pd.to_numeric(times, errors="coerce")  # words among them
    if not dated and numbers.notna().any():
        name = _unit_of_dates(numbers.dropna().to_numpy(), seconds)
        if name is None:
            return times, seconds
        if seconds is None:
            origin = " since 1970" * (0.0 in ORIGINS[name])
            notes.append(f"times are in {name}{origin}, as their size says")
        exact = pd.to_numeric(times[numbers.notna()])  # integers have more digits
        return (exact - exact.min()).reindex(times.index), UNITS[name]
    parts = times.astype(str).str.extract(f"^{MINUTES}$")
    if (parts[0].isna() & times.notna()).mean() <= DROPPED:
        found = times[parts[0].notna()]
        if len(found) and not (parts[1].str.len() > 2).any():
            raise ConfigError(
                f"{where}: times such as {found.iloc[0]} may be minutes and "
                "seconds, or hours and minutes; write them with hours, minutes and seconds, as "
                "0:02:05, or as numbers"
            )
        return 60.0 * parts[0].astype(float) + parts[1].str.replace(",", ".").astype(float), 1.0
    forms: list[tuple[str | None, Literal["coerce", "raise"]]]
    forms = [("ISO8601", "coerce"), (None, "raise")]  # a fraction of ISO may have any digits
    for form, errors in forms:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # no format is common to times of day
                dates = pd.to_datetime(times, utc=True, format=form, errors=errors)
        except (ValueError, TypeError):
            continue
        if (dates.isna() & times.notna()).mean() <= DROPPED:
            return (dates - dates.min()).dt.total_seconds(), 1.0
    return times, seconds


def _unit_of_dates(t: np.ndarray, seconds: float | None) -> str | None:
    """Return the unit of times that are dates as numbers, ``None`` if they are none.

    Days have to be fine as well: as seconds, times of this size are those of a clock.
    """
    middle = float(np.median(t))
    for name, unit in UNITS.items():
        if seconds not in (None, unit):
            continue
        if unit > 1.0 and seconds is None and not _gap(t) <= FAST:
            continue
        for origin in ORIGINS.get(name, ()):
            if EPOCH[0] <= (middle - origin) * unit <= EPOCH[1]:
                return name
    return None


def _gap(t: np.ndarray) -> float:
    """Return the usual time from a row to the next, NaN without any; roundings are none."""
    gaps = np.diff(t)
    gaps = gaps[gaps > 4.0 * np.finfo(float).eps * np.abs(t).max(initial=0.0)]
    return float(np.median(gaps)) if len(gaps) else math.nan


def _numbers(where: str, column: str, given: pd.Series) -> np.ndarray:
    """Return a column as numbers, ``nan`` for a few words among them."""
    if not pd.api.types.is_numeric_dtype(given):
        values = pd.to_numeric(given, errors="coerce")
        words = values.isna() & given.notna()
        large = given.astype(str).str.fullmatch(THOUSANDS) & words  # no failures, even if few
        if words.mean() > DROPPED or large.any():
            row = int(np.argmax(large if large.any() else words))
            raise ConfigError(
                f"{where}: column {column} holds values that are not numbers, "
                f"{repr(given.iloc[row])[:40]} in data row {row + 1}: write numbers as 1234.5, "
                "without units and separators of thousands"
            )
        given = values
    found = np.asarray(given.to_numpy(dtype=np.float64, na_value=np.nan))
    return np.where(np.abs(found) > HUGE, np.nan, found)


def _without_failures(x: np.ndarray) -> np.ndarray:
    """Return a coordinate with ``nan`` where its sensor fails, such as -9999 for a moment.

    Values that differ among each other are a motion, such as the only one of a log at rest.
    """
    there = x[np.isfinite(x)]
    low, middle, high = np.quantile(there, (0.05, 0.5, 0.95)) if len(there) else (0.0,) * 3
    away = np.abs(x - middle) > FAR * (high - low)
    if low == high or not away.any():
        return x
    edges = np.flatnonzero(np.diff(away, prepend=False, append=False))
    found = x.copy()
    for start, end in edges.reshape(-1, 2):
        one, beside = x[start:end], np.append(x[:start][-1:], x[end : end + 1])
        size = abs(one[0] - middle)
        if np.ptp(one) <= 1e-3 * size and not (np.abs(beside - one[0]) <= 0.5 * size).any():
            found[start:end] = np.nan
    return found


def _told_failures(column: str, x: np.ndarray) -> str:
    """Return a line on the values of an input that would be failures of a position."""
    odd = np.isnan(_without_failures(x)) & ~np.isnan(x)
    if not odd.any():
        return ""
    return (
        f"{column} is far from its other values in {int(odd.sum())} rows, such as {x[odd][0]:g} in "
        f"data row {int(np.argmax(odd)) + 1}, and they are used; if a sensor failed there, empty "
        "these cells in the file"
    )


def _without_gaps(
    where: str, table: pd.DataFrame, numbers: Sequence[str], notes: list[str], given: Columns
) -> pd.DataFrame:
    """Return the rows whose numbers are all finite; refuse a table with few of them."""
    bad = ~np.isfinite(table[list(numbers)])
    rows = bad.any(axis=1).to_numpy()
    if not rows.any():
        return table
    column, first = bad.sum().idxmax(), int(np.argmax(rows)) + 1
    told = f"{int(rows.sum())} of {len(rows)} rows"
    if rows.mean() > DROPPED:
        needed = ["t", *(x for x in numbers if x.startswith("q_"))]
        mend = (
            "let inputs keep their last values in the file, as DataFrame.ffill does, and remove "
            "the rows that still lack a number"
        )
        if bad[column].mean() > 1.0 - DROPPED:
            left_out = f", or leave it out, {omitting([column], given)}"
            mend = "fill that column in the file" + left_out * (column not in needed[:2])
        raise ConfigError(
            f"{where}: {told} have a number that is empty or no measurement, most of them in "
            f"column {column}, first data row {first}; at most {100 * DROPPED:g} % are left out: "
            f"{mend}"
        )
    why = "a number is missing, not finite or, as where a sensor fails, far from all others"
    notes.append(f"{told} are left out: {why}, first data row {first}")
    return table[~rows].reset_index(drop=True)


def _check_seconds(where: str, t: np.ndarray) -> None:
    """Refuse times without a stated unit whose samples would be slow or too fast in seconds."""
    fast, in_order = _gap(t), 2 * np.sum(np.diff(t) > 0) > len(t) - 1
    # other rows are those of several recordings, or in any order
    slow = fast if in_order else _gap(np.unique(t))
    if slow >= SLOW:
        step, unit = slow, next((name for name, unit in UNITS.items() if slow * unit < 0.1), "ns")
    elif fast <= FAST:
        step, unit = fast, "d"
    else:
        return
    told = "days" if unit == "d" else unit
    raise ConfigError(
        f"{where}: times are {step:.6g} apart, and nothing says their unit; if they are in {told}, "
        f"give data.time_unit={unit}, if in seconds, data.time_unit=s, the same for all files; if "
        "they count samples, multiply them by the time between two"
    )


def _going_on(table: pd.DataFrame, notes: list[str]) -> pd.Series:
    """Return times that go on where a counter of them starts anew.

    Those of microcontrollers have 16 or 32 bits: after each 65536, times begin at zero again.
    """
    found = table["t"].copy()
    for _, rows in _groups(table):
        t = rows["t"].to_numpy()
        steps = np.diff(t)
        back = steps < 0
        if not back.any() or back.all() or (t % 1 != 0).any():
            continue
        usual = np.median(steps[~back])
        for count in COUNTERS:
            across = steps[back] + count
            if np.ptp(t) < count and (across > 0).all() and (across <= JUMP * usual).all():
                found[rows.index] = t + count * np.append(0, np.cumsum(back))
                notes.append(f"times go on where their counter starts anew after {count:.0f}")
                break
    return found


def _numbered(table: pd.DataFrame, notes: list[str]) -> pd.DataFrame:
    """Return a table in which recordings are numbered where the clock starts anew.

    A clock starts anew if it goes back by more than half of the time since its last start.
    """
    if "trajectory" in table:
        return table
    t = table["t"].to_numpy()
    starts = np.flatnonzero(np.diff(t) < 0) + 1
    pieces = list(zip([0, *starts], [*starts, len(t)], strict=True))
    if len(starts) == 0 or len(starts) > len(t) / 4:
        return table  # in order, or in no order at all
    if any(t[last] > 0.5 * (t[first] + t[last - 1]) for first, last in pieces[:-1]):
        return table
    if min(last - first for first, last in pieces) < FEWEST:
        return table  # rows in another order
    notes.append(f"times start anew {len(starts)} time(s): {len(pieces)} recordings")
    numbers = np.concatenate([np.full(b - a, k + 1) for k, (a, b) in enumerate(pieces)])
    return table.assign(trajectory=numbers)


def _check_order(where: str, table: pd.DataFrame) -> None:
    """Refuse a clock that was set back: that is a second recording."""
    for label, rows in _groups(table):
        t = rows["t"].to_numpy()
        back = np.flatnonzero(np.diff(t) < 0)
        if 0 < len(back) < len(t) / 4:
            raise ConfigError(
                f"{where}: {titled(label)} goes back in time after t={t[back[0]]:.13g}; give "
                "each recording a number of its own in the column trajectory, or sort the rows by t"
            )


def _check_jumps(
    where: str, table: pd.DataFrame, places: Sequence[str], unread: Sequence[str], given: Columns
) -> None:
    """Refuse a column that is not read and tells recordings apart, between which positions jump.

    Gaps between samples are no jumps: recordings are cut there.
    """
    if "trajectory" in table or len(table) < FEWEST:
        return
    rows = table.sort_values("t", kind="stable")
    steps, q = np.diff(rows["t"]), np.abs(np.diff(rows[list(places)], axis=0))
    usual = steps < JUMP * np.median(steps)
    for column in unread:
        words = rows[column].astype(str).to_numpy()
        changes = usual & (words[1:] != words[:-1])
        if column[0] == "." or not 0 < changes.sum() <= len(rows) / FEW_ROWS:
            continue
        most = q[usual & ~changes].max(axis=0, initial=0.0)
        jumps = (q[changes] > JUMP * most).any(axis=1)
        if jumps.mean() >= 0.5:
            raise ConfigError(
                f"{where}: positions jump where {column} changes, as between recordings; read it "
                f"as their number, {as_setting({**given, 'trajectory': column})}, or leave it out, "
                f"{omitting([column], given)}"
            )


def _refuse_wraps(where: str, table: pd.DataFrame, places: Sequence[str]) -> None:
    """Refuse a coordinate that starts anew after another change than a turn."""
    if len(table) < FEWEST:
        return
    groups = [rows.sort_values("t", kind="stable") for _, rows in _groups(table)]
    for name in places:
        count, period = wraps_of([rows[name].to_numpy() for rows in groups])
        if not count or any(abs(period - turn) <= SAME * turn for turn in TURNS):
            continue
        raise ConfigError(
            f"{where}: {name} starts anew {count} times, after a change of about {period:g}, which "
            "is no turn in radians or degrees: let it go on in the file, as by "
            f"numpy.unwrap(x, period={period:g}), and convert counts of an encoder to radians or "
            "metres; if recordings begin there, number them in a column trajectory"
        )


def _split_at_leaps(table: pd.DataFrame, places: Sequence[str], notes: list[str]) -> pd.DataFrame:
    """Return a table in which recordings are numbered where positions leap.

    A blow changes a velocity to that after it, and a sensor that fails for a row leaps twice. A
    step far longer than both of its neighbours, and than all others, is that to the beginning of
    another recording, unless an angle jumps by a turn.
    """
    if "trajectory" in table or len(table) < FEWEST or not places:
        return table
    rows = table.sort_values("t", kind="stable")
    steps, moves = np.diff(rows["t"]), np.abs(np.diff(rows[list(places)], axis=0))
    moves = np.min([moves, *(np.abs(moves - turn) for turn in TURNS)], axis=0)
    speed = moves / np.maximum(steps, np.median(steps))[:, None]
    beside = np.pad(speed, ((1, 1), (0, 0)))
    sudden = speed > LEAP * np.maximum(beside[:-2], beside[2:])
    most = np.where(sudden, 0.0, speed).max(axis=0)
    leaps = (sudden & (speed > LEAP * most) & (most > 0.0)).any(axis=1)
    starts = np.flatnonzero(leaps) + 1
    lengths = np.diff([0, *starts, len(rows)])
    if not len(starts) or lengths.min() < FEW_ROWS:
        return table
    notes.append(
        f"positions leap {len(starts)} time(s), first after t={rows['t'].iloc[starts[0] - 1]:.6g}: "
        f"{len(lengths)} recordings (a column trajectory says otherwise)"
    )
    return rows.assign(trajectory=np.repeat(np.arange(1, len(lengths) + 1), lengths))


def _without_holds(rows: pd.DataFrame, wanted: Mapping[str, Sequence[str]]) -> pd.DataFrame:
    """Return the rows in which positions are new, with the means of inputs around them.

    A sensor that is slower than the log repeats each position the same number of times, however
    fast the machine moves, and the repeated ones are no measurements.
    """
    q, inputs = rows[list(wanted["q"])].to_numpy(), list(wanted["u"])
    held = _rows_of_a_hold(q)
    if held == 1:
        return rows
    new = np.flatnonzero(np.diff(q, axis=0, prepend=np.nan).any(axis=1))
    ends = np.append(new[1:], len(rows))
    kept = [np.arange(a, b, held) for a, b in zip(new, ends, strict=True)]  # several at rest
    means = rows[inputs].rolling(held, center=True, min_periods=1).mean()
    return rows.assign(**{name: means[name] for name in inputs}).iloc[np.concatenate(kept)]


def _rows_of_a_hold(q: np.ndarray) -> int:
    """Return in how many rows a sensor repeats each position, 1 if it is not slower than the log.

    Positions of an encoder also repeat: where it turns slowly, and then change by a single step.
    """
    changes = np.abs(np.diff(q, axis=0))
    new = np.flatnonzero(changes.any(axis=1))
    if len(new) < FEW_ROWS:
        return 1
    low, high = np.quantile(np.diff(new), (0.1, 0.9))
    changes = np.where(changes > 0.0, changes, np.nan)[new]
    there = changes[:, np.isfinite(changes).any(axis=0)]
    varied = np.nanmedian(there, axis=0) > VARIED * np.nanmin(there, axis=0)
    return math.ceil(high) if low > 1 and high - low <= 1 and varied.any() else 1


def _without_repeats(
    where: str, table: pd.DataFrame, known: set[str], notes: list[str]
) -> pd.DataFrame:
    """Return the first row of each time; refuse a table in which many times repeat.

    Rows that are the same as earlier ones in all ``known`` columns are left out, however many.
    Times very close to each other also count as repeated: slopes between their rows are those of
    the noise.
    """
    copies = table.duplicated([name for name in table if name in known])
    if copies.any():
        notes.append(f"{int(copies.sum())} of {len(table)} rows are copies and are left out")
        table = table[~copies].reset_index(drop=True)
    again = np.zeros(len(table), dtype=bool)
    for _, rows in _groups(table):
        t = rows["t"].sort_values(kind="stable")
        steps = t.diff()
        again[t.index] = steps <= REPEATED * np.nan_to_num(steps[steps > 0].median())
    if not again.any():
        return table
    told = f"{int(again.sum())} of {len(again)} rows repeat the time of an earlier one"
    if again.mean() > DROPPED:
        at = table["t"].iloc[int(np.argmax(again))]
        raise ConfigError(
            f"{where}: {told}, first t={at:.13g}; at most {100 * DROPPED:g} % are left out: give "
            "each recording a number of its own in the column trajectory, or times more digits"
        )
    notes.append(f"{told} and are left out")
    return table[~again]
