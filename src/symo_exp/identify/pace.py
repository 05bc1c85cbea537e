"""How fast a machine moves and errors grow: the time step, and times to compare errors over."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from symo_exp.data.explained import growth_rate
from symo_exp.data.folds import thinned
from symo_exp.data.parts import uninterrupted
from symo_exp.data.resample import TIME_TOLERANCE
from symo_exp.data.sensors import blur_of, noise_of
from symo_exp.data.table import Recording
from symo_exp.evaluation.horizon import HORIZONS
from symo_exp.identify.sampled import EXAMINED, Sampled, at_nodes, first_seconds, with_inputs
from symo_exp.mechanics.types import Coordinates

STEPS = (0.02, 0.01, 0.005, *(x * 10.0**-k for k in range(3, 7) for x in (2, 1, 0.5)))
"""Time steps to choose from [s], the usual one first."""
COARSE = 0.7
"""Change of an angle, or of the phase of a vibration, in a time step above which a smaller one is
taken [rad]."""
STEEP = 0.3
"""Logarithm of the growth of errors in a time step above which a smaller one is taken."""
MISSED = 0.3
"""Share of a motion that lines between the nodes may miss."""
SPREAD = 600.0
"""Length of the pieces, from the whole recordings, that the fastest turn is found in [s]."""
LARGEST, LONGEST = 7.0, 4.0
"""Logarithms of the growth of errors: over 2 s beyond which horizons are shorter, and over the
longest of these."""


def fitting_time_step(
    recordings: Sequence[Recording], coordinates: Coordinates, finest: float
) -> float:
    """Return the largest of ``STEPS`` that resolves the motion, else ``finest``."""
    usable = [h for h in STEPS if finest <= h * (1 + TIME_TOLERANCE)]
    finest = float(f"{finest:.4g}")
    if not usable:
        return finest
    recordings, _ = uninterrupted(recordings, usable[0])  # nothing is known of a motion in a gap
    beginning, spread = first_seconds(recordings, EXAMINED), thinned(recordings, SPREAD)

    def resolves(h: float) -> bool:
        slow = _turn(spread, coordinates, h) <= COARSE and _phase(beginning, h) <= COARSE
        return slow and growth_of_errors(beginning, coordinates, h) * h <= STEEP

    return next(filter(resolves, usable), min(finest, usable[-1]))


def _turn(recordings: Sequence[Recording], coordinates: Coordinates, h: float) -> float:
    """Return the change of angles in a time step that few are larger than [rad].

    It is that of nodes, which have less noise than samples, whose noise would count as a speed.
    """
    angular = np.array(coordinates.angular)
    motions = at_nodes(recordings, h) if angular.any() else ()
    steps = [np.abs(np.diff(q[:, angular], axis=0)) for _, _, q in motions]
    return float(np.quantile(np.concatenate(steps), 0.999)) if steps else 0.0


def _phase(recordings: Sequence[Recording], h: float) -> float:
    """Return ``ω h``, the phase by which the fastest coordinate vibrates in a time step [rad].

    It is infinite where lines between the nodes miss much of the motion, or recordings are too
    short for such a step.
    """
    motions = at_nodes(recordings, h)
    if not motions:
        return np.inf if recordings else 0.0
    return np.inf if _missed(motions) > MISSED else h * vibration(motions, h)


def _missed(motions: Sequence[Sampled]) -> float:
    """Return the share of a coordinate's motion that lines between nodes miss, the largest."""
    left, motion = 0.0, np.finfo(float).tiny
    for one, nodes, q in motions:
        samples = one.samples
        inside = (samples.t >= nodes[0]) & (samples.t <= nodes[-1])
        lines = np.stack([np.interp(samples.t[inside], nodes, x) for x in q.T], axis=1)
        left = left + np.sum((samples.q[inside] - lines) ** 2, axis=0)
        motion = motion + np.sum((samples.q[inside] - samples.q[inside].mean(axis=0)) ** 2, axis=0)
    return float(np.sqrt(left / motion).max())


def vibration(motions: Sequence[Sampled], h: float) -> float:
    """Return the frequency ``ω`` at which the fastest coordinate vibrates [rad/s].

    It is the ratio of the root mean squares of accelerations and velocities, without the noise of
    the nodes; 0 where noise hides them.
    """
    first, second = (np.concatenate([np.diff(q, k, axis=0) for _, _, q in motions]) for k in (1, 2))
    columns = zip(*(one.samples.q.T for one, _, _ in motions), strict=True)
    noise = np.array([np.nan_to_num(noise_of(each)) for each in columns])
    count = h / np.median(np.concatenate([np.diff(one.samples.t) for one, _, _ in motions]))
    blur = blur_of(noise, count) ** 2
    velocity = np.mean(first**2, axis=0) - 2 * blur
    acceleration = np.mean(second**2, axis=0) - 6 * blur
    seen = (velocity > blur) & (acceleration > blur)
    return float(np.sqrt(acceleration[seen] / velocity[seen]).max(initial=0.0)) / h


def growth_of_errors(
    recordings: Sequence[Recording], coordinates: Coordinates, h: float, delay: float = 0.0
) -> float:
    """Return the rate at which small errors grow [1/s], 0 with rotations and where it is unknown.

    It is seen at the time step, or where noise hides it there, at the next larger one of ``STEPS``.
    """
    if coordinates.rotations:
        return 0.0
    for step in sorted({h, *(larger for larger in STEPS if larger > h)}):
        rate = growth_rate(with_inputs(at_nodes(recordings, step), step, delay), coordinates, step)
        if rate is not None:
            return rate
    return 0.0


def suitable_horizons(rate: float) -> tuple[float, ...]:
    """Return horizons [s] over which errors grow little, the usual ones if these are suitable.

    Over longer ones the noise of the starts grows beyond the motion, and a wrong model that stays
    near the mean has smaller errors than the right one. ``rate`` is that of the growth [1/s].
    """
    growth = rate * HORIZONS[-1]
    if growth <= LARGEST:
        return HORIZONS
    return tuple(float(f"{LONGEST / growth * each:.2g}") for each in HORIZONS)
