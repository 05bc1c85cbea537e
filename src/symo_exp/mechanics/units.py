"""Units of length, time and mass in which the numbers of a machine are of order one."""

from __future__ import annotations

import math
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator
from fractions import Fraction
from typing import NamedTuple

POWERS = {
    "m": (1, 0, 0), "s": (0, 1, 0), "kg": (0, 0, 1), "N": (1, -2, 1), "rad": (0, 0, 0),
    "1": (0, 0, 0),
}  # fmt: skip
"""Powers of length, time and mass in units; those of others, such as V, are zero."""
FACTOR = re.compile(
    r"(/?) *(?:\(((?:[^()]|\([^()]*\))*)\)|([A-Za-z]+|1))(?:\^\(?(\d+(?:/\d+)?)\)?)?"
)
"""A slash, a unit or a product of units in parentheses, and its power."""


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
        return math.prod(x ** float(power) for x, power in zip(self, powers_in(unit), strict=True))


SI = Units()
"""Metres, seconds and kilograms."""


def powers_in(unit: str) -> tuple[Fraction, Fraction, Fraction]:
    """Return the powers of length, time and mass in a unit."""
    length = time = mass = Fraction(0)
    for name, exponent in _factors(unit):
        own = POWERS.get(name, (0, 0, 0))
        length, time, mass = (
            x + exponent * y for x, y in zip((length, time, mass), own, strict=True)
        )
    return length, time, mass


def product(powers: Iterable[tuple[str, float]]) -> str:
    """Return the unit of a product of powers of quantities, without what cancels.

    Args:
        powers: The unit of each quantity and its power.
    """
    total: dict[str, Fraction] = defaultdict(Fraction)
    for unit, power in powers:
        for name, exponent in _factors(unit):
            total[name] += exponent * Fraction(power)
    total.pop("1", None)
    above = " ".join(_power(name, x) for name, x in total.items() if x > 0) or "1"
    below = [_power(name, -x) for name, x in total.items() if x < 0]
    if len(below) > 1:
        return f"{above}/({' '.join(below)})"
    return "/".join([above, *below])


def _power(name: str, exponent: Fraction) -> str:
    if exponent == 1:
        return name
    return f"{name}^{exponent}" if exponent.denominator == 1 else f"{name}^({exponent})"


def _factors(unit: str) -> Iterator[tuple[str, Fraction]]:
    """Yield the units of which one such as ``N s/m`` or ``kg/(m s)`` is the product of powers."""
    for below, group, name, power in FACTOR.findall(unit):
        exponent = Fraction(power or 1) * (-1 if below else 1)
        for part, own in _factors(group) if group else [(name, Fraction(1))]:
            yield part, exponent * own
