"""Names of columns of times, and the units that they state."""

from __future__ import annotations

import re

from symo_exp.data.languages import WORDS

TIME_UNITS = {
    "d": "d", "day": "d", "days": "d", "h": "h", "hour": "h", "hours": "h", "min": "min",
    "minutes": "min", "s": "s", "sec": "s", "secs": "s", "seconds": "s", "ms": "ms", "msec": "ms",
    "millis": "ms", "milliseconds": "ms", "us": "us", "\u00b5s": "us", "\u03bcs": "us",
    "usec": "us", "micros": "us", "microseconds": "us", "ns": "ns", "nsec": "ns", "nanos": "ns",
    "nanoseconds": "ns",
}  # fmt: skip
"""Units of time as names state them, by their spelling."""
IN_UNIT = r"(?:_(UNIT)|(?: *[\[(]| in )(UNIT)[\])]?)".replace("UNIT", "|".join(TIME_UNITS))
CLOCKS = "|".join((*WORDS["time"].split(), *WORDS["timestamp"].split()))
TIME = re.compile(rf"_*(?:t|times?|timestamps?|stamps?|{CLOCKS})(?:{IN_UNIT})?", re.IGNORECASE)
"""Names of a time column, with the unit that they state."""
IN_TIME = re.compile(rf".+{IN_UNIT}", re.IGNORECASE)
"""Names that state a unit of time."""
