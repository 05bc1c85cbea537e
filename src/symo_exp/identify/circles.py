"""Circles on which the points that two lengths describe lie."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

CURVED = 0.2
"""Distance of the points from a circle, over that from a line, up to which they are on the circle.
"""
NOISY, SMALL = 3.0, 0.01
"""Distance of the points from a circle, at most: over their noise, or over its radius."""


class Circle(NamedTuple):
    """A circle in the plane of two lengths."""

    x: float
    y: float
    radius: float


def circle_of(x: np.ndarray, y: np.ndarray, noise: float) -> Circle | None:
    """Return the circle on which points lie but for noise; ``None`` if there is none.

    The squared distances of the points from the origin are linear in their places on a circle, so
    that least squares find it (Kåsa, IEEE Transactions on Instrumentation and Measurement 25,
    1976).

    Args:
        x: First length of each point.
        y: Second length.
        noise: Standard deviation of both.
    """
    middle = np.array([x.mean(), y.mean()])
    points = np.stack([x, y], axis=1) - middle
    _, sizes, _ = np.linalg.svd(points, full_matrices=False)
    from_line = float(sizes[-1]) / np.sqrt(len(points))
    size = float(np.abs(points).max())
    if from_line == 0.0:
        return None
    near = points / size
    table = np.column_stack([2.0 * near, np.ones(len(near))])
    (a, b, c), *_ = np.linalg.lstsq(table, (near**2).sum(axis=1), rcond=None)
    radius = float(np.sqrt(max(0.0, c + a**2 + b**2))) * size
    centre = np.array([a, b]) * size
    apart = float(np.std(np.linalg.norm(points - centre, axis=1)))
    if apart > min(CURVED * from_line, max(NOISY * noise, SMALL * radius)):
        return None
    a, b = (centre + middle).tolist()
    return Circle(a, b, radius)
