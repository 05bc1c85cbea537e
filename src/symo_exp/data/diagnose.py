"""Diagnosis of recordings before training: inputs, noise, time step and scale."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from math import comb

import numpy as np
import torch

from symo_exp.mechanics.types import Coordinates

HALF = 5
"""Nodes on either side of the middle of a test function."""
POOR, NOISY, COARSE = 0.5, 0.5, 0.7
"""Share of explained power below which no model can succeed; noise over curvature, and change of an
angle in a step [rad], above which the time step does not suit."""
SUSPECT = 0.3
"""Share of the unexplained power below which angles are suspected to be in degrees."""
SPRUNG, SPRUNG_TOO = 0.5, 0.1
"""Shares of what gravity leaves unexplained that springs, alone or beside gravity, leave at most
where they are likely."""
LINEAR = 0.1
"""Share of the accelerations' power that linear equations of motion leave unexplained, at most."""
HELP = 0.1
"""Share of the unexplained power that meaningful inputs explain at least."""
ROUNDING = 1e-10
"""Range of a coordinate relative to its size up to which it is still."""
SHORTEST = 2 * HALF + 3
"""Nodes of a motion that a test function fits into, at least."""


@dataclass(frozen=True)
class Diagnosis:
    """Properties of recordings that are known before training.

    Attributes:
        coordinates: Those of the system.
        time_step: Distance of the nodes [s].
        driven: Whether any input is not zero.
        explained: Share of the accelerations' power that configurations, velocities, friction and
            inputs explain, ``None`` with too few nodes.
        free: The same without the inputs.
        degrees: The same, with the inputs, if the numbers of the angles are degrees; ``None``
            without angles.
        sprung: Whether springs explain accelerations that gravity does not.
        noise: Standard deviation of the noise of each coordinate's samples [rad, m].
        encoder: Step of each coordinate's encoder [rad, m], 0 where none is seen.
        turn: Largest change of each coordinate in a time step [rad, m].
        blur: Noise of the nodes over curvature, the root mean square of ``h² q̈``, the largest.
    """

    coordinates: Coordinates
    time_step: float
    driven: bool
    explained: float | None
    free: float | None
    degrees: float | None
    sprung: bool
    noise: np.ndarray
    encoder: np.ndarray
    turn: np.ndarray
    blur: float

    @property
    def fixes_scale(self) -> bool:
        """True if inputs determine the inertia, not only its ratio to the forces."""
        if not self.driven or self.explained is None or self.free is None:
            return self.driven
        return self.explained - self.free >= HELP * (1 - self.free)

    def lines(self) -> list[str]:
        """Return lines for the log: inputs, units, noise, time step, scale and springs."""
        springs = "springs: they explain accelerations that gravity does not (springs=linear)"
        found = [self._inputs(), *self._unit(), self._noise(), self._step(), self._scale()]
        return [*found, springs] if self.sprung else found

    def _inputs(self) -> str:
        if self.explained is None:
            return "inputs: too little motion to tell what they explain"
        poor = self.explained < POOR
        hint = "; something else moves the machine, or a sensor fails" if poor else ""
        share = f"{100 * self.explained:.3g} % of the accelerations' power"
        if self.driven:
            without = 100 * (self.free or 0.0)
            return f"inputs: {share} is explained with them, {without:.3g} % without{hint}"
        if poor:
            return f"inputs: none, and configurations and velocities explain only {share}{hint}"
        return "inputs: none; accelerations follow from configurations and velocities"

    def _unit(self) -> list[str]:
        if self.explained is None or self.degrees is None:
            return []
        if 1 - self.degrees > SUSPECT * (1 - self.explained):
            return []
        return [
            f"angles: {100 * self.degrees:.3g} % is explained if they are in degrees, "
            f"{100 * self.explained:.3g} % in radians; data.degrees=true converts"
        ]

    def _noise(self) -> str:
        each = zip(self.coordinates.names, self.noise, self.encoder, strict=True)
        return "noise: " + ", ".join(
            f"{name} {noise:.1e}" + (f" (encoder step {step:.2g})" if step else "")
            for name, noise, step in each
        )

    def _step(self) -> str:
        h, names = f"{self.time_step:g}", self.coordinates.names
        moves = ", ".join(f"{n} at most {x:.2g}" for n, x in zip(names, self.turn, strict=True))
        angles = self.turn[np.array(self.coordinates.turning)]
        verdict = "suits"
        if angles.size and angles.max() > COARSE:
            verdict = "is coarse: a smaller one sees more, or data.leave_out skips what is fast"
        elif self.blur > NOISY:
            verdict = "is fine: noise hides the curvature, a larger one shows it"
        return (
            f"time step: {h} s {verdict} ({moves} a step, noise {self.blur:.1g} of the curvature)"
        )

    def _scale(self) -> str:
        if not self.driven:
            return "scale: no inputs, so the Lagrangian and friction are known up to a factor"
        if self.explained is None:
            return "scale: too little motion to tell whether the inputs determine the inertia"
        if not self.fixes_scale:
            return "scale: the inputs explain next to nothing, so the inertia's scale is doubtful"
        return "scale: the inputs determine the scale of the inertia"


Motion = tuple[np.ndarray, np.ndarray]
"""Configurations (T, N) and inputs (T, m) at nodes."""
Terms = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
"""Maps configurations, velocities and inputs at nodes to the columns of a regression."""


def diagnose(
    motions: Sequence[Motion],
    raw: Sequence[np.ndarray],
    coordinates: Coordinates,
    time_step: float,
    samples: float = 1.0,
) -> Diagnosis:
    """Return the diagnosis of recordings.

    Args:
        motions: Configurations (T, N) and inputs (T, m) of each recording, at the nodes.
        raw: Its configurations (T', N) as sampled.
        coordinates: Those of the system.
        time_step: Distance of the nodes [s].
        samples: Number of samples in a time step.
    """
    paths = [quasi_coordinates(q, coordinates) for q, _ in motions]
    sampled = [quasi_coordinates(q, coordinates) for q in raw]
    second = [np.diff(path, 2, axis=0) for path in paths]
    noise = np.array([noise_of(columns) for columns in _columns(sampled)])
    blur = blur_of(noise, samples)
    of_noise = 6 * blur**2  # the power of its second differences
    power = np.mean(np.concatenate(second) ** 2, axis=0) - of_noise
    curvature = np.sqrt(np.maximum(power, 0.01 * blur**2))
    springs = spring_slopes(motions, coordinates, time_step)
    return Diagnosis(
        coordinates,
        time_step,
        driven=any(bool(u.any()) for _, u in motions),
        explained=explained_power(motions, coordinates, time_step, driven=True),
        free=explained_power(motions, coordinates, time_step, driven=False),
        degrees=explained_in_degrees(motions, coordinates, time_step),
        sprung=springs is not None,
        noise=noise,
        encoder=np.array([encoder_of(columns) for columns in _columns(sampled)]),
        turn=np.max([np.abs(np.diff(path, axis=0)).max(0) for path in paths], axis=0),
        blur=float(np.max(blur / np.maximum(curvature, np.finfo(float).tiny))),
    )


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


def blur_of(noise: np.ndarray, samples: float) -> np.ndarray:
    """Return the noise of nodes, each a local cubic fitted to so many samples.

    A cubic fitted to N equal steps has 9/4N of their variance in its middle.
    """
    return noise * np.sqrt(min(1.0, 2.25 / samples))


def _columns(raw: Sequence[np.ndarray]) -> list[list[np.ndarray]]:
    return [[q[:, i] for q in raw] for i in range(raw[0].shape[1])]


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


def encoder_of(columns: Sequence[np.ndarray]) -> float:
    """Return the step that all increments are multiples of, 0 if there is none."""
    rises = np.concatenate([np.abs(np.diff(x)) for x in columns])
    rises = rises[rises > 1e-9]
    if not len(rises):
        return 0.0
    step = float(np.quantile(rises, 0.01))
    ratios = rises[rises < 20 * step] / step
    whole = np.abs(ratios - ratios.round()) < 0.02
    return step if len(ratios) >= 20 and whole.mean() > 0.98 else 0.0


def explained_power(
    motions: Sequence[Motion], coordinates: Coordinates, h: float, *, driven: bool
) -> float | None:
    """Return the share of the power of weak accelerations that a ridge regression predicts.

    Each row is predicted from the others; coordinates that never move are not. ``None`` with fewer
    than 20 rows or without motion.
    """
    chosen = motions if driven else [(q, u[:, :0]) for q, u in motions]
    found = _regression(
        chosen, coordinates, h, partial(acceleration_terms, coordinates=coordinates)
    )
    return None if found is None else max(0.0, 1.0 - found[0])


def input_gains(motions: Sequence[Motion], coordinates: Coordinates, h: float) -> np.ndarray | None:
    """Return the weak accelerations (n, m) that a unit of each input adds, a mean over places.

    They are 0 for inputs that never act, as for coordinates that never move.
    ``None`` as for ``explained_power``.
    """

    def terms(q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
        return np.concatenate([acceleration_terms(q, v, u[:, :0], coordinates), u], axis=1)

    found = _regression(motions, coordinates, h, terms)
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

    hanging = _regression(motions, coordinates, h, gravity)
    for terms, most in (_linear, SPRUNG), (both, SPRUNG_TOO):
        sprung = _regression(motions, coordinates, h, terms)
        if sprung is not None and hanging is not None and sprung[0] <= most * hanging[0]:
            moves = moving(motions)  # a place that is always the same shows no slope
            return np.where(np.outer(moves, moves), sprung[1][:n].T, 0.0)
    return None


def contradiction(
    motions: Sequence[Motion], coordinates: Coordinates, h: float, matrix: np.ndarray
) -> float | None:
    """Return by how much motions contradict the matrix ``B`` (n, m) of inputs.

    By ``H q̈ = B u + …``, accelerations due to forces ``B u`` are ``H⁻¹ B u``, and ``H⁻¹`` is
    symmetric at every place. The result is the power of accelerations that a regression with
    symmetric coefficients leaves unexplained over that of one with any coefficients, each over its
    degrees of freedom: about 1 if ``B`` may be right. ``None`` with too few rows, with rotations,
    or if fewer than two coordinates are driven.
    """
    n, driven = coordinates.n, np.flatnonzero(matrix.any(axis=1))
    if coordinates.rotations or len(driven) < 2:
        return None

    def terms(q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
        places, forces = place_terms(q, coordinates), (u @ matrix.T)[:, driven].T
        acting = np.stack([f * p for f in forces for p in places], axis=1)
        return np.concatenate([acting, acceleration_terms(q, v, u[:, :0], coordinates)], axis=1)

    table = _table(motions, motions, h, terms)
    if len(table) <= 2 * table.shape[1] or not np.isfinite(table).all():
        return None
    count = len(place_terms(motions[0][0][:1], coordinates))
    target, acting, others = np.split(table, [n, n + count * len(driven)], axis=1)
    both = np.concatenate([target, acting], axis=1)
    target, acting = np.split(both - _fit(others, both), [n], axis=1)
    left = target - _fit(acting, target)
    usual = np.sqrt(np.mean(left**2, axis=0)) + 1e-300
    acting = acting.reshape(len(table), len(driven), count)
    pairs = sorted({(min(i, j), max(i, j)) for i in range(n) for j in driven.tolist()})
    # rows of all coordinates, and columns for each pair of them, whose coefficients are the same
    found = np.zeros((n, len(table), len(pairs), count))
    for k, pair in enumerate(pairs):
        for one, other in {pair, pair[::-1]}:
            found[one, :, k] += acting[:, driven == other].sum(axis=1) / usual[one]
    x, y = found.reshape(n * len(table), -1), (target / usual).T.reshape(-1, 1)
    symmetric = float(np.sum((y - _fit(x, y)) ** 2))
    free = n * (len(table) - acting[0].size - others.shape[1])
    return symmetric / (n * len(table)) * free / (n * (len(table) - others.shape[1]) - x.shape[1])


def _fit(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return what a regression on ``x`` explains of ``y``."""
    size = np.sqrt(np.mean(x**2, axis=0)) + 1e-300
    found: np.ndarray = x / size @ np.linalg.lstsq(x / size, y, rcond=1e-9)[0]
    return found


def growth_rate(motions: Sequence[Motion], coordinates: Coordinates, h: float) -> float | None:
    """Return the rate [1/s] at which deviations grow by the best linear equations of motion.

    It is the largest real part of their eigenvalues. ``None`` if linear equations do not explain
    the accelerations, with rotations, and as for ``explained_power``.
    """
    if coordinates.rotations:
        return None
    n = coordinates.n
    found = _regression(motions, coordinates, h, _linear)
    if found is None or found[0] > LINEAR:
        return None
    zero, one = np.zeros((n, n)), np.eye(n)
    slopes = np.block([[zero, one], [found[1][:n].T, found[1][n + 1 : 2 * n + 1].T]])
    return float(np.linalg.eigvals(slopes).real.max())


def _forces(q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Return terms that do not depend on places: a constant force, friction and inputs."""
    return np.concatenate([np.ones((len(q), 1)), v, signs_of(v), u], axis=1)


def _linear(q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Return the terms of linear equations of motion, and dry friction."""
    return np.concatenate([q, _forces(q, v, u)], axis=1)


def _regression(
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
    table = _table(motions, paths, h, terms)
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


def _table(
    motions: Sequence[Motion], paths: Sequence[Motion], h: float, terms: Terms
) -> np.ndarray:
    """Return ``weak_rows`` of motions with ``quasi_coordinates``, without most of their overlap."""
    rows = []
    for (q, u), (path, _) in zip(motions, held_still(paths), strict=True):
        if len(q) >= SHORTEST:
            places = path if path.shape == q.shape else q  # of rotations, their entries
            rows.append(weak_rows(places, u, h, terms, path)[::HALF])
    return np.concatenate(rows) if rows else np.empty((0, 1))


def _shared(sizes: np.ndarray, coordinates: Coordinates) -> np.ndarray:
    """Return sizes (n,), equal for the components of a vector in body axes."""
    found, flat = sizes.copy(), len(coordinates.flat)
    starts = [*range(flat, coordinates.n, 3), *(place for place, _ in coordinates.free)]
    for start in starts:
        found[start : start + 3] = np.sqrt(np.mean(sizes[start : start + 3] ** 2))
    return found


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
