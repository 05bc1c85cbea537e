"""Noise and resolution of sensors, as samples show them."""

from __future__ import annotations

from collections.abc import Sequence
from math import comb

import numpy as np

ROUNDING = 1e-9
"""Increments over the largest value up to which they are rounding errors."""


def noise_of(columns: Sequence[np.ndarray]) -> float:
    """Return the standard deviation of white noise on smooth motions.

    It is that of their k-th differences over ``√C(2k, k)``, the least over k; the largest twentieth
    of them, gaps and shocks, is left out. NaN with too few samples.
    """
    found = []
    for k in range(3, 9):
        squares = np.sort(np.concatenate([np.diff(x, k) ** 2 for x in columns]))
        if kept := int(0.95 * len(squares)):
            found.append(np.sqrt(squares[:kept].mean() / comb(2 * k, k)) / 0.871)
    return float(min(found, default=np.nan))


def blur_of(noise: np.ndarray, samples: float) -> np.ndarray:
    """Return the noise of nodes, each a local cubic fitted to so many samples.

    A cubic fitted to N equal steps has 9/4N of their variance in its middle.
    """
    return noise * np.sqrt(min(1.0, 2.25 / samples))


def encoder_of(columns: Sequence[np.ndarray]) -> float:
    """Return the step that all increments are multiples of, 0 if there is none."""
    rises = np.concatenate([np.abs(np.diff(x)) for x in columns])
    rises = rises[rises > ROUNDING * np.abs(np.concatenate(columns)).max()]
    if not len(rises):
        return 0.0
    step = float(np.quantile(rises, 0.01))
    ratios = rises[rises < 20 * step] / step
    whole = np.abs(ratios - ratios.round()) < 0.02
    return step if len(ratios) >= 20 and whole.mean() > 0.98 else 0.0
