"""Explained accelerations: what regressions show of the equations of motion."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from itertools import compress

import numpy as np

from symo_exp.data.weak import (
    Motion,
    acceleration_terms,
    moving,
    place_terms,
    signs_of,
    unexplained,
    weak_regression,
    weak_table,
)
from symo_exp.mechanics.types import Coordinates

SPRUNG, SPRUNG_TOO = 0.5, 0.1
"""Shares of what gravity leaves unexplained that springs, alone or beside gravity, leave at most
where they are likely."""
LINEAR = 0.1
"""Share of the accelerations' power that linear equations of motion leave unexplained, at most."""


def explained_power(
    motions: Sequence[Motion], coordinates: Coordinates, h: float, *, driven: bool
) -> float | None:
    """Return the share of the power of weak accelerations that a ridge regression predicts.

    Each row is predicted from the others; coordinates that never move are not. ``None`` with fewer
    than 20 rows or without motion.
    """
    chosen = motions if driven else [(q, u[:, :0]) for q, u in motions]
    found = weak_regression(
        chosen, coordinates, h, partial(acceleration_terms, coordinates=coordinates)
    )
    return None if found is None else max(0.0, 1.0 - found[0])


def explained_in_degrees(
    motions: Sequence[Motion], coordinates: Coordinates, h: float
) -> float | None:
    """Return ``explained_power`` if the numbers of the angles are degrees.

    ``None`` without angles, and with rotations.
    """
    if coordinates.rotations or not any(coordinates.angular):
        return None
    scale = np.where(coordinates.angular, np.pi / 180, 1.0)
    return explained_power([(q * scale, u) for q, u in motions], coordinates, h, driven=True)


def input_gains(motions: Sequence[Motion], coordinates: Coordinates, h: float) -> np.ndarray | None:
    """Return the weak accelerations (n, m) that a unit of each input adds, a mean over places.

    They are 0 for inputs that never act, as for coordinates that never move.
    ``None`` as for ``explained_power``.
    """

    def terms(q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
        return np.concatenate([acceleration_terms(q, v, u[:, :0], coordinates), u], axis=1)

    found = weak_regression(motions, coordinates, h, terms)
    return None if found is None else found[1][-motions[0][1].shape[1] :].T


def spring_slopes(
    motions: Sequence[Motion], coordinates: Coordinates, h: float
) -> np.ndarray | None:
    """Return the slopes (n, n) of accelerations in ``q`` if springs explain them, else ``None``.

    The power that springs, gravity on each coordinate alone, and both together leave unexplained is
    compared. ``None`` also with rotations and as for ``explained_power``.
    """
    if coordinates.rotations:
        return None
    n, angular = coordinates.n, np.array(coordinates.angular)

    def gravity(q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
        turned = q[:, angular]
        return np.concatenate([np.cos(turned), np.sin(turned), _forces(q, v, u)], axis=1)

    def both(q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
        return np.concatenate([q, gravity(q, v, u)], axis=1)

    hanging = weak_regression(motions, coordinates, h, gravity)
    for terms, most in (_linear, SPRUNG), (both, SPRUNG_TOO):
        sprung = weak_regression(motions, coordinates, h, terms)
        if sprung is not None and hanging is not None and sprung[0] <= most * hanging[0]:
            moves = moving(motions)  # a place that is always the same shows no slope
            return np.where(np.outer(moves, moves), sprung[1][:n].T, 0.0)
    return None


def growth_rate(motions: Sequence[Motion], coordinates: Coordinates, h: float) -> float | None:
    """Return the rate [1/s] at which deviations grow by the best linear equations of motion.

    It is the largest real part of their eigenvalues. ``None`` if linear equations do not explain
    the accelerations, with rotations, and as for ``explained_power``.
    """
    if coordinates.rotations:
        return None
    n = coordinates.n
    found = weak_regression(motions, coordinates, h, _linear)
    if found is None or found[0] > LINEAR:
        return None
    zero, one = np.zeros((n, n)), np.eye(n)
    slopes = np.block([[zero, one], [found[1][:n].T, found[1][n + 1 : 2 * n + 1].T]])
    return float(np.linalg.eigvals(slopes).real.max())


def contradiction(
    motions: Sequence[Motion], coordinates: Coordinates, h: float, matrix: np.ndarray
) -> float | None:
    """Return by how much motions contradict the matrix ``B`` (n, m) of inputs.

    By ``H q̈ = B u + …``, accelerations due to forces ``B u`` are ``H⁻¹ B u``, and ``H⁻¹`` is
    symmetric at every place. The result is the power of accelerations that a regression with
    symmetric coefficients leaves unexplained over that of one with any coefficients, each over its
    degrees of freedom: about 1 if ``B`` may be right. ``None`` with too few rows, with rotations,
    or if fewer than two coordinates that move are driven.
    """
    if coordinates.rotations or not motions:
        return None
    moves = moving(motions)  # what holds the others acts on nothing else
    motions, matrix = [(q[:, moves], u) for q, u in motions], matrix[moves]
    names, angular = coordinates.names, coordinates.angular
    coordinates = Coordinates(tuple(compress(names, moves)), tuple(compress(angular, moves)))
    n, driven = coordinates.n, np.flatnonzero(matrix.any(axis=1))
    if len(driven) < 2:
        return None

    def terms(q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
        places, forces = place_terms(q, coordinates), (u @ matrix.T)[:, driven].T
        acting = np.stack([f * p for f in forces for p in places], axis=1)
        return np.concatenate([acting, acceleration_terms(q, v, u[:, :0], coordinates)], axis=1)

    table = weak_table(motions, motions, h, terms)
    if len(table) <= 2 * table.shape[1] or not np.isfinite(table).all():
        return None
    count = len(place_terms(motions[0][0][:1], coordinates))
    target, acting, others = np.split(table, [n, n + count * len(driven)], axis=1)
    both = np.concatenate([target, acting], axis=1)
    target, acting = np.split(unexplained(others, both), [n], axis=1)
    usual = np.sqrt(np.mean(unexplained(acting, target) ** 2, axis=0)) + 1e-300
    acting = acting.reshape(len(table), len(driven), count)
    pairs = sorted({(min(i, j), max(i, j)) for i in range(n) for j in driven.tolist()})
    # rows of all coordinates, and columns for each pair of them, whose coefficients are the same
    found = np.zeros((n, len(table), len(pairs), count))
    for k, pair in enumerate(pairs):
        for one, other in {pair, pair[::-1]}:
            found[one, :, k] += acting[:, driven == other].sum(axis=1) / usual[one]
    x, y = found.reshape(n * len(table), -1), (target / usual).T.reshape(-1, 1)
    symmetric = float(np.sum(unexplained(x, y) ** 2))
    free = n * (len(table) - acting[0].size - others.shape[1])
    return symmetric / (n * len(table)) * free / (n * (len(table) - others.shape[1]) - x.shape[1])


def _forces(q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Return terms that do not depend on places: a constant force, friction and inputs."""
    return np.concatenate([np.ones((len(q), 1)), v, signs_of(v), u], axis=1)


def _linear(q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Return the terms of linear equations of motion, and dry friction."""
    return np.concatenate([q, _forces(q, v, u)], axis=1)
