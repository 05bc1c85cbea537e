"""A verdict on a model of a machine, in words."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

HORIZONS = (0.5, 1.0, 2.0)
GOOD, USABLE = 0.1, 0.5
"""Share of constant velocity's error up to which a model is good, and usable."""
EXPLAINED = 0.5
"""Share of the accelerations' power that inputs and friction explain, below which none is found."""


@dataclass(frozen=True)
class Verdict:
    """``label`` is ``good``, ``usable`` or ``no model``; ``lines`` say why."""

    label: str
    lines: tuple[str, ...]


def verdict(measures: Mapping[str, float], doubts: Sequence[str] = ()) -> Verdict:
    """Return the verdict on a tested model.

    Args:
        measures: Those of the run on its test part.
        doubts: Causes of a failure that the recordings show.
    """
    shares = {}
    for seconds in HORIZONS:
        mine = measures.get(f"rmse_{seconds:g}s", math.nan)
        baseline = measures.get(f"constant_velocity_rmse_{seconds:g}s", math.nan)
        if not math.isnan(mine) and baseline > 0:
            shares[seconds] = (mine, baseline)
    if not shares:
        return Verdict("no model", ("no window of the test part moves: nothing can be said",))
    lines = [
        f"to {seconds:g} s: error {mine:.2g}, constant velocity {baseline:.2g} "
        f"({_times(baseline, mine)})"
        for seconds, (mine, baseline) in shares.items()
    ]
    good = [s for s, (mine, baseline) in shares.items() if mine <= GOOD * baseline]
    usable = [s for s, (mine, baseline) in shares.items() if mine <= USABLE * baseline]
    if len(good) == len(shares):
        return Verdict("good", tuple(lines))
    if usable:
        return Verdict(f"usable to {max(usable):g} s", tuple(lines))
    why = list(doubts) or ["no candidate found a law that holds beyond the training part"]
    return Verdict("no model", (*lines, *(f"why: {doubt}" for doubt in why)))


def _times(baseline: float, mine: float) -> str:
    if not math.isfinite(mine):
        return "the model diverges"
    return f"{baseline / max(mine, 1e-300):.2g} times less" if mine <= baseline else "no better"
