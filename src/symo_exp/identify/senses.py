"""Angles of links in a plane that count in the other direction than the angle of the first link."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence

import numpy as np

from symo_exp.data.paths import few
from symo_exp.data.weak import HALF, SHORTEST, Motion, signs_of, unexplained, weak_rows
from symo_exp.mechanics.types import Coordinates

MOST = 3
"""Angles of machines that are searched for as links in a plane."""
RIGHT, CLEARLY = 0.1, 0.2
"""Share of the power of forces that links with the right directions leave unexplained at most, and
that share over those of all other directions."""
ENOUGH = 3
"""Rows of a regression for each parameter, at least."""


def told_reversed(
    motions: Sequence[Motion], coordinates: Coordinates, h: float, matrix: np.ndarray | None
) -> Iterator[str]:
    """Yield a line on angles that count in the other direction than the first one, if there are.

    The arguments are those of ``reversed_angles``.
    """
    found = reversed_angles(motions, coordinates, h, matrix)
    columns = [f"q_{name}" for name in found]
    counts, them = ("counts", "it") if len(found) == 1 else ("count", "them")
    if found:
        yield (
            f"angles: {few(columns)} {counts} in the other direction than the first angle, as the "
            "motions show; rigid links, and thus masses and a model file, need one direction: "
            f"negate {them} in the file, and velocities likewise"
        )


def reversed_angles(
    motions: Sequence[Motion], coordinates: Coordinates, h: float, matrix: np.ndarray | None
) -> list[str]:
    """Return the angles that count in the other direction than the first; none if it is not clear.

    The equations of motion of rigid links in a plane are linear in their parameters. Directions of
    links are the angles or, if these are relative, their sums, so that the equations explain the
    forces of the inputs, or those of the inertia of the first coordinate if there are none, only
    with the right signs.

    Args:
        motions: Configurations and inputs at nodes.
        coordinates: Those of the machine.
        h: Distance of the nodes [s].
        matrix: That of the inputs (n, m); ``None``: no inputs.
    """
    angular = np.array(coordinates.angular, dtype=bool)
    angles = np.flatnonzero(angular)
    if coordinates.rotations or not 1 < len(angles) <= MOST:
        return []
    left: dict[tuple[bool, tuple[float, ...]], float] = {}
    for relative in (False, True):
        for signs in itertools.product((1.0, -1.0), repeat=len(angles) - 1):
            turn = np.eye(len(angular))
            if relative:  # each counts from the one before
                turn[np.ix_(angles, angles)] = np.tri(len(angles))
            turn[:, angles[1:]] *= signs
            left[relative, signs] = _unexplained(motions, turn, angular, h, matrix)
    best, *others = sorted(left, key=left.__getitem__)
    if left[best] > min(RIGHT, CLEARLY * min(left[x] for x in others)):
        return []
    return [coordinates.names[i] for i, s in zip(angles[1:], best[1], strict=True) if s < 0.0]


def _unexplained(
    motions: Sequence[Motion],
    turn: np.ndarray,
    angular: np.ndarray,
    h: float,
    matrix: np.ndarray | None,
) -> float:
    """Return the share of the power of forces that links in the directions ``turn q`` leave."""
    n = len(turn)

    def forces(q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
        acting = [] if matrix is None else [u @ matrix.T]
        every = [*acting, *_inertial(q, v, turn, angular, h), *_others(q, v, turn, angular, h)]
        return np.concatenate(every, axis=1)

    rows = [weak_rows(q, u, h, forces)[1:-1:HALF, n:] for q, u in motions if len(q) > SHORTEST]
    if not rows or not np.isfinite(table := np.concatenate(rows)).all():
        return np.inf
    y, *x = table.reshape(len(table), -1, n).transpose(1, 0, 2).reshape(-1, len(table) * n)
    if len(y) < ENOUGH * len(x) or not y.any():
        return np.inf
    return float(np.sum(unexplained(np.stack(x, axis=1), y) ** 2) / np.sum(y**2))


def _inertial(
    q: np.ndarray, v: np.ndarray, turn: np.ndarray, angular: np.ndarray, h: float
) -> Iterator[np.ndarray]:
    """Yield ``d/dt ∂T/∂v − ∂T/∂q`` for each term of the kinetic energy.

    With directions ``s = turn q``, a term is ``ṡ_k ṡ_l cos(s_k − s_l + phase)``, and one half of it
    if ``k = l``. The directions of slides are zero.
    """
    s, rate = (q @ turn.T) * angular, v @ turn.T
    for k, j in itertools.combinations_with_replacement(range(len(turn)), 2):
        for phase in (0.0, np.pi / 2) if k != j else (0.0,):
            apart = s[:, k] - s[:, j] + phase
            momentum, slope = np.zeros_like(rate), np.zeros_like(rate)
            momentum[:, k] = np.cos(apart) * rate[:, j]
            momentum[:, j] = np.cos(apart) * rate[:, k]
            along = -np.sin(apart) * rate[:, k] * rate[:, j]
            slope[:, k] += angular[k] * along
            slope[:, j] -= angular[j] * along
            yield (np.gradient(momentum, h, axis=0) - slope) @ turn


def _others(
    q: np.ndarray, v: np.ndarray, turn: np.ndarray, angular: np.ndarray, h: float
) -> Iterator[np.ndarray]:
    """Yield forces of gravity, springs, friction and rotors, each of one coordinate."""
    s, unit = q @ turn.T, np.eye(len(turn))
    for k in np.flatnonzero(angular):
        yield from (f(s[:, [k]]) * turn[k] for f in (np.sin, np.cos))
    for own in (np.ones_like(v), v, signs_of(v)):
        yield from (own[:, [i]] * unit[i] for i in range(len(turn)))
    yield from (q[:, [j]] * row for row in unit for j in range(len(turn)))
    rates = np.gradient(v, h, axis=0)  # that of the first is its inertia
    yield from (rates[:, [i]] * unit[i] for i in range(1, len(turn)))
