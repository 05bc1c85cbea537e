"""Stretches of recordings that no model is fitted to."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from symo_exp.data.resample import LONGEST_GAP, TIME_TOLERANCE
from symo_exp.data.shocks import shocks
from symo_exp.data.table import Recording
from symo_exp.identify.sampled import at_nodes, with_inputs
from symo_exp.mechanics.types import Coordinates

FAST, USUAL_MISS = 0.03, 8.0
"""Distance of a node from the cubic through its four neighbours from which samples do not resolve
an angle [rad], and that over the median distance, which is that of noise, at least."""
PIECE = 13
"""Nodes between two such stretches, at least: models are not fitted to shorter pieces."""
Stretch = tuple[str, float, float]
"""Label of a recording, first and last time of a stretch of it [s]."""


def too_fast(recordings: Sequence[Recording], coordinates: Coordinates, h: float) -> list[Stretch]:
    """Return when angles move too fast for samples a time step apart.

    There, a cubic polynomial through the two nodes before and the two after a node misses it.
    Integrators are as inaccurate, and a fit reduces their large errors at the expense of all
    others. There are no stretches if samples are closer, since smaller time steps are tried, with
    rotations, or if the greater part of the motion is too fast.
    """
    angular = np.array(coordinates.angular)
    if coordinates.rotations or not angular.any():
        return []
    if 2.0 * max(one.samples.step for one in recordings) <= h * (1 + TIME_TOLERANCE):
        return []
    motions = at_nodes(recordings, h)
    misses = [np.abs(np.diff(q[:, angular], 4, axis=0)).max(axis=1) / 6 for _, _, q in motions]
    if not misses:
        return []
    limit = max(FAST, USUAL_MISS * float(np.median(np.concatenate(misses))))
    found, lost = [], 0.0
    for (one, nodes, _), missed in zip(motions, misses, strict=True):
        fast = np.flatnonzero(missed > limit) + 2
        for run in np.split(fast, np.flatnonzero(np.diff(fast) > PIECE) + 1) if len(fast) else ():
            first, last = run[0] - LONGEST_GAP, run[-1] + LONGEST_GAP
            low, high = nodes[max(first, 0)], nodes[min(last, len(nodes) - 1)]
            found.append((one.label, float(low), float(high)))
            lost += high - low
    return found if lost < 0.5 * sum(one.samples.seconds for one in recordings) else []


def struck(recordings: Sequence[Recording], coordinates: Coordinates, h: float) -> list[Stretch]:
    """Return when something that is not recorded moves the machine (``data.shocks``).

    Shocks of machines with rotations are not searched for.
    """
    if coordinates.rotations:
        return []
    motions = at_nodes(recordings, h)
    found = shocks(with_inputs(motions, h, 0.0), coordinates, h)
    return [
        (one.label, float(nodes[first]), float(nodes[last]))
        for (one, nodes, _), runs in zip(motions, found, strict=True)
        for first, last in runs
    ]


REASONS = {
    too_fast: "angles move too fast there for the distance of the samples",
    struck: "something else moved the machine there, as the same states at other times show",
}
"""Functions that find stretches to leave out, in this order, and why they are left out."""
