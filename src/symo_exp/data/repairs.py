"""Numbers and rows of a table that are no measurement."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from symo_exp.data.advice import Columns, omitting
from symo_exp.data.trajectories import FEW_ROWS, by_trajectory
from symo_exp.errors import ConfigError

DROPPED = 0.05
"""Share of the rows, without a number or with an earlier time, up to which they are left out."""
REPEATED = 0.01
"""Time between samples over the usual one up to which a time repeats an earlier one."""
HUGE = 1e100
"""Size of a number beyond which it is none of a measurement, and its powers overflow."""
THOUSANDS = r"\s*[-+]?\d{1,3}(?:[.,' ]\d{3})+(?:[.,]\d+)?\s*"
"""A number with separators of thousands."""
FAR = 100.0
"""Distance from the median over the usual range beyond which a coordinate may be a sensor's
failure."""
VARIED = 2.0
"""Usual change of a position over its smallest, from which changes are not single steps of an
encoder."""


def as_numbers(where: str, column: str, given: pd.Series) -> np.ndarray:
    """Return a column as numbers, ``nan`` for a few words among them.

    Args:
        where: The beginning of the message.
        column: Its name.
        given: Its values.

    Raises:
        ConfigError: If there are many words, or numbers have separators of thousands.
    """
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


def without_failures(x: np.ndarray) -> np.ndarray:
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


def told_failures(column: str, x: np.ndarray) -> str:
    """Return a line on the values of an input that would be failures of a position."""
    odd = np.isnan(without_failures(x)) & ~np.isnan(x)
    if not odd.any():
        return ""
    return (
        f"{column} is far from its other values in {int(odd.sum())} rows, such as {x[odd][0]:g} in "
        f"data row {int(np.argmax(odd)) + 1}, and they are used; if a sensor failed there, empty "
        "these cells in the file"
    )


def without_gaps(
    where: str, table: pd.DataFrame, numbers: Sequence[str], notes: list[str], given: Columns
) -> pd.DataFrame:
    """Return the rows whose numbers are all finite.

    Args:
        where: The beginning of the message.
        table: The table.
        numbers: Names of the columns that are read.
        notes: Lines for the log, to which one is added.
        given: As ``data.columns``.

    Raises:
        ConfigError: If more than ``DROPPED`` of the rows would be left out.
    """
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


def without_repeats(
    where: str, table: pd.DataFrame, known: set[str], notes: list[str]
) -> pd.DataFrame:
    """Return the first row of each time.

    Rows that are the same as earlier ones in all ``known`` columns are left out, however many.
    Times very close to each other also count as repeated: slopes between their rows are those of
    the noise.

    Args:
        where: The beginning of the message.
        table: The table.
        known: Names of the columns that are read.
        notes: Lines for the log, to which one is added.

    Raises:
        ConfigError: If more than ``DROPPED`` of the rows repeat a time with other values.
    """
    copies = table.duplicated([name for name in table if name in known])
    if copies.any():
        notes.append(f"{int(copies.sum())} of {len(table)} rows are copies and are left out")
        table = table[~copies].reset_index(drop=True)
    again = np.zeros(len(table), dtype=bool)
    for _, rows in by_trajectory(table):
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


def without_holds(rows: pd.DataFrame, wanted: Mapping[str, Sequence[str]]) -> pd.DataFrame:
    """Return the rows in which positions are new, with the means of inputs around them.

    A sensor that is slower than the log repeats each position the same number of times, however
    fast the machine moves, and the repeated ones are no measurements.

    Args:
        rows: The rows of a trajectory, their times rising.
        wanted: Names of the columns of coordinates, velocities and inputs, by ``q``, ``v``, ``u``.
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
