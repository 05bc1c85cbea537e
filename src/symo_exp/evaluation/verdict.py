"""Verdict on a model of recordings, in words."""

from __future__ import annotations

import math
from collections.abc import Mapping

ERRORS = {"rmse_0.5s": 0.5, "rmse_1s": 1.0, "rmse_2s": 2.0}
"""Measures of prediction errors, and their horizons [s]."""
BETTER = 0.9
"""Share of constant velocity's error below which a model is better."""
LONGER = 2.0
"""Ratio of the times to which a model and constant velocity are usable, from which it outlasts."""
WHOLE, WINDOW = 0.95, 2.0
"""Share of a window for which a good model is usable, and the length of a window [s] where the
measures do not say it."""


def outlasts(measures: Mapping[str, float]) -> bool:
    """Return whether a model is usable for a time, and clearly longer than constant velocity.

    Over longer times the errors of an unstable machine grow beyond those of constant velocity,
    whatever the model.
    """
    usable = measures.get("usable_s", 0.0)
    other = measures.get("constant_velocity_usable_s", usable)
    return usable > 0.0 and LONGER * other <= usable


def beside_baseline(measures: Mapping[str, float]) -> list[tuple[float, float]]:
    """Return the error of a model and that of constant velocity up to each time."""
    pairs = [(name, f"constant_velocity_{name}") for name in ERRORS]
    return [(measures[a], measures[b]) for a, b in pairs if {a, b} <= measures.keys()]


def verdict(measures: Mapping[str, float]) -> str | None:
    """Return the verdict on a model of recordings, ``None`` if its measures do not decide.

    A model is *good* if its error stays within a tenth of the motion over windows of 2 s, or of
    what a shorter recording has (median over windows), *usable* to the time until which it does,
    and *no better than constant velocity* if its error exceeds 0.9 times that baseline's over
    0.5, 1 and 2 s and it is not usable for twice as long.

    Args:
        measures: Those of a run by name (docs/metrics.md).
    """
    if measures.get("windows") == 0.0:
        return "not judged: in 2 s of the test recordings nothing moves, or they are too short"
    if "usable_s" not in measures:
        return None
    pairs = beside_baseline(measures)
    if pairs and all(not own < BETTER * other for own, other in pairs) and not outlasts(measures):
        return "no better than constant velocity"
    seconds, window = measures["usable_s"], measures.get("window_s", WINDOW)
    if math.isfinite(seconds) and seconds >= WHOLE * window:
        short = window < WHOLE * WINDOW
        return f"good over the {_two(window)} s that the test recordings last" if short else "good"
    return f"usable to {_two(seconds)} s" if seconds > 0 else "not usable, off from the start"


def comparison(measures: Mapping[str, float], unit: str) -> str | None:
    """Return the errors of a model beside the baseline's and the noise, in a line.

    They are those over 1 s, or over what shorter windows have. ``None`` where there are no windows.
    ``unit`` is that of the errors, such as ``m, rad``.
    """
    if "rmse_1s" not in measures or "constant_velocity_rmse_1s" not in measures:
        return None
    seconds = min(1.0, measures.get("window_s", WINDOW))
    names = ("rmse_1s", "constant_velocity_rmse_1s", "noise")
    own, baseline, noise = (_two(measures[x]) if x in measures else "" for x in names)
    told = f", noise {noise}" if noise else ""
    return f"RMSE to {_two(seconds)} s {own} {unit} (constant velocity {baseline}{told})"


def _two(x: float) -> str:
    """Return two digits of a number, such as ``120``, ``0.0021`` or, as in tables, ``2.2e-5``."""
    digits, e, exponent = f"{float(f'{x:.2g}'):g}".partition("e")
    return f"{digits}e{int(exponent)}" if e else digits
