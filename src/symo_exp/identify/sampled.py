"""Recordings at nodes a time step apart, as regressions read them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from symo_exp.data.delays import acting_late
from symo_exp.data.folds import moves
from symo_exp.data.resample import Samples, averaged, fitted
from symo_exp.data.table import Recording
from symo_exp.data.weak import Motion, held_still, quasi_coordinates
from symo_exp.mechanics.types import Coordinates

EXAMINED, NODES = 60.0, 3000
"""Length of the training part that delay and speeds are estimated from [s], and its nodes at
least."""
BEFORE, AFTER = 8.0, 0.04
"""Times before and after a piece in which its inputs are kept [s], for ``identify.inputs``: ten of
the longest time constants, and the earliest action."""
Sampled = tuple[Recording, np.ndarray, np.ndarray]
"""A recording, nodes a time step apart, and configurations at the nodes."""


def first_seconds(recordings: Sequence[Recording], seconds: float) -> list[Recording]:
    """Return the first seconds of recordings, of those first in which inputs act.

    Of the whole that a recording is a piece of, they have what may act in them.
    """
    found, total = [], 0.0
    for one in sorted(recordings, key=lambda one: not one.samples.u.any()):
        if total >= seconds:
            break
        t = one.samples.t
        inside = t - t[0] <= seconds - total
        total += one.samples.seconds
        samples = one.samples.rows(inside)
        found.append(one._replace(samples=samples, whole=_around(one.whole, samples)))
    return [one for one in found if len(one.samples.t) > 20]


def _around(whole: Samples, samples: Samples) -> Samples:
    """Return samples with those of the whole around them whose inputs may act in them."""
    first, last = samples.t[0] - BEFORE, samples.t[-1] + AFTER
    return whole.rows((whole.t >= first) & (whole.t <= last))


def at_nodes(recordings: Sequence[Recording], h: float) -> list[Sampled]:
    """Return the recordings at nodes, what never moves exactly constant.

    Rounding errors vibrate, and noise beside a motion is none that anything could explain. Where
    everything seems to be noise, nothing is held.
    """
    columns = zip(*(one.samples.q.T for one in recordings), strict=True)
    motion = np.array([moves(each) for each in columns], dtype=bool)
    motion |= not motion.any()
    samples = [one.samples for one in recordings]
    held = held_still([(np.where(motion, one.q, one.q[0]), one.u) for one in samples])
    motions = []
    for one, (q, _) in zip(recordings, held, strict=True):
        t = one.samples.t
        nodes = np.arange(t[0] + h, t[-1] - h, h)
        if len(nodes) > 13:
            path = np.where(np.ptp(q, axis=0) > 0.0, fitted(t, q, nodes, h)[0], q[0])
            motions.append((one._replace(samples=one.samples._replace(q=q)), nodes, path))
    return motions


def with_inputs(motions: Sequence[Sampled], h: float, delay: float) -> list[Motion]:
    """Return configurations and inputs, which act ``delay`` after their record, at the nodes."""
    return [
        (q, averaged(one.samples.t, acting_late(one, delay).acting().u, nodes, h))
        for one, nodes, q in motions
    ]


def scaled_motions(pairs: Sequence[Motion], coordinates: Coordinates) -> list[Motion]:
    """Return motions whose lengths are in the units of the coordinates."""
    flat = len(coordinates.flat)
    places = np.ones(coordinates.width)
    places[:flat] = coordinates.sizes.numpy()[:flat]
    return [(q / places, u) for q, u in pairs]


def along_turns(recording: Recording, space: Coordinates) -> Recording:
    """Return a recording of the sums of the turns of rotations (``quasi_coordinates``)."""
    samples = recording.samples
    return recording._replace(samples=samples._replace(q=quasi_coordinates(samples.q, space)))
