"""Coordinates that start anew at an end of their range, as a counter does."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

JUMP = 0.5
"""Step from a row to the next over the range of a coordinate from which it is a jump."""
FEWEST = 2
"""Jumps with the same period, at least."""
SAME = 0.03
"""Difference of two periods, relative to them, up to which they are the same."""
BESIDE = 3
"""Steps on either side of a jump that tell the velocity there."""
MOST = 0.5
"""Share of the jumps with the same period, across which the motion goes on, above which a
coordinate starts anew; also that of the larger of two velocities from which they are alike."""
AT_REST = 0.1
"""Velocity over the usual one up to which recordings may begin or end there."""


def wraps_of(columns: Sequence[np.ndarray]) -> tuple[int, float]:
    """Return how often a coordinate starts anew, and after which change; zeros if it does not.

    A jump is that of a counter if the coordinate goes on with the velocity before it, once the
    period is added. Motions that were written one below the other also jump, but most of them begin
    and end at rest, or with different velocities.

    Args:
        columns: Values of the coordinate in each recording, in the order of time.
    """
    every, steps = np.concatenate(columns), np.concatenate([np.abs(np.diff(x)) for x in columns])
    large = JUMP * float(np.ptp(every))
    if not (steps > large).any():
        return 0, 0.0
    least = AT_REST * float(np.median(steps))
    jumps = [(x, i) for x in columns for i in np.flatnonzero(np.abs(np.diff(x)) > large).tolist()]
    found = [_jump(x[max(0, i - BESIDE) : i + BESIDE + 2], min(i, BESIDE), least) for x, i in jumps]
    periods, goes_on = np.array(found).T
    period = float(np.median(periods))
    alike = (goes_on > 0.0) & (np.abs(periods - period) <= SAME * period)
    if alike.sum() < FEWEST or alike.mean() <= MOST:
        return 0, 0.0
    counter = 2.0 ** round(math.log2(period))
    whole = (every % 1 == 0).all() and abs(counter - period) <= SAME * period
    return len(found), counter if whole else float(f"{period:.4g}")


def _jump(x: np.ndarray, i: int, least: float) -> tuple[float, bool]:
    """Return the period of a jump after row ``i`` of those beside it.

    The second result is whether the motion goes on across it, faster than ``least`` in a row.
    """
    jump = float(x[i + 1] - x[i])
    steps = -math.copysign(1.0, jump) * np.diff(x)
    before, after = steps[:i], steps[i + 1 :]
    if not (len(before) and len(after)):
        return abs(jump), False
    slow, fast = sorted(float(np.median(some)) for some in (before, after))
    return abs(jump) + (before[-1] + after[0]) / 2, slow > max(MOST * fast, least)
