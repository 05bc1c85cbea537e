"""Times of a table: dates, units, counters."""

from __future__ import annotations

import math
import warnings
from typing import Literal

import numpy as np
import pandas as pd

from symo_exp.data.header import UNITS
from symo_exp.data.repairs import DROPPED
from symo_exp.data.trajectories import JUMP, by_trajectory
from symo_exp.errors import ConfigError

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


def from_dates(
    where: str, times: pd.Series, seconds: float | None, notes: list[str]
) -> tuple[pd.Series, float | None]:
    """Return times and their unit [s]; dates and times of a clock are counted from the first.

    Args:
        where: The beginning of the message.
        times: The column of times.
        seconds: Its unit [s] as settings or its name state it; ``None``: unknown.
        notes: Lines for the log, to which one is added.

    Raises:
        ConfigError: If the times are words that are no dates.
    """
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

    Of an unknown unit, times have to be fine as well. Clocks that count from their start have times
    of this size too: in seconds after half a day, in nanoseconds after half an hour.
    """
    middle, gap = float(np.median(t)), _usual_gap(t)
    for name, unit in UNITS.items():
        if seconds not in (None, unit):
            continue
        if seconds is None and not gap < (FAST if unit > 1.0 else SLOW / unit):
            continue
        for origin in ORIGINS.get(name, ()):
            if EPOCH[0] <= (middle - origin) * unit <= EPOCH[1]:
                return name
    return None


def _usual_gap(t: np.ndarray) -> float:
    """Return the usual time between samples, NaN without any.

    Rows that are not in order are those of several recordings, or in any order.
    """
    in_order = 2 * np.sum(np.diff(t) > 0) > len(t) - 1
    return _gap(t if in_order else np.unique(t))


def _gap(t: np.ndarray) -> float:
    """Return the usual time from a row to the next, NaN without any; roundings are none."""
    gaps = np.diff(t)
    gaps = gaps[gaps > 4.0 * np.finfo(float).eps * np.abs(t).max(initial=0.0)]
    return float(np.median(gaps)) if len(gaps) else math.nan


def check_seconds(where: str, t: np.ndarray) -> None:
    """Refuse times without a stated unit whose samples would be slow or too fast in seconds.

    Args:
        where: The beginning of the message.
        t: The times.

    Raises:
        ConfigError: If the usual time between samples is beyond ``SLOW`` or ``FAST``.
    """
    fast, slow = _gap(t), _usual_gap(t)
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


def going_on(table: pd.DataFrame, notes: list[str]) -> pd.Series:
    """Return times that go on where a counter of them starts anew.

    Those of microcontrollers have 16 or 32 bits: after each 65536, times begin at zero again.

    Args:
        table: The table, its times in ``t``.
        notes: Lines for the log, to which one is added.
    """
    found = table["t"].copy()
    for _, rows in by_trajectory(table):
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
