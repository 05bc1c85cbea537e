"""Inputs that act later than they are recorded."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from symo_exp.checks import real
from symo_exp.data.resample import Samples
from symo_exp.data.table import Recording

LONGEST_LAG = 1e9
"""Time constant of inputs at most [s]: beyond it their slopes overflow."""


def acting_as_given(
    recordings: Sequence[Recording], delay: float | None, lag: float | None
) -> list[Recording]:
    """Return recordings whose inputs act as ``data.input_delay`` and ``data.input_lag`` say.

    Args:
        recordings: Whole ones: pieces continue the inputs before them.
        delay: From the record of an input to its force [s]; ``None``: 0.
        lag: Time constant with which the force follows the input [s]; ``None``: 0.

    Raises:
        ConfigError: If no input is left, or the setting is no number.
    """
    longest = max((one.samples.seconds for one in recordings), default=0.0)
    delay = real("data.input_delay", delay or 0.0, low=-longest, high=longest)
    lag = real("data.input_lag", lag or 0.0, low=0.0, high=LONGEST_LAG)
    return [acting_late(one, delay, lag) for one in recordings]


def acting_late(recording: Recording, delay: float = 0.0, lag: float = 0.0) -> Recording:
    """Return a recording, or a piece of one, whose inputs act later than they are recorded."""
    return recording._replace(whole=lagging(delayed(recording.whole, delay), lag))


def delayed(samples: Samples, seconds: float) -> Samples:
    """Return the samples with inputs that act ``seconds`` after they are recorded.

    A negative delay is that of inputs recorded later than they act. Inputs are linear between
    samples and constant beyond the first and the last one.
    """
    if seconds == 0.0 or not samples.u.shape[1]:
        return samples
    t = samples.t
    return samples._replace(u=np.stack([np.interp(t - seconds, t, u) for u in samples.u.T], axis=1))


def lagging(samples: Samples, seconds: float) -> Samples:
    """Return the samples with inputs that follow the recorded ones with a time constant.

    ``τ ẏ = u - y`` from ``y = u`` at the first sample, exact for inputs that are linear between
    samples.
    """
    t, u = samples.t, samples.u
    if seconds == 0.0 or not u.shape[1]:
        return samples
    steps = np.diff(t)[:, None]
    behind, kept = seconds * np.diff(u, axis=0) / steps, np.exp(-steps / seconds)
    gains = u[1:] - behind - kept * (u[:-1] - behind)

    def along(first: float, gains: np.ndarray) -> list[float]:
        pairs = zip(kept[:, 0].tolist(), gains.tolist(), strict=True)  # numbers are faster
        steps = itertools.accumulate(pairs, lambda y, pair: pair[0] * y + pair[1], initial=first)
        return list(steps)

    return samples._replace(u=np.array([*map(along, u[0].tolist(), gains.T)]).T)
