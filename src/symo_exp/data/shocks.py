"""Shocks: stretches in which something that is not recorded moves a machine."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from symo_exp.data.weak import (
    HALF,
    SHORTEST,
    Motion,
    acceleration_terms,
    held_still,
    place_terms,
    signs_of,
    weak_rows,
)
from symo_exp.mechanics.types import Coordinates

SHOCK, STRANGE = 15.0, 4.0
"""Errors of accelerations over their usual size: from the first one something else moves the
machine, from the second neighbours belong to it."""
RARE = 0.05
"""Share of the motion that shocks last at most: more are how the machine is."""
MOVES = 0.1
"""Velocity from which a coordinate moves, over the root mean square of its velocities."""
NEAR, KNOWN = 0.8, 3
"""Distance up to which states are near, in root mean squares, and how many have to be."""
APART = 5 * HALF
"""Nodes from which two of one motion are different visits of a state."""
ITERATIONS = 10
"""Of the regression that leaves shocks out."""
ROWS = 2 * HALF
"""Rows for each term, at least; those of neighbouring nodes overlap."""
LARGEST = 2e7
"""Numbers in the rows, at most."""
FLOOR = 1e-9
"""Usual error at least, over the root mean square of accelerations."""


def shocks(
    motions: Sequence[Motion], coordinates: Coordinates, h: float
) -> list[list[tuple[int, int]]]:
    """Return when something that is not recorded moves the machine: a hand, a cable, a stop.

    Weak accelerations are regressed, robustly, on the terms of ``explained_power``. In a shock the
    error is many times the usual one and larger than accelerations usually are, although the
    machine passed through nearby states, with nearby inputs, at other times without such an error.
    Dry friction of a coordinate at rest is any force up to that in motion; the error is what the
    most suitable one leaves.

    Args:
        motions: Configurations (T, n) and inputs (T, m) of each recording, at the nodes.
        coordinates: Those of the system.
        h: Distance of the nodes [s].

    Returns:
        For each motion the first and the last node of each shock. There are none with too few nodes
        for the terms or too many numbers, or if errors are large so often that the terms do not
        suit the machine.
    """
    nothing: list[list[tuple[int, int]]] = [[] for _ in motions]
    still = held_still(motions)
    long = [k for k, (q, _) in enumerate(still) if len(q) >= SHORTEST]
    used = [still[k] for k in long]
    rows = _rows(used, coordinates, h)
    if not rows:
        return nothing
    n = coordinates.n
    table, rests, velocity = np.split(np.concatenate(rows), [-2 * n, -n], axis=1)
    velocity = np.abs(velocity)
    moving = (velocity > MOVES * np.sqrt(np.mean(velocity**2, axis=0))).any(axis=1)
    if not moving.any():
        return nothing
    viscous = len(place_terms(used[0][0][:1], coordinates))
    dry = np.arange(viscous + n, viscous + 2 * n)  # terms of dry friction
    left, usual = _errors(table, rests, moving, dry)
    strange = np.any(left > STRANGE * usual, axis=1)
    hit = np.any((left > SHOCK * usual) & (left > 1.0), axis=1)
    states = _states(used, coordinates, h)
    of = np.repeat(long, [len(each) for each in rows])
    stretches = [list(each) for each in nothing]
    for k in long:
        here = np.flatnonzero(of == k)
        stretches[k] = [
            (first + HALF + 1, last + HALF + 1)
            for first, last in _runs(strange[here], hit[here])
            if _known(states, here[first], here[last], strange, of)
        ]
    lost = sum(last - first + 1 for each in stretches for first, last in each)
    return stretches if lost <= RARE * moving.sum() else nothing


def _rows(motions: Sequence[Motion], coordinates: Coordinates, h: float) -> list[np.ndarray]:
    """Return weak accelerations, terms, rests and velocities of each motion side by side.

    The list is empty with too few nodes, too many numbers, or numbers that are not finite.
    """
    if not motions:
        return []

    def columns(q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
        rests = 1 - np.abs(signs_of(v))
        return np.concatenate([acceleration_terms(q, v, u, coordinates), rests, v], axis=1)

    q, u = motions[0]
    width = columns(q[:1], q[:1], u[:1]).shape[1]
    nodes = sum(len(q) for q, _ in motions)
    if nodes < ROWS * width or nodes * width > LARGEST:
        return []
    rows = [weak_rows(q, u, h, columns) for q, u in motions]
    return rows if all(np.isfinite(each).all() for each in rows) else []


def _errors(
    table: np.ndarray, rests: np.ndarray, moving: np.ndarray, dry: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return errors (k, n) of accelerations, and usual ones (n,), over the size of accelerations.

    Args:
        table: Weak accelerations and their terms, a row for each node.
        rests: By how much each coordinate is at rest (k, n), from 0 to 1.
        moving: Rows that the regression is made from (k,).
        dry: Index of each coordinate's term of dry friction, which may be smaller at rest.
    """
    n = rests.shape[1]
    size = np.sqrt(np.mean(table[moving] ** 2, axis=0) + 1e-300)
    y, x = np.split(table / size, [n], axis=1)
    found = _robust(x[moving], y[moving])
    left = np.abs(y - x @ found)
    usual = _usual(left[moving])
    return left - rests / size[n + dry] @ np.abs(found[dry]), usual


def _robust(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Regress ``y`` on ``x`` with weights that fall with the error, to zero."""
    weight = np.ones((len(x), 1))
    ridge = 1e-6 * len(x) * np.eye(x.shape[1])
    for _ in range(ITERATIONS):
        weighted = weight * x
        found = np.linalg.solve(weighted.T @ x + ridge, weighted.T @ y)
        left = np.abs(y - x @ found)
        strange = (left / _usual(left)).max(axis=1, keepdims=True) / STRANGE
        weight = np.where(strange < 1, 1.0, (strange < 3) / np.maximum(strange, 1.0))
    return found


def _usual(left: np.ndarray) -> np.ndarray:
    """Return the standard deviation of each column's errors, as their median says."""
    return np.maximum(np.median(left, axis=0) / 0.6745, FLOOR)


def _runs(strange: np.ndarray, hit: np.ndarray) -> list[tuple[int, int]]:
    """Return the first and last row of the runs of strange rows in which there is a hit."""
    edges = np.flatnonzero(np.diff(strange, prepend=False, append=False)).reshape(-1, 2)
    return [(int(a), int(b) - 1) for a, b in edges if hit[a:b].any()]


def _states(motions: Sequence[Motion], coordinates: Coordinates, h: float) -> np.ndarray:
    """Return configurations, velocities and inputs of the rows, of the size 1 each."""
    angular = np.array(coordinates.angular)
    found = []
    for q, u in motions:
        v = (q[2:] - q[:-2]) / (2 * h)
        place = np.concatenate([np.where(angular, np.cos(q), q), np.sin(q[:, angular])], axis=1)
        here = np.concatenate([place[1:-1], v, u[1:-1]], axis=1)
        found.append(here[HALF:-HALF])
    table = np.concatenate(found)
    return np.asarray(table / np.sqrt(np.mean(table**2, axis=0) + 1e-300))


def _known(states: np.ndarray, first: int, last: int, strange: np.ndarray, of: np.ndarray) -> bool:
    """Return whether states from ``first`` to ``last`` occurred elsewhere without strange errors.

    ``of`` is the motion of each row.
    """
    at = np.arange(len(states))
    for i in np.linspace(first, last, 5).round().astype(int)[1:-1]:
        same = (of == of[i]) & (np.abs(at - i) <= APART)
        near = np.linalg.norm(states - states[i], axis=1) < NEAR
        if (near & ~same & ~strange).sum() < KNOWN:
            return False
    return True
