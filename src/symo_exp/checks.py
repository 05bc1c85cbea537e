"""Checks of values that a user gives, in settings or as arguments."""

from __future__ import annotations

import inspect
import math
import os
from collections.abc import Iterable, Mapping, Sequence
from numbers import Integral, Real
from typing import Any

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
    below: float | None = None,
) -> float:
    """Return ``value`` as a float.

    Raises:
        ConfigError: If it is not a finite number from ``low`` to ``high``, above ``above`` and
            below ``below``.
    """
    number = float(value) if isinstance(value, Real) and not isinstance(value, bool) else math.nan
    inside = (low is None or number >= low) and (high is None or number <= high)
    inside &= (above is None or number > above) and (below is None or number < below)
    if inside and math.isfinite(number):
        return number
    bounds = {"of at least": low, "above": above, "of at most": high, "below": below}
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
        if isinstance(value, type):
            given = f"the class {value.__name__}"
        raise ConfigError(f"{key} is {given}: expected a {kind.__module__}.{kind.__name__}")


def function(key: str, value: object, wanted: str, *given: object, **named: object) -> None:
    """Raise ``ConfigError`` unless ``value`` can be called with these arguments.

    Args:
        key: The name of the value, for the error.
        value: The given object.
        wanted: The expected object in words, for the error.
        given: Arguments by position, of which only the number counts.
        named: Arguments by name, of which only the names count.
    """
    told = type(value).__name__
    if callable(value):
        try:
            signature = inspect.signature(value)
        except ValueError:  # of a function that is not written in Python
            return
        try:
            signature.bind(*given, **named)
            return
        except TypeError:
            told = f"{getattr(value, '__name__', told)}{signature}"
    raise ConfigError(f"{key} is {told}: expected {wanted}")


def dictionary(key: str, value: object, names: Iterable[str]) -> dict[str, Any]:
    """Return ``value``; raise ``ConfigError`` unless it is a dictionary with only these names."""
    names = list(names)
    if not isinstance(value, Mapping) or not set(value) <= set(names):
        raise ConfigError(f"{key}={value!r}: expected a dictionary with any of {', '.join(names)}")
    return dict(value)


def path_text(what: str, value: object, wanted: str) -> str:
    """Return ``value`` as text; raise ``ConfigError`` unless it is a path.

    Args:
        what: The function or setting that takes it, for the error.
        value: The given object.
        wanted: The expected object in words, for the error.
    """
    if not isinstance(value, str | os.PathLike):
        raise ConfigError(f"{what}({type(value).__name__}): expected {wanted}")
    return os.fspath(value)
