"""Units of length, time and mass in which the numbers of a machine are of order one."""

from __future__ import annotations

import re
from fractions import Fraction
from typing import NamedTuple

POWERS = {
    "m": (1, 0, 0), "s": (0, 1, 0), "kg": (0, 0, 1), "N": (1, -2, 1), "rad": (0, 0, 0),
    "1": (0, 0, 0),
}  # fmt: skip
"""Powers of length, time and mass in units."""


class Units(NamedTuple):
    """Units in which the learned parts of a model have their parameters.

    Attributes:
        length: Unit of length [m].
        time: Unit of time [s].
        mass: Unit of mass [kg].
    """

    length: float = 1.0
    time: float = 1.0
    mass: float = 1.0

    def size(self, unit: str) -> float:
        """Return the unit of the same quantity, in an SI unit such as ``kg m^2`` or ``N s/m``."""
        found = 1.0
        for below, name, power in re.findall(r"(/?)([A-Za-z]+|1)(?:\^\(?(\d+(?:/\d+)?)\)?)?", unit):
            exponent = Fraction(power or 1) * (-1 if below else 1)
            for size, times in zip(self, POWERS[name], strict=True):
                found *= size ** float(exponent * times)
        return found


SI = Units()
"""Metres, seconds and kilograms."""
