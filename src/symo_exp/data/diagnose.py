"""What recordings can teach, found before anything is trained."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from math import comb

import numpy as np

from symo_exp.mechanics.types import Coordinates

HALF = 5
"""Nodes on either side of the middle of a test function."""
POOR, NOISY, COARSE = 0.5, 0.5, 0.7
"""Share of power explained below which a model must fail; noise over curvature, and angle [rad] in
a step, above which the time step does not suit."""
HELP = 0.1
"""Share of what is left unexplained that meaningful inputs explain at least."""


@dataclass(frozen=True)
class Diagnosis:
    """``explained`` and ``free``: the share of the accelerations' power that configurations,
    velocities and friction explain with the inputs and without them, ``None`` where there are too
    few nodes. For each coordinate: ``noise`` (standard deviation of the samples), ``encoder``
    (its step, 0 where none is seen), ``turn`` (the largest change in a time step) and
    ``curvature`` (root mean square of ``h² q̈``). ``blur``: noise of the nodes over curvature."""

    coordinates: Coordinates
    time_step: float
    driven: bool
    explained: float | None
    free: float | None
    noise: np.ndarray
    encoder: np.ndarray
    turn: np.ndarray
    curvature: np.ndarray
    blur: float

    @property
    def fixes_scale(self) -> bool:
        """Whether inputs tell how large the inertia is, not only its ratio to the forces."""
        if not self.driven or self.explained is None or self.free is None:
            return self.driven
        return self.explained - self.free >= HELP * (1 - self.free)

    def lines(self) -> list[str]:
        """For the log: inputs, noise, time step and scale."""
        return [self._inputs(), self._noise(), self._step(), self._scale()]

    def _inputs(self) -> str:
        if self.explained is None:
            return "inputs: too few nodes to tell what they explain"
        text = f"inputs: {100 * self.explained:.3g} % of the accelerations' power is explained"
        if self.driven:
            text += f" with them, {100 * (self.free or 0.0):.3g} % without"
        hint = "; something else moves the machine, or a sensor fails"
        return text + (hint if self.explained < POOR else "")

    def _noise(self) -> str:
        each = zip(self.coordinates.names, self.noise, self.encoder, strict=True)
        return "noise: " + ", ".join(
            f"{name} {noise:.1e}" + (f" (encoder step {step:.2g})" if step else "")
            for name, noise, step in each
        )

    def _step(self) -> str:
        h, names = f"{self.time_step:g}", self.coordinates.names
        moves = ", ".join(f"{n} at most {x:.2g}" for n, x in zip(names, self.turn, strict=True))
        angles = self.turn[np.array(self.coordinates.angular)]
        verdict = "suits"
        if angles.size and angles.max() > COARSE:
            verdict = "is coarse: a smaller one sees more of the motion"
        elif self.blur > NOISY:
            verdict = "is fine: noise hides the curvature, a larger one shows it"
        return (
            f"time step: {h} s {verdict} ({moves} a step, noise {self.blur:.1g} of the curvature)"
        )

    def _scale(self) -> str:
        if not self.driven:
            return "scale: no inputs, so the Lagrangian is known up to a factor"
        if not self.fixes_scale:
            return "scale: the inputs explain next to nothing, so the inertia's scale is doubtful"
        return "scale: the inputs fix that of the inertia"


Motion = tuple[np.ndarray, np.ndarray]
"""Configurations (T, n) and inputs (T, m) at nodes."""


def diagnose(
    motions: Sequence[Motion],
    raw: Sequence[np.ndarray],
    coordinates: Coordinates,
    time_step: float,
    samples: float = 1.0,
) -> Diagnosis:
    """``motions`` at nodes ``time_step`` apart, ``raw`` (T', n) the configurations as sampled,
    ``samples`` of them in a step."""
    second = [np.diff(q, 2, axis=0) for q, _ in motions]
    noise = np.array([noise_of(columns) for columns in _columns(raw)])
    # a cubic fitted to N equal steps has 9/4N of their variance in its middle
    blur = noise * np.sqrt(min(1.0, 2.25 / samples))
    power = (
        np.mean(np.concatenate(second) ** 2, axis=0) - 6 * blur**2
    )  # second differences of noise
    curvature = np.sqrt(np.maximum(power, 0.01 * blur**2))
    return Diagnosis(
        coordinates,
        time_step,
        driven=any(bool(u.any()) for _, u in motions),
        explained=explained(motions, coordinates, time_step, driven=True),
        free=explained(motions, coordinates, time_step, driven=False),
        noise=noise,
        encoder=np.array([encoder_of(columns) for columns in _columns(raw)]),
        turn=np.max([np.abs(np.diff(q, axis=0)).max(0) for q, _ in motions], axis=0),
        curvature=curvature,
        blur=float(np.max(blur / np.maximum(curvature, np.finfo(float).tiny))),
    )


def _columns(raw: Sequence[np.ndarray]) -> list[list[np.ndarray]]:
    return [[q[:, i] for q in raw] for i in range(raw[0].shape[1])]


def noise_of(columns: Sequence[np.ndarray]) -> float:
    """Standard deviation of white noise on smooth motions: that of their k-th differences over
    ``√C(2k, k)``, the least over k; a twentieth of them, gaps and shocks, is left out."""
    found = []
    for k in range(3, 9):
        squares = np.sort(np.concatenate([np.diff(x, k) ** 2 for x in columns]))
        if kept := int(0.95 * len(squares)):
            found.append(np.sqrt(squares[:kept].mean() / comb(2 * k, k)) / 0.871)
    return float(min(found, default=np.nan))


def encoder_of(columns: Sequence[np.ndarray]) -> float:
    """The step that all increments are multiples of; 0 where there is none to be seen."""
    rises = np.concatenate([np.abs(np.diff(x)) for x in columns])
    rises = rises[rises > 1e-9]
    if not len(rises):
        return 0.0
    step = float(np.quantile(rises, 0.01))
    ratios = rises[rises < 20 * step] / step
    whole = np.abs(ratios - ratios.round()) < 0.02
    return step if len(ratios) >= 20 and whole.mean() > 0.98 else 0.0


def explained(
    motions: Sequence[Motion], coordinates: Coordinates, h: float, *, driven: bool
) -> float | None:
    """Share of the power of weak accelerations that a ridge regression predicts, each left out in
    turn; ``None`` where there are fewer than 20 or nothing moves."""
    s = np.arange(-HALF, HALF + 1) / (HALF + 1)
    bump = (1 - s**2) ** 3
    rows = []
    for q, u in motions:
        if len(q) < len(bump) + 2:
            continue
        v, middle = (q[2:] - q[:-2]) / (2 * h), q[1:-1]
        terms = _terms(middle, v, u[1:-1, : None if driven else 0], coordinates)
        both = np.concatenate([np.diff(q, 2, axis=0) / h**2, terms], axis=1)
        weak = np.lib.stride_tricks.sliding_window_view(both, len(bump), axis=0) @ bump
        rows.append(weak[::HALF])
    table = np.concatenate(rows) if rows else np.empty((0, 1))
    n = coordinates.n
    if len(table) < 20 or not (np.isfinite(table).all() and np.ptp(table[:, :n], axis=0).all()):
        return None
    target, terms = (x / np.sqrt(np.mean(x**2, axis=0) + 1e-300) for x in np.split(table, [n], 1))
    return max(0.0, 1.0 - _left_out(terms, target))


def _left_out(x: np.ndarray, y: np.ndarray) -> float:
    """Mean square of leave-one-out errors of a regression of ``y`` on ``x``, at the best ridge."""
    left, scales, _ = np.linalg.svd(x, full_matrices=False)
    found = []
    for ridge in 10.0 ** np.arange(-8, 3):
        shrunk = left * (scales**2 / (scales**2 + ridge * len(x)))
        weight = np.maximum(1 - np.sum(shrunk * left, axis=1), 1e-9)
        error = (y - shrunk @ (left.T @ y)) / weight[:, None]
        found.append(float(np.mean(error**2)))
    return min(found)


def _terms(q: np.ndarray, v: np.ndarray, u: np.ndarray, coordinates: Coordinates) -> np.ndarray:
    """What accelerations are made of: places, products of velocities, friction, inputs."""
    each = [
        [np.cos(x), np.sin(x)] if angular else [x]
        for x, angular in zip(q.T, coordinates.angular, strict=True)
    ]
    pairs = [a * b for x, y in itertools.combinations(each, 2) for a in x for b in y]
    places = [np.ones(len(q)), *itertools.chain(*each), *pairs]
    pace = np.sqrt(np.mean(v**2, axis=0)) + 1e-300
    products = [a * b for a, b in itertools.combinations_with_replacement(v.T, 2)]
    friction = [*v.T, *np.tanh(10 * v / pace).T]
    forces = [*products, *u.T]
    return np.stack([*places, *friction, *(f * p for f in forces for p in places)], axis=1)
