"""Tables of recordings: read, checked and divided into trajectories."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from symo_exp.checks import one_of, real
from symo_exp.data.advice import OTHERS, Columns, as_setting, omitting
from symo_exp.data.formats import readable, table_of
from symo_exp.data.header import KINDS, UNITS, Header, headers
from symo_exp.data.paths import Location, few, shown, titled
from symo_exp.data.repairs import (
    as_numbers,
    told_failures,
    without_failures,
    without_gaps,
    without_holds,
    without_repeats,
)
from symo_exp.data.resample import Samples
from symo_exp.data.times import check_seconds, from_dates, going_on
from symo_exp.data.trajectories import (
    by_trajectory,
    check_jumps,
    check_order,
    numbered_by_clock,
    numbers_of_rows,
    refuse_wraps,
    split_at_leaps,
)
from symo_exp.errors import ConfigError
from symo_exp.mechanics.types import Coordinates
from symo_exp.mechanics.windows import NODES
from symo_exp.systems.base import System
from symo_exp.words import counted


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
    notes: tuple[str, ...]


def read_recordings(
    path: Location,
    system: System,
    columns: Columns | None = None,
    time_unit: str | None = None,
    sample_time: float | None = None,
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
        sample_time: Time from a row to the next [s], for files without times.

    Raises:
        ConfigError: If a file cannot be read or is not sound.
    """
    if time_unit is not None:
        one_of("data.time_unit", time_unit, tuple(UNITS))
    if sample_time is not None:
        real("data.sample_time", sample_time, above=0)
    found = headers(path, columns, timed=sample_time is None)
    recordings: list[Recording] = []
    notes: list[str] = []
    labels = _labels([file for file, _ in found])
    for (file, head), label in zip(found, labels, strict=True):
        with readable(path):
            version = file.stat().st_mtime_ns
        seconds = head.seconds if time_unit is None else UNITS[time_unit]
        where = shown(path if len(found) == 1 else file)
        inputs = tuple(system.inputs)
        if sample_time is not None and "t" in head.names:
            raise ConfigError(f"data.sample_time={sample_time:g}: {where} has times; leave it out")
        one = _read(where, file, version, head, seconds, sample_time, system.coordinates, inputs)
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
    sample_time: float | None, coordinates: Coordinates, inputs: tuple[str, ...],
) -> RecordingTable:  # fmt: skip
    wanted = _wanted(where, head, coordinates, inputs)
    numbers = ["t", *wanted["q"], *wanted["v"], *wanted["u"]]
    with readable(file):
        table = table_of(file)
        table.columns = pd.Index(head.names)
    notes: list[str] = []
    if sample_time is not None:
        table["t"], seconds = sample_time * numbers_of_rows(table), 1.0
    table["t"], seconds = from_dates(where, table["t"], seconds, notes)
    for column in numbers:
        table[column] = as_numbers(where, column, table[column])
    for column in wanted["q"]:
        table[column] = without_failures(table[column].to_numpy())
    notes += filter(None, (told_failures(x, table[x].to_numpy()) for x in wanted["u"]))
    table = without_gaps(where, table, numbers, notes, dict(head.given))
    for column in {"trajectory", "split"} & set(table):
        if table[column].isna().any():
            raise ConfigError(
                f"{where}: rows without a {column}; give each row one, or leave out the column "
                f"that is read as {column}"
            )
        if table[column].dtype.kind == "O":  # lists of Parquet, and categories without rows
            table[column] = table[column].map(str).astype(object)
    table["t"] = going_on(table, notes)
    if seconds is None:
        check_seconds(where, table["t"].to_numpy())
    else:
        table["t"] *= seconds
    table = numbered_by_clock(table, notes)
    check_order(where, table)
    known = {*numbers, *OTHERS}
    table = without_repeats(where, table, known, notes)
    others = [c for c in head.names if c and c not in known and c[:8] != "__index_"]
    check_jumps(where, table, wanted["q"], others, dict(head.given))
    flat = [f"q_{name}" for name in coordinates.flat]
    refuse_wraps(where, table, flat)
    table = split_at_leaps(table, flat, notes)
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
    columns = [*wanted["q"], *wanted["v"], *wanted["u"]]
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
    for label, rows in by_trajectory(table):
        if len(rows) < NODES:
            nodes = counted(len(rows), "node")
            raise ConfigError(f"{where}: {titled(label)} has {nodes}; at least {NODES} are needed")
        parts = list(rows["split"].astype(str).str.lower().unique()) if "split" in rows else [""]
        if len(parts) > 1:
            raise ConfigError(
                f"{where}: {titled(label)} is in the splits {few(parts)}; a trajectory "
                "belongs to one of them"
            )
        rows = without_holds(rows.sort_values("t", kind="stable"), wanted)
        fields = {kind: rows[list(names)].to_numpy() for kind, names in wanted.items()}
        v = fields["v"] if wanted["v"] else None
        u = fields["u"] if wanted["u"] else np.zeros((len(rows), inputs))
        samples = Samples(rows["t"].to_numpy(), fields["q"], v, u)
        yield Recording(label, str(parts[0]), samples, whole=samples)


def _check_places(
    where: str, found: Sequence[str], wanted: Mapping[str, Sequence[str]], given: Columns
) -> None:
    """Refuse columns that look like a coordinate or an input and are not one of the system's."""
    in_order: dict[str, str] = {}  # wanted to found names, of kinds with as many of each
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
                kept = {ours: x for ours, x in given.items() if ours not in in_order.values()}
                in_file = {ours: given.get(x, x) for ours, x in in_order.items()}
                mend = f"if the order is the same by {as_setting({**kept, **in_file})}"
            # a recorded system has all of these columns; of velocities, it may lack some
            other = "for a machine without known equations, give system=recorded; else "
            raise ConfigError(
                f"{where}: column {column} belongs to no {KINDS[kind]} of the system ({there}); "
                f"{other * (kind != 'v')}rename it by data.columns or in the file, {mend}"
            )
