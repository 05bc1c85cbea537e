"""Measured velocities that contradict the configurations."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
from scipy.integrate import cumulative_trapezoid

from symo_exp.data.advice import Columns, omitting
from symo_exp.data.resample import Samples
from symo_exp.mechanics.types import Coordinates

ALIKE = 5.0
"""Ratio of a velocity to the slope of its coordinate, or its inverse, up to which they agree: slow
motions hide in the noise."""


def contradicting_velocities(
    coordinates: Coordinates, sampled: Sequence[Samples], columns: Columns | None
) -> Iterator[str]:
    """Yield a line on each velocity in another unit or direction than its length or angle.

    Args:
        coordinates: Those of the machine.
        sampled: Samples of each recording.
        columns: As ``data.columns``, the setting so far.
    """
    velocities = [f"v_{name}" for name in coordinates.names]
    for i, name in enumerate(coordinates.flat):
        ratios = [_ratio(one, i) for one in sampled if one.v is not None]
        ratio = float(np.median(ratios)) if ratios else 1.0
        if not 1.0 / ALIKE < ratio < ALIKE:
            yield (
                f"v_{name} is {ratio:.2g} times the slope of q_{name}: check the signs and units "
                f"of times and velocities, or leave velocities out, {omitting(velocities, columns)}"
            )


def _ratio(samples: Samples, i: int) -> float:
    """Return the motion of the integrated velocity relative to that of the configuration.

    It is negative if they go in opposite directions.
    """
    assert samples.v is not None
    t, v = samples.t - samples.t[0], samples.v[:, i]
    paths = cumulative_trapezoid(v, t, initial=0), samples.q[:, i]
    moved, q = (x - np.polyval(np.polyfit(t, x, 1), t) for x in paths)
    ratio = math.copysign(float(np.std(moved) / (np.std(q) or np.nan)), float(moved @ q))
    return ratio if ratio and math.isfinite(ratio) else 1.0
