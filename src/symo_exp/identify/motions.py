"""Time step, units, delay, inertia and stiffness of a machine, as its motions show them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from symo_exp.data.diagnose import (
    HELP,
    POOR,
    Motion,
    blur_of,
    contradiction,
    explained_in_degrees,
    explained_power,
    growth_rate,
    held_still,
    input_gains,
    noise_of,
    quasi_coordinates,
    spring_slopes,
)
from symo_exp.data.folds import thinned
from symo_exp.data.parts import LONGEST_GAP
from symo_exp.data.recorded import acting_late
from symo_exp.data.resample import Samples, averaged, fitted
from symo_exp.data.shocks import shocks
from symo_exp.data.table import Recording
from symo_exp.evaluation.horizon import HORIZONS
from symo_exp.mechanics.types import Coordinates
from symo_exp.mechanics.units import SI, Units

STEPS = (0.02, 0.01, 0.005, *(x * 10.0**-k for k in range(3, 7) for x in (2, 1, 0.5)))
"""Time steps to choose from [s], the usual one first."""
COARSE = 0.7
"""Change of an angle, or of the phase of a vibration, in a time step above which a smaller one is
taken [rad]."""
STEEP = 0.3
"""Logarithm of the growth of errors in a time step above which a smaller one is taken."""
LARGEST, LONGEST = 7.0, 4.0
"""Logarithms of the growth of errors: over 2 s beyond which horizons are shorter, and over the
longest of these."""
MISSED = 0.3
"""Share of a motion that lines between the nodes may miss."""
DELAYS = np.arange(-4, 7) / 100
"""Delays of inputs that are tried [s], in proportion to a time step below ``UNHURRIED``."""
LAGS = tuple(
    np.arange(low, high + 1) / 100 for low, high in ((0, 10), (10, 20), (20, 40), (40, 80))
)
"""Time constants of inputs that are tried [s], likewise, each range where the longest of the one
before explains most."""
UNHURRIED = 0.005
"""Time step from which all of ``DELAYS`` and ``LAGS`` are tried [s]."""
GAIN, CLEAR = 0.05, 0.5
"""Shares of the unexplained power that a delay explains at least to be a candidate, and to be that
of all candidates."""
TOLD = 0.2
"""Unexplained power with a delay of all candidates over that without inputs, at most: regressions
represent arms badly, and where inputs explain little of the motion, they say nothing of delays."""
CONTRADICTED = 2.0
"""Unexplained power with an input matrix over that with any from which the matrix is learned."""
EXAMINED, NODES = 60.0, 3000
"""Length of the training part that delay and speeds are estimated from [s], and its nodes at
least."""
SPREAD = 600.0
"""Length of the pieces, from the whole recordings, that the fastest turn is found in [s]."""
REST = 0.05
"""Velocity below which dry friction fades, over the root mean square of a coordinate's."""
USUAL_REST = 0.1
"""That of machines that are not slow, in their units: the default of dissipation.rest_velocity."""
SLOW = 0.3
"""Share of the usual one below which it is lowered."""
DAMPING = 0.01
"""Friction at the start of training over the inertia, in the units of the machine."""
HELD_BACK = 0.3
"""Share of the forces of inputs that friction starts with where residuals are forces at first."""
FAR = 100.0
"""Factor from 1 up to which times and inertias are learned in SI units."""
NARROW, WIDE = 1e-5, 10.0
"""Radii of gyration of a body at least and at most [units of length]."""
USUAL_RADIUS = 1.0
"""That with which training starts if the inputs do not show it: the ratio of inertia and mass of a
body is not determined then [units of length]."""
FORGOTTEN = 10.0
"""Time constants after which an input no longer acts."""
FAST, USUAL_MISS = 0.03, 8.0
"""Distance of a node from the cubic through its four neighbours from which samples do not resolve
an angle [rad], and that over the median distance, which is that of noise, at least."""
PIECE = 13
"""Nodes between two such stretches, at least: models are not fitted to shorter pieces."""
Sampled = tuple[Recording, np.ndarray, np.ndarray]
"""A recording, nodes a time step apart, and configurations at the nodes."""
Stretch = tuple[str, float, float]
"""Label of a recording, first and last time of a stretch of it [s]."""


@dataclass(frozen=True, kw_only=True)
class Dynamics:
    """Properties of a machine's dynamics that its motions show.

    Args:
        rest_velocity: Below which dry friction fades at first, in ``units``: a small part of the
            speed of the slowest coordinate.
        units: Those in which parameters are learned.
        delay: Of the inputs [s], if one explains the motion better than none; else 0; ``None`` if
            ``settings`` have it.
        explained: Share of the accelerations' power that is explained; ``None``: unknown.
        stiffness: Of springs that explain what gravity does not, in ``units``; else
            ``None``.
        horizon: Longest time over which errors are compared [s].
        friction: Friction of each coordinate to start from where residuals are forces at first, in
            ``units``.
        radius: Radius of gyration of a body that turns freely, in ``units``.
        settings: Overrides that every candidate has.
        notes: The inferred properties, a line each.
    """

    rest_velocity: float
    units: Units
    delay: float | None
    explained: float | None
    stiffness: tuple[tuple[float, ...], ...] | None
    horizon: float = HORIZONS[-1]
    friction: tuple[float, ...] = ()
    radius: float = USUAL_RADIUS
    settings: tuple[str, ...]
    notes: tuple[str, ...]


def dynamics(
    recordings: Sequence[Recording],
    coordinates: Coordinates,
    time_step: float,
    input_matrix: np.ndarray | None,
    *,
    known: bool = False,
) -> Dynamics:
    """Return the dynamics that recordings show.

    Args:
        recordings: Configurations (T, N), angles in radians and rotations as their nine entries.
        coordinates: Those of the machine.
        time_step: Distance of the nodes [s].
        input_matrix: That of the inputs, zero where it is to be learned; ``None``: no inputs.
        known: Whether the equations are known, in SI units and with values to start from.
    """
    driven = input_matrix is not None
    settings: list[str] = []
    notes: list[str] = []
    beginning = _beginning(recordings, max(EXAMINED, NODES * time_step))
    rotations = coordinates.space.normalised  # whose entries are fitted one by one
    motions = [
        (one, nodes, rotations(torch.tensor(q)).numpy())
        for one, nodes, q in _motions(beginning, time_step)
    ]
    delays = DELAYS * min(1.0, time_step / UNHURRIED) if driven else np.zeros(1)
    left = _best(delays, lambda delay: _unexplained(motions, coordinates, time_step, delay))
    if driven and left:
        lag, with_lag = _lag(motions, coordinates, time_step)
        if with_lag <= (1.0 - CLEAR) * min(left.values()):
            motions, left = _lagging(motions, lag), {0.0: with_lag}
            beginning = [acting_late(one, lag=lag) for one in beginning]
            settings.append(f"data.input_lag={lag:g}")
            notes.append(f"inputs: forces follow them with a time constant of {1e3 * lag:g} ms")
    delay, told = _delay(left)
    inputs = [one.samples.u for one in beginning]
    changes = not inputs or bool(np.ptp(np.concatenate(inputs), axis=0).any())
    if not changes:
        told = "inputs: they never change, which does not tell their delay"
    clear = not known and delay != 0.0 and left[delay] <= (1.0 - CLEAR) * left[0.0]
    if clear:
        free = _unexplained(motions, coordinates, time_step, driven=False)
        clear = free is not None and left[delay] <= TOLD * free
    units = SI if known else _units(motions, coordinates, time_step)
    step = time_step / units.time
    scaled = _scaled(_pairs(motions, time_step, delay), coordinates._replace(units=units))
    inertia, radius, friction = 1.0, USUAL_RADIUS, (DAMPING,) * coordinates.n
    acts = any(bool(u.any()) for _, u in scaled)
    if input_matrix is not None and acts and left and 1.0 - left[delay] > POOR:
        matrix = input_matrix * coordinates._replace(units=units).sizes.numpy()[:, None]
        matrix = matrix / units.size("N m")
        inertia, radius = _inertia(scaled, coordinates, step, matrix)
        if not known:
            source = "as inputs suggest" if changes else "a guess, because inputs never change"
            notes.append(f"scale: training starts with an inertia of {inertia:.2g}, {source}")
            settings += _start(scaled, coordinates, step, matrix, inertia, notes)
            units = units._replace(mass=_unit(inertia, FAR))
            inertia /= units.mass
        if not coordinates.rotations:
            friction = _friction(scaled, matrix / units.mass)
    if units != SI:
        sized = units._asdict().items()
        settings += [f"system.scale.{name}={size:g}" for name, size in sized if size != 1.0]
        notes.append(
            f"units: parameters are learned in {units.length:g} m, {units.time:g} s and "
            f"{units.mass:g} kg, in which the motion is of order one"
        )
    if clear:
        settings.append(f"data.input_delay={delay:g}")
    rest = USUAL_REST  # bodies that turn freely have no joints with dry friction
    if not coordinates.rotations:
        rest = _rest_velocity([q for q, _ in scaled], step)
    if rest != USUAL_REST:
        settings.append(f"dissipation.rest_velocity={rest:g}")
        speeds = " or ".join(f"{unit}/s" for unit in coordinates.units_of_errors)
        unit = speeds if units == SI else "units of velocity"
        notes.append(f"friction: a slow machine, dry friction fades below {rest:g} {unit}")
    horizons = _horizons(_growth(beginning, coordinates, time_step, delay if clear else 0.0))
    if horizons != HORIZONS:
        times = ", ".join(f"{each:g}" for each in horizons)
        settings.append(f"learner.validation.horizons=[{times}]")
        notes.append(
            f"unstable: the errors of predictions grow fast; those over {times} s are compared"
        )
    stiffness = _stiffness(scaled, coordinates, step, inertia)
    if stiffness is not None:
        notes.append("springs: they explain accelerations that gravity does not")
    return Dynamics(
        rest_velocity=rest,
        units=units,
        delay=None if clear else delay,
        explained=1.0 - left[delay] if left else None,
        stiffness=stiffness,
        horizon=horizons[-1],
        friction=friction,
        radius=float(f"{radius:.2g}"),
        settings=tuple(settings),
        notes=(*notes, told) if driven else tuple(notes),
    )


def _start(
    pairs: Sequence[Motion],
    coordinates: Coordinates,
    h: float,
    matrix: np.ndarray,
    inertia: float,
    notes: list[str],
) -> list[str]:
    """Return the settings of a training that starts with an inertia.

    The matrix of the inputs, in the units of the motions, is learned if these contradict it, as
    ``notes`` then say.
    """
    own = inertia / _unit(inertia, FAR)
    settings = [
        f"lagrangian.initial_inertia={own:.2g}", f"dissipation.start={DAMPING * own:.2g}",
    ]  # fmt: skip
    wrong = contradiction(pairs, coordinates, h, matrix)
    if wrong is not None and wrong >= CONTRADICTED:
        settings.append("model.inputs=learned")
        notes.append(
            f"input matrix: with the given one, {wrong:.2g} times as much power is not "
            "explained as with any; it is learned (model.inputs=given keeps it)"
        )
    return settings


def explained_by_angles(
    recordings: Sequence[Recording], coordinates: Coordinates
) -> tuple[float | None, float | None]:
    """Return the share of the accelerations' power that is explained, and that if in degrees."""
    step = max(STEPS[0], *(one.samples.step for one in recordings))
    pairs = _pairs(_motions(_beginning(recordings, EXAMINED), step), step, 0.0)
    given = pairs, coordinates, step
    return explained_power(*given, driven=True), explained_in_degrees(*given)


def fitting_time_step(
    recordings: Sequence[Recording], coordinates: Coordinates, finest: float
) -> float:
    """Return the largest of ``STEPS`` that resolves the motion, at least ``finest``."""
    usable = [h for h in STEPS if h >= finest * (1 - 1e-3)]
    if not usable:
        return float(f"{finest:.4g}")
    beginning, spread = _beginning(recordings, EXAMINED), thinned(recordings, SPREAD)

    def resolves(h: float) -> bool:
        slow = _turn(spread, coordinates, h) <= COARSE and _phase(beginning, h) <= COARSE
        return slow and _growth(beginning, coordinates, h) * h <= STEEP

    return next(filter(resolves, usable), usable[-1])


def _turn(recordings: Sequence[Recording], coordinates: Coordinates, h: float) -> float:
    """Return the change of angles in a time step that few are larger than [rad].

    It is that of nodes, which have less noise than samples, whose noise would count as a speed.
    """
    angular = np.array(coordinates.angular)
    motions = _motions(recordings, h) if angular.any() else ()
    steps = [np.abs(np.diff(q[:, angular], axis=0)) for _, _, q in motions]
    return float(np.quantile(np.concatenate(steps), 0.999)) if steps else 0.0


def reversed_inputs(
    recordings: Sequence[Recording], coordinates: Coordinates, h: float, input_matrix: np.ndarray
) -> np.ndarray:
    """Return which inputs (m,) act against the coordinates that they drive; none with rotations.

    The acceleration that an input adds along its own column ``b``, ``b · H⁻¹ b``, is positive with
    any inertia, unless the sign of the input is that of another direction.
    """
    none = np.zeros(input_matrix.shape[1], dtype=bool)
    if coordinates.rotations:
        return none
    pairs = _pairs(_motions(_beginning(recordings, max(EXAMINED, NODES * h)), h), h, 0.0)
    free, driven = (explained_power(pairs, coordinates, h, driven=x) for x in (False, True))
    if free is None or driven is None or driven - free < HELP * (1.0 - free):
        return none
    gains = input_gains(pairs, coordinates, h)
    return none if gains is None else (input_matrix * gains).sum(axis=0) < 0.0


def too_fast(recordings: Sequence[Recording], coordinates: Coordinates, h: float) -> list[Stretch]:
    """Return when angles move too fast for samples a time step apart.

    There, a cubic polynomial through the two nodes before and the two after a node misses it.
    Integrators are as inaccurate, and a fit reduces their large errors at the expense of all
    others. There are no stretches if samples are closer, since smaller time steps are tried, with
    rotations, or if the greater part of the motion is too fast.
    """
    angular = np.array(coordinates.angular)
    if coordinates.rotations or not angular.any():
        return []
    if h >= 2.0 * max(one.samples.step for one in recordings) * (1 - 1e-3):
        return []
    motions = _motions(recordings, h)
    misses = [np.abs(np.diff(q[:, angular], 4, axis=0)).max(axis=1) / 6 for _, _, q in motions]
    if not misses:
        return []
    limit = max(FAST, USUAL_MISS * float(np.median(np.concatenate(misses))))
    found, lost = [], 0.0
    for (one, nodes, _), missed in zip(motions, misses, strict=True):
        fast = np.flatnonzero(missed > limit) + 2
        for run in np.split(fast, np.flatnonzero(np.diff(fast) > PIECE) + 1) if len(fast) else ():
            first, last = run[0] - LONGEST_GAP, run[-1] + LONGEST_GAP
            low, high = nodes[max(first, 0)], nodes[min(last, len(nodes) - 1)]
            found.append((one.label, float(low), float(high)))
            lost += high - low
    return found if lost < 0.5 * sum(one.samples.seconds for one in recordings) else []


def struck(recordings: Sequence[Recording], coordinates: Coordinates, h: float) -> list[Stretch]:
    """Return when something that is not recorded moves the machine (``data.shocks``).

    Shocks of machines with rotations are not searched for.
    """
    if coordinates.rotations:
        return []
    motions = [(one.label, each) for one in recordings for each in _motions([one], h)]
    pairs = _pairs([each for _, each in motions], h, 0.0)
    found = shocks(pairs, coordinates, h)
    return [
        (label, float(nodes[first]), float(nodes[last]))
        for (label, (_, nodes, _)), runs in zip(motions, found, strict=True)
        for first, last in runs
    ]


def along_turns(recording: Recording, space: Coordinates) -> Recording:
    """Return a recording of the sums of the turns of rotations (``quasi_coordinates``)."""
    samples = recording.samples
    return recording._replace(samples=samples._replace(q=quasi_coordinates(samples.q, space)))


def _phase(recordings: Sequence[Recording], h: float) -> float:
    """Return ``ω h``, the phase by which the fastest coordinate vibrates in a time step [rad].

    It is infinite where lines between the nodes miss much of the motion, or recordings are too
    short for such a step.
    """
    motions = _motions(recordings, h)
    if not motions:
        return np.inf if recordings else 0.0
    return np.inf if _missed(motions) > MISSED else h * _frequency(motions, h)


def _growth(
    recordings: Sequence[Recording], coordinates: Coordinates, h: float, delay: float = 0.0
) -> float:
    """Return the rate at which small errors grow [1/s], 0 with rotations and where it is unknown.

    It is seen at the time step, or where noise hides it there, at the next larger one of ``STEPS``.
    """
    if coordinates.rotations:
        return 0.0
    for step in sorted({h, *(larger for larger in STEPS if larger > h)}):
        rate = growth_rate(_pairs(_motions(recordings, step), step, delay), coordinates, step)
        if rate is not None:
            return rate
    return 0.0


def _frequency(motions: Sequence[Sampled], h: float) -> float:
    """Return the frequency ``ω`` at which the fastest coordinate vibrates [rad/s].

    It is the ratio of the root mean squares of accelerations and velocities, without the noise of
    the nodes; 0 where noise hides them.
    """
    first, second = (np.concatenate([np.diff(q, k, axis=0) for _, _, q in motions]) for k in (1, 2))
    columns = zip(*(one.samples.q.T for one, _, _ in motions), strict=True)
    noise = np.array([np.nan_to_num(noise_of(each)) for each in columns])
    count = h / np.median(np.concatenate([np.diff(one.samples.t) for one, _, _ in motions]))
    blur = blur_of(noise, count) ** 2
    velocity = np.mean(first**2, axis=0) - 2 * blur
    acceleration = np.mean(second**2, axis=0) - 6 * blur
    seen = (velocity > blur) & (acceleration > blur)
    return float(np.sqrt(acceleration[seen] / velocity[seen]).max(initial=0.0)) / h


def _missed(motions: Sequence[Sampled]) -> float:
    """Return the share of a coordinate's motion that lines between nodes miss, the largest."""
    left, motion = 0.0, np.finfo(float).tiny
    for one, nodes, q in motions:
        samples = one.samples
        inside = (samples.t >= nodes[0]) & (samples.t <= nodes[-1])
        lines = np.stack([np.interp(samples.t[inside], nodes, x) for x in q.T], axis=1)
        left = left + np.sum((samples.q[inside] - lines) ** 2, axis=0)
        motion = motion + np.sum((samples.q[inside] - samples.q[inside].mean(axis=0)) ** 2, axis=0)
    return float(np.sqrt(left / motion).max())


def _units(motions: Sequence[Sampled], coordinates: Coordinates, h: float) -> Units:
    """Return units of length and time in which motions are of order one, with SI prefixes.

    Lengths have the prefix nearest to their range, so that logs in m and in mm are learned as the
    same; with rotations, if it is far from 1 m, since bodies are smaller than their flights. Time
    has the unit s unless the motion is faster or slower by ``FAR``.
    """
    if not motions:
        return SI
    count = len(coordinates.flat)
    lengths = ~np.array(coordinates.angular[:count], dtype=bool)
    q = np.concatenate([nodes[:, :count] for _, _, nodes in motions])[:, lengths]
    paths = [
        (along_turns(one, coordinates), nodes, quasi_coordinates(q, coordinates))
        for one, nodes, q in motions
    ]  # fmt: skip
    frequency = _frequency(paths, h)
    return Units(
        length=_unit(
            float(np.ptp(q, axis=0).max(initial=0.0)), FAR if coordinates.rotations else 1.0
        ),
        time=_unit(1.0 / frequency, FAR) if frequency > 0.0 else 1.0,
    )


def _unit(size: float, far: float) -> float:
    """Return the power of 1000 nearest to a size, 1 where it is up to ``far`` from 1 or zero."""
    if not size > 0.0 or 1.0 / far <= size <= far:
        return 1.0
    return float(f"1e{3 * round(np.log10(size) / 3)}")


def _beginning(recordings: Sequence[Recording], seconds: float) -> list[Recording]:
    """Return the first seconds of recordings, of those first in which inputs act.

    Of the whole that a recording is a piece of, they have what may act in them.
    """
    found, total = [], 0.0
    for one in sorted(recordings, key=lambda one: not one.samples.u.any()):
        if total >= seconds:
            break
        t = one.samples.t
        inside = t - t[0] <= seconds - total
        total += one.samples.seconds
        samples = one.samples.rows(inside)
        found.append(one._replace(samples=samples, whole=_around(one.whole, samples)))
    return [one for one in found if len(one.samples.t) > 20]


def _around(whole: Samples, samples: Samples) -> Samples:
    """Return samples with those of the whole around them whose inputs may act in them."""
    before, after = FORGOTTEN * LAGS[-1][-1], -DELAYS[0]
    first, last = samples.t[0] - before, samples.t[-1] + after
    return whole.rows((whole.t >= first) & (whole.t <= last))


def _motions(recordings: Sequence[Recording], h: float) -> list[Sampled]:
    """Return the recordings at nodes, what never moves exactly constant: roundings vibrate."""
    held = held_still([(one.samples.q, one.samples.u) for one in recordings])
    motions = []
    for one, (q, _) in zip(recordings, held, strict=True):
        t = one.samples.t
        nodes = np.arange(t[0] + h, t[-1] - h, h)
        if len(nodes) > 13:
            path = np.where(np.ptp(q, axis=0) > 0.0, fitted(t, q, nodes, h)[0], q[0])
            motions.append((one._replace(samples=one.samples._replace(q=q)), nodes, path))
    return motions


def _rest_velocity(paths: Sequence[np.ndarray], h: float) -> float:
    """Return a small part of the speed of the slowest coordinate that moves, if it is slow."""
    if not paths:
        return USUAL_REST
    speeds = np.concatenate([np.diff(q, axis=0) / h for q in paths])
    pace = np.sqrt(np.mean(speeds**2, axis=0))
    slowest = float(pace[pace > 0].min(initial=np.inf))
    found = float(f"{REST * slowest:.1g}")
    return found if found < SLOW * USUAL_REST else USUAL_REST


def _lagging(motions: Sequence[Sampled], lag: float) -> list[Sampled]:
    return [(acting_late(one, lag=lag), nodes, q) for one, nodes, q in motions]


def _unexplained(
    motions: Sequence[Sampled],
    coordinates: Coordinates,
    h: float,
    delay: float = 0.0,
    *,
    driven: bool = True,
) -> float | None:
    """Return the share of the accelerations' power that inputs with a delay do not explain.

    Where it is not ``driven``, that which configurations and velocities do not explain.
    """
    share = explained_power(_pairs(motions, h, delay), coordinates, h, driven=driven)
    return None if share is None else 1.0 - share


def _best(
    times: Iterable[float], unexplained: Callable[[float], float | None]
) -> dict[float, float]:
    """Return the share that is not explained with each time, and with the best one in between."""
    found = {float(f"{each:.3g}"): unexplained(float(each)) for each in times}
    left = {each: share for each, share in found.items() if share is not None}
    if (between := _lowest(left)) is not None and (share := unexplained(between)) is not None:
        left[float(f"{between:.3g}")] = share
    return left


def _lag(motions: Sequence[Sampled], coordinates: Coordinates, h: float) -> tuple[float, float]:
    """Return the best time constant of inputs [s], and the share that is not explained with it."""

    def unexplained(lag: float) -> float | None:
        return _unexplained(_lagging(motions, lag), coordinates, h)

    left: dict[float, float] = {}
    for lags in LAGS:
        left |= _best(lags * min(1.0, h / UNHURRIED), unexplained)
        best = min(left, key=lambda lag: left[lag])
        if best != max(left):
            break
    return best, left[best]


def _lowest(left: Mapping[float, float]) -> float | None:
    """Return where the parabola through the least unexplained share and its neighbours is lowest.

    Times are equally distant. Inputs that a digital controller holds between samples act half a
    sample after their record, a part of the distance of ``DELAYS``.
    """
    delays = sorted(left)
    k = min(range(len(delays)), key=lambda i: left[delays[i]], default=0)
    if not 0 < k < len(delays) - 1:
        return None
    before, least, after = (left[delay] for delay in delays[k - 1 : k + 2])
    curvature = before - 2.0 * least + after
    if not curvature > 0.0:
        return None
    shift = 0.5 * (before - after) / curvature
    return float(f"{delays[k] + shift * (delays[k + 1] - delays[k]):.2g}")


def _inertia(
    pairs: Sequence[Motion], coordinates: Coordinates, h: float, input_matrix: np.ndarray
) -> tuple[float, float]:
    """Return the inertia that the inputs move and, of a free body, its radius of gyration.

    The inertia is that of the lightest coordinates, the mass of a free body. A training that starts
    with too much inertia does not find its way: the accelerations due to the inputs are then lost
    among those of the potential and of friction. If the input matrix is to be learned, the inertia
    is such that its entries are about one.
    """
    gains = input_gains(pairs, coordinates, h)
    assert gains is not None
    moves, acts = gains.any(axis=1), gains.any(axis=0)  # what never moves or acts has no gains
    gains, input_matrix = gains[:, acts], input_matrix[:, acts]
    if not coordinates.rotations:
        size = float(np.linalg.norm(gains))
        return (float(np.linalg.norm(input_matrix[moves])) / size if size > 0 else 1.0), 1.0
    turns = np.array(coordinates.turning)
    if not input_matrix.any():
        size = float(np.abs(gains).max(initial=0.0))
        return (1.0 / size if size > 0 else 1.0), USUAL_RADIUS
    mass, inertia = (
        float(np.linalg.norm(input_matrix[rows])) / max(float(np.linalg.norm(gains[rows])), 1e-300)
        for rows in (moves & ~turns, moves & turns)
    )
    if not (mass > 0.0 and inertia > 0.0):
        return max(mass, inertia), USUAL_RADIUS
    return mass, float(np.clip(np.sqrt(inertia / mass), NARROW, WIDE))


def _friction(pairs: Sequence[Motion], input_matrix: np.ndarray) -> tuple[float, ...]:
    """Return a share of the forces of the inputs, a start that is not too small by far."""
    forces = np.concatenate([u for _, u in pairs]) @ input_matrix.T
    sizes = HELD_BACK * np.sqrt(np.mean(forces**2, axis=0))
    return tuple(float(f"{x:.2g}") for x in np.where(sizes > 0.0, sizes, sizes.max()))


def _stiffness(
    pairs: Sequence[Motion], coordinates: Coordinates, h: float, inertia: float
) -> tuple[tuple[float, ...], ...] | None:
    """Return the stiffness of springs at that inertia, ``None`` if they explain little.

    Training does not find springs from none within some tens of epochs: the inertia of what they
    move falls instead.
    """
    slopes = spring_slopes(pairs, coordinates, h)
    if slopes is None:
        return None
    stiffness = -0.5 * inertia * (slopes + slopes.T)
    return tuple(tuple(float(f"{x:.3g}") for x in row) for row in stiffness)


def _horizons(rate: float) -> tuple[float, ...]:
    """Return horizons [s] over which errors grow little, the usual ones if these are suitable.

    Over longer ones the noise of the starts grows beyond the motion, and a wrong model that stays
    near the mean has smaller errors than the right one. ``rate`` is that of the growth [1/s].
    """
    growth = rate * HORIZONS[-1]
    if growth <= LARGEST:
        return HORIZONS
    return tuple(float(f"{LONGEST / growth * each:.2g}") for each in HORIZONS)


def _pairs(motions: Sequence[Sampled], h: float, delay: float) -> list[Motion]:
    """Return configurations and inputs, which act ``delay`` after their record, at the nodes."""
    return [
        (q, averaged(one.samples.t, acting_late(one, delay).acting().u, nodes, h))
        for one, nodes, q in motions
    ]


def _scaled(pairs: Sequence[Motion], coordinates: Coordinates) -> list[Motion]:
    """Return motions whose lengths are in the units of the coordinates."""
    flat = len(coordinates.flat)
    places = np.ones(coordinates.width)
    places[:flat] = coordinates.sizes.numpy()[:flat]
    return [(q / places, u) for q, u in pairs]


def _delay(left: Mapping[float, float]) -> tuple[float, str]:
    """Return the delay with which inputs explain most, if it is much, and a line about it."""
    if 0.0 not in left:
        return 0.0, "inputs: too little motion to tell their delay"
    best = min(left, key=lambda delay: left[delay])
    if best != 0.0 and left[best] <= (1.0 - GAIN) * left[0.0]:
        return best, (
            f"inputs: with a delay of {1e3 * best:g} ms, {100 * left[best]:.2g} % of the "
            f"accelerations' power is not explained, without {100 * left[0.0]:.2g} %"
        )
    return 0.0, f"inputs: no delay; {100 * (1 - left[0.0]):.3g} % of the power is explained"
