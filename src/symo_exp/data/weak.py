"""Weak accelerations of motions, and their regression on terms of states and inputs."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence

import numpy as np
import torch

from symo_exp.mechanics.types import Coordinates

HALF = 5
"""Nodes on either side of the middle of a test function."""
SHORTEST = 2 * HALF + 3
"""Nodes of a motion that a test function fits into, at least."""
ROUNDING = 1e-10
"""Range of a coordinate relative to its size up to which it is still."""
Motion = tuple[np.ndarray, np.ndarray]
"""Configurations (T, N) and inputs (T, m) at nodes."""
Terms = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
"""Maps configurations, velocities and inputs at nodes to the columns of a regression."""


def quasi_coordinates(q: np.ndarray, coordinates: Coordinates) -> np.ndarray:
    """Return numbers (T, n) whose rates are the velocities of a motion (T, N), all in body axes.

    Lengths and angles are such numbers. Those of a rotation are the sums of the turns between
    nodes, those of the position of a free body the sums of its steps in body axes: forces that turn
    with a body do not depend on its attitude then.
    """
    if not coordinates.rotations:
        return q
    space, stored = coordinates.space, torch.as_tensor(q)
    found = space.unrolled(stored)
    axes = space.rotation_matrices(space.middle(stored[:-1], stored[1:]))
    for place, turn in coordinates.free:
        moved = stored[:, place : place + 3].diff(dim=0)
        steps = torch.einsum("tji,tj->ti", axes[:, turn], moved)
        found[1:, place : place + 3] = found[:1, place : place + 3] + steps.cumsum(0)
    return found.numpy()


def moving(motions: Sequence[Motion]) -> np.ndarray:
    """Return which coordinates (n,) move in any recording, by more than rounding errors."""
    if not motions:
        return np.zeros(0, dtype=bool)
    ranges = np.max([np.ptp(q, axis=0) for q, _ in motions], axis=0)
    sizes = np.max([np.abs(q).max(axis=0) for q, _ in motions], axis=0)
    return np.asarray(ranges > ROUNDING * sizes)


def held_still(motions: Sequence[Motion]) -> list[Motion]:
    """Return motions without the rounding errors of what never moves, which are accelerations."""
    moves = moving(motions)
    return [(np.where(moves, q, q[0]), u) for q, u in motions]


def weak_rows(
    q: np.ndarray,
    u: np.ndarray,
    h: float,
    terms: Terms,
    path: np.ndarray | None = None,
) -> np.ndarray:
    """Return weak accelerations and weak terms of ``(q, v, u)`` side by side.

    Row ``i`` is that of node ``i + HALF + 1``; nodes nearer to the ends have none. ``path`` are the
    ``quasi_coordinates`` of ``q``; ``None``: ``q`` itself.
    """
    s = np.arange(-HALF, HALF + 1) / (HALF + 1)
    bump = (1 - s**2) ** 3
    path = q if path is None else path
    v, middle = (path[2:] - path[:-2]) / (2 * h), q[1:-1]
    both = np.concatenate([np.diff(path, 2, axis=0) / h**2, terms(middle, v, u[1:-1])], axis=1)
    return np.lib.stride_tricks.sliding_window_view(both, len(bump), axis=0) @ bump


def weak_table(
    motions: Sequence[Motion], paths: Sequence[Motion], h: float, terms: Terms
) -> np.ndarray:
    """Return ``weak_rows`` of motions with ``quasi_coordinates``, without most of their overlap."""
    rows = []
    for (q, u), (path, _) in zip(motions, held_still(paths), strict=True):
        if len(q) >= SHORTEST:
            places = path if path.shape == q.shape else q  # of rotations, their entries
            rows.append(weak_rows(places, u, h, terms, path)[::HALF])
    return np.concatenate(rows) if rows else np.empty((0, 1))


def weak_regression(
    motions: Sequence[Motion],
    coordinates: Coordinates,
    h: float,
    terms: Terms,
) -> tuple[float, np.ndarray] | None:
    """Regress weak accelerations on weak terms of ``(q, v, u)``, at the best ridge.

    Returns:
        The mean square of leave-one-out errors over the mean square, of the coordinates that move,
        and the coefficients (k, n), 0 for the others and of terms that are always zero; ``None``
        with fewer than 20 rows or without motion.
    """
    paths = [(quasi_coordinates(q, coordinates), u) for q, u in motions]
    moves = moving(paths)
    table = weak_table(motions, paths, h, terms)
    n = len(moves)
    if len(table) < 20 or not (np.isfinite(table).all() and moves.any()):
        return None
    size = np.sqrt(np.mean(table**2, axis=0) + 1e-300)
    size[:n] = _shared(size[:n], coordinates)
    target, given = np.split(table / size, [n], 1)
    error, found = _left_out(given, target[:, moves])
    coefficients = np.zeros((given.shape[1], n))
    coefficients[:, moves] = found
    coefficients[~given.any(axis=0)] = 0.0  # of terms that are always zero: rounding errors
    return error, coefficients * size[:n] / size[n:, None]


def _shared(sizes: np.ndarray, coordinates: Coordinates) -> np.ndarray:
    """Return sizes (n,), equal for the components of a vector in body axes."""
    found, flat = sizes.copy(), len(coordinates.flat)
    starts = [*range(flat, coordinates.n, 3), *(place for place, _ in coordinates.free)]
    for start in starts:
        found[start : start + 3] = np.sqrt(np.mean(sizes[start : start + 3] ** 2))
    return found


def _left_out(x: np.ndarray, y: np.ndarray) -> tuple[float, np.ndarray]:
    """Regress ``y`` on ``x`` at the best ridge: leave-one-out mean square, and coefficients."""
    left, scales, right = np.linalg.svd(x, full_matrices=False)
    found = []
    for ridge in 10.0 ** np.arange(-8, 3):
        share = scales**2 / (scales**2 + ridge * len(x))
        shrunk = left * share
        weight = np.maximum(1 - np.sum(shrunk * left, axis=1), 1e-9)
        error = (y - shrunk @ (left.T @ y)) / weight[:, None]
        found.append((float(np.mean(error**2)), share / np.maximum(scales, 1e-300)))
    least, inverse = min(found, key=lambda one: one[0])
    return least, right.T @ (inverse[:, None] * (left.T @ y))


def unexplained(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return what a regression on ``x`` leaves of ``y``."""
    terms = x / (np.sqrt(np.mean(x**2, axis=0)) + 1e-300)
    left: np.ndarray = y - terms @ np.linalg.lstsq(terms, y, rcond=1e-9)[0]
    return left


def acceleration_terms(
    q: np.ndarray, v: np.ndarray, u: np.ndarray, coordinates: Coordinates
) -> np.ndarray:
    """Return terms of accelerations: places, viscous and dry friction, and products.

    Forces and products of velocities are multiplied by all places. With rotations, all velocities
    and forces are in body axes. There are the places of lengths, the entries of rotations, to which
    gravity is proportional, linear and quadratic drag, products of velocities, and forces. For one
    rigid body these are all terms.
    """
    products = [a * b for a, b in itertools.combinations_with_replacement(v.T, 2)]
    if coordinates.rotations:
        return np.stack([np.ones(len(q)), *q.T, *v.T, *(v * np.abs(v)).T, *products, *u.T], axis=1)
    places = place_terms(q, coordinates)
    friction = [*v.T, *signs_of(v).T]
    forces = [*products, *u.T]
    return np.stack([*places, *friction, *(f * p for f in forces for p in places)], axis=1)


def place_terms(q: np.ndarray, coordinates: Coordinates) -> list[np.ndarray]:
    """Return terms of configurations: one, coordinates, and their products in pairs."""
    each = [
        [np.cos(x), np.sin(x)] if angular else [x]
        for x, angular in zip(q.T, coordinates.angular, strict=True)
    ]
    pairs = [a * b for x, y in itertools.combinations(each, 2) for a in x for b in y]
    return [np.ones(len(q)), *itertools.chain(*each), *pairs]


def signs_of(v: np.ndarray) -> np.ndarray:
    """Return the signs of velocities (k, n), -1 or 1; at rest, numbers in between."""
    pace = np.sqrt(np.mean(v**2, axis=0)) + 1e-300
    return np.tanh(10 * v / pace)
