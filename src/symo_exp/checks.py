"""Checks of values that a user sets."""

from __future__ import annotations

import math
from collections.abc import Sequence
from numbers import Integral

from symo_exp.errors import ConfigError

MOST = 10**7
"""Trajectories or steps of one that memory may hold."""


def whole_number(key: str, value: object, *, low: int = 1, high: int | None = None) -> int:
    """Return ``value``; raise ``ConfigError`` unless it is an integer from ``low`` to ``high``."""
    if isinstance(value, Integral) and not isinstance(value, bool):
        number = int(value)
        if low <= number and (high is None or number <= high):
            return number
    wanted = f"of at least {low}" if high is None else f"from {low} to {high}"
    raise ConfigError(f"{key}={value!r}: expected a whole number {wanted}")


def real(
    key: str,
    value: object,
    *,
    low: float | None = None,
    high: float | None = None,
    above: float | None = None,
) -> float:
    """Return ``value`` as a float.

    Raises:
        ConfigError: If it is not a finite number from ``low`` to ``high`` and above ``above``.
    """
    if isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value):
        inside = (low is None or value >= low) and (high is None or value <= high)
        if inside and (above is None or value > above):
            return float(value)
    bounds = {"of at least": low, "above": above, "of at most": high}
    wanted = " and ".join(f"{word} {x:g}" for word, x in bounds.items() if x is not None)
    raise ConfigError(f"{key}={value!r}: expected a finite number {wanted}".rstrip())


def truth(key: str, value: object) -> bool:
    """Return ``value``; raise ``ConfigError`` unless it is true or false."""
    if not isinstance(value, bool):
        raise ConfigError(f"{key}={value!r}: expected true or false")
    return value


def one_of(key: str, value: object, choices: Sequence[str]) -> str:
    """Return ``value``; raise ``ConfigError`` unless it is one of ``choices``."""
    if value not in choices:
        raise ConfigError(f"{key}={value!r}: expected one of {', '.join(choices)}")
    return str(value)


def instance(key: str, value: object, kind: type) -> None:
    """Raise ``ConfigError`` unless ``value`` is of a class, such as that which a user extends."""
    if not isinstance(value, kind):
        given = "null" if value is None else type(value).__name__
        raise ConfigError(f"{key} is {given}: expected a {kind.__module__}.{kind.__name__}")
