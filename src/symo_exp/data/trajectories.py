"""Trajectories of a table: where one ends and the next begins."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np
import pandas as pd

from symo_exp.data.advice import Columns, as_setting, omitting
from symo_exp.data.paths import titled
from symo_exp.data.wraps import SAME, wraps_of
from symo_exp.errors import ConfigError
from symo_exp.mechanics.windows import NODES
from symo_exp.words import counted

JUMP, FEW_ROWS = 2.0, 10
"""Step from a row to the next over the largest elsewhere beyond which it is a jump, and the rows
between two of them, on average, from which a column may tell recordings apart."""
LEAP, TURNS = 4.0, (2 * math.pi, 360.0)
"""Speed from a row to the next, over that just before and after and the largest elsewhere, beyond
which another recording begins, and jumps of angles at which none does."""


def by_trajectory(table: pd.DataFrame) -> list[tuple[str, pd.DataFrame]]:
    """Return the rows of each trajectory, by its name."""
    if "trajectory" not in table:
        return [("", table)]
    return [(str(name), rows) for name, rows in table.groupby("trajectory", sort=False)]


def numbers_of_rows(table: pd.DataFrame) -> np.ndarray:
    """Return the number of each row in its trajectory, the first being 0."""
    if "trajectory" not in table:
        return np.arange(len(table))
    names = table["trajectory"].map(str)  # Parquet may have lists
    return table.groupby(names, sort=False).cumcount().to_numpy()


def numbered_by_clock(table: pd.DataFrame, notes: list[str]) -> pd.DataFrame:
    """Return a table in which recordings are numbered where the clock starts anew.

    A clock starts anew if it goes back by more than half of the time since its last start.

    Args:
        table: The table, unchanged if it has a column ``trajectory``.
        notes: Lines for the log, to which one is added.
    """
    if "trajectory" in table:
        return table
    t = table["t"].to_numpy()
    back = np.diff(t) < 0
    if not 0 < back.sum() <= len(t) / 4:
        return table  # in order, or in no order at all
    pieces = np.split(t, np.flatnonzero(back) + 1)
    if any(after[0] > 0.5 * (one[0] + one[-1]) for one, after in itertools.pairwise(pieces)):
        return table
    if min(map(len, pieces)) < NODES:
        return table  # rows in another order
    notes.append(f"times start anew {counted(back.sum(), 'time')}: {len(pieces)} recordings")
    return table.assign(trajectory=1 + np.append(0, np.cumsum(back)))


def check_order(where: str, table: pd.DataFrame) -> None:
    """Refuse a clock that was set back: that is a second recording.

    Args:
        where: The beginning of the message.
        table: The table.

    Raises:
        ConfigError: If the times of a trajectory go back.
    """
    for label, rows in by_trajectory(table):
        t = rows["t"].to_numpy()
        back = np.flatnonzero(np.diff(t) < 0)
        if 0 < len(back) < len(t) / 4:
            raise ConfigError(
                f"{where}: {titled(label)} goes back in time after t={t[back[0]]:.13g}; give "
                "each recording a number of its own in the column trajectory, or sort the rows by t"
            )


def check_jumps(
    where: str, table: pd.DataFrame, places: Sequence[str], unread: Sequence[str], given: Columns
) -> None:
    """Refuse a column that is not read and tells recordings apart, between which positions jump.

    Gaps between samples are no jumps: recordings are cut there.

    Args:
        where: The beginning of the message.
        table: The table.
        places: Names of the columns of coordinates.
        unread: Names of the columns that are not read.
        given: As ``data.columns``.

    Raises:
        ConfigError: If there is such a column.
    """
    if "trajectory" in table or len(table) < NODES:
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


def refuse_wraps(where: str, table: pd.DataFrame, places: Sequence[str]) -> None:
    """Refuse a coordinate that starts anew after another change than a turn.

    Args:
        where: The beginning of the message.
        table: The table.
        places: Names of the columns of lengths and angles.

    Raises:
        ConfigError: If there is such a coordinate.
    """
    if len(table) < NODES:
        return
    groups = [rows.sort_values("t", kind="stable") for _, rows in by_trajectory(table)]
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


def split_at_leaps(table: pd.DataFrame, places: Sequence[str], notes: list[str]) -> pd.DataFrame:
    """Return a table in which recordings are numbered where positions leap.

    A blow changes a velocity to that after it, and a sensor that fails for a row leaps twice. A
    step far longer than both of its neighbours, and than all others, is that to the beginning of
    another recording, unless an angle jumps by a turn.

    Args:
        table: The table, unchanged if it has a column ``trajectory``.
        places: Names of the columns of lengths and angles.
        notes: Lines for the log, to which one is added.
    """
    if "trajectory" in table or len(table) < NODES or not places:
        return table
    rows = table.sort_values("t", kind="stable")
    steps, moves = np.diff(rows["t"]), np.abs(np.diff(rows[list(places)], axis=0))
    moves = np.min([moves, *(np.abs(moves - turn) for turn in TURNS)], axis=0)
    speed = moves / np.maximum(steps, np.median(steps))[:, None]
    beside = np.pad(speed, ((1, 1), (0, 0)))
    sudden = speed > LEAP * np.maximum(beside[:-2], beside[2:])
    most = np.where(sudden, 0.0, speed).max(axis=0)
    leaps = (sudden & (speed > LEAP * most) & (most > 0.0)).any(axis=1)
    last = np.flatnonzero(leaps)
    if not len(last) or np.diff([-1, *last, len(leaps)]).min() < FEW_ROWS:
        return table
    notes.append(
        f"positions leap {counted(len(last), 'time')}, first after "
        f"t={rows['t'].iloc[last[0]]:.6g}: {len(last) + 1} recordings (a column trajectory says "
        "otherwise)"
    )
    return rows.assign(trajectory=1 + np.append(0, np.cumsum(leaps)))
