"""Resampling of recordings to equal time steps."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import CubicSpline

DENSE = 1 / 3
"""Share of a step below which the distance of samples allows polynomial fits."""
ENOUGH = 5
"""Least number of samples that a cubic polynomial is fitted to."""
LONGEST_GAP = 3
"""Steps over which a motion is interpolated, at most."""
TIME_TOLERANCE = 1e-3
"""Relative difference of two time steps up to which neither is longer: those of clocks scatter."""
PACE_TOLERANCE = 5e-5
"""That of the mean time step of a recording, which changes an inertia by twice as much."""


class Samples(NamedTuple):
    """Times (T,), configurations (T, n), velocities (T, n) if measured, and inputs (T, m)."""

    t: np.ndarray
    q: np.ndarray
    v: np.ndarray | None
    u: np.ndarray

    @property
    def clock(self) -> np.ndarray:
        """Times after the first sample [s], without those of gaps.

        A gap is longer than ``LONGEST_GAP`` usual steps of the samples. Those of a model do not
        matter, so that candidates with different ones have the same parts of recordings.
        """
        steps, usual = np.diff(self.t, prepend=self.t[:1]), self.step
        lost = np.where(steps > LONGEST_GAP * usual * (1 + TIME_TOLERANCE), steps - usual, 0.0)
        return np.asarray(self.t - self.t[:1] - np.cumsum(lost))

    @property
    def seconds(self) -> float:
        """Length of the motion without gaps [s]."""
        return float(self.clock[-1])

    @property
    def step(self) -> float:
        """Usual time between samples, their median [s]."""
        return float(np.median(np.diff(self.t)))

    def rows(self, which: slice | np.ndarray) -> Samples:
        """Return some of the samples."""
        v = None if self.v is None else self.v[which]
        return Samples(self.t[which], self.q[which], v, self.u[which])

    def between(self, low: float, high: float) -> Samples:
        """Return the samples from ``low`` to ``high`` [s] of the ``clock``."""
        clock = self.clock
        return self.rows((clock >= low) & (clock <= high))


def at_equal_times(t: np.ndarray, h: float) -> bool:
    """Return whether samples are nodes ``h`` apart, each step nearly and the mean of all closely.

    Times that scatter are those of nodes. A clock that runs at another pace is not, although each
    step may differ from ``h`` by less than such times do.
    """
    steps = np.diff(t)
    near = np.abs(steps - h) <= TIME_TOLERANCE * h
    whole = h * len(steps)
    return bool(near.all() and abs(t[-1] - t[0] - whole) <= PACE_TOLERANCE * whole)


def resample(samples: Samples, h: float) -> Samples:
    """Return the motion at nodes ``h`` apart, estimated from samples at rising times.

    Configurations and measured velocities are those of cubic polynomials fitted by least squares
    to the samples within ``h / 2`` of a node, or ``h`` where these are too few or all on one side,
    or of a cubic spline where this also holds within ``h``; without measured velocities, the slopes
    of these. Inputs, linear between samples, are averaged over ``h`` around a node, so that their
    impulse is the recorded one. The first node is ``h / 2`` after the first sample, so that there
    are samples on both sides, unless they are sparse.
    """
    t, q, v, u = samples
    lead = h / 2 if samples.step <= DENSE * h * (1 + TIME_TOLERANCE) else 0.0
    count = int(np.floor((t[-1] - t[0] - 2 * lead) / h + 1e-6)) + 1
    nodes = t[0] + lead + h * np.arange(count)
    place, slope = fitted(t, q, nodes, h)
    velocity = slope if v is None else fitted(t, v, nodes, h)[0]
    return Samples(nodes, place, velocity, averaged(t, u, nodes, h))


def fitted(
    t: np.ndarray, x: np.ndarray, nodes: np.ndarray, h: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return values and slopes (K, n) at the nodes of local cubic fits to ``x`` (T, n)."""
    spline = CubicSpline(t, x)
    value, slope = spline(nodes), spline(nodes, 1)
    for reach in (h, h / 2):  # the closer fit, where there is one, has the last word
        low = np.searchsorted(t, nodes - reach * (1 + 1e-6))
        high = np.searchsorted(t, nodes + reach * (1 + 1e-6))
        index = low[:, None] + np.arange((high - low).max(initial=0))
        inside = index < high[:, None]
        index = np.minimum(index, len(t) - 1)
        s = (t[index] - nodes[:, None]) / reach
        basis = s[..., None] ** np.arange(4) * inside[..., None]
        many = np.flatnonzero(inside.sum(1) >= ENOUGH)
        basis, samples = basis[many], x[index[many]]
        inverse = np.linalg.inv(basis.swapaxes(1, 2) @ basis)
        fit = inverse @ (basis.swapaxes(1, 2) @ samples)
        good = inverse[:, 0, 0] <= 1  # no noisier than one sample
        value[many[good]], slope[many[good]] = fit[good, 0], fit[good, 1] / reach
    return value, slope


def averaged(t: np.ndarray, u: np.ndarray, nodes: np.ndarray, h: float) -> np.ndarray:
    """Return means (K, m) over ``h`` around the nodes of ``u`` (T, m), linear between samples."""
    edges = np.clip(np.stack([nodes - h / 2, nodes + h / 2]), t[0], t[-1])
    k = np.clip(np.searchsorted(t, edges, side="right") - 1, 0, len(t) - 2)
    steps, rises = np.diff(t)[:, None], np.diff(u, axis=0)
    until = cumulative_trapezoid(u, t, axis=0, initial=0)
    past = (edges - t[k])[..., None]
    impulse = until[k] + past * (u[k] + past * rises[k] / steps[k] / 2)
    return np.asarray((impulse[1] - impulse[0]) / (edges[1] - edges[0])[:, None])
