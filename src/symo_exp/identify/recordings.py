"""Properties of a machine that are inferred from its recordings before training."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from symo_exp.data.diagnose import (
    POOR,
    SPRUNG,
    SUSPECT,
    Motion,
    blur_of,
    explained_in_degrees,
    explained_power,
    input_gains,
    noise_of,
    spring_slopes,
)
from symo_exp.data.formats import shown
from symo_exp.data.header import header, names
from symo_exp.data.parts import divided, uninterrupted, with_every_part
from symo_exp.data.recorded import delayed
from symo_exp.data.resample import Samples, averaged, fitted
from symo_exp.data.table import Recording, read_recordings
from symo_exp.errors import ConfigError
from symo_exp.mechanics.types import Coordinates
from symo_exp.mechanics.units import SI, Units
from symo_exp.systems.recorded import Recorded

STEPS = (0.02, 0.01, 0.005, 0.002, 0.001, 5e-4, 2e-4, 1e-4)
"""Time steps to choose from [s], the usual one first."""
COARSE = 0.7
"""Change of an angle, or of the phase of a vibration, in a time step above which a smaller one is
taken [rad]."""
SPAN = 2 * np.pi
"""Range of a coordinate beyond which it is an angle."""
MISSED = 0.3
"""Share of a motion that lines between the nodes may miss."""
WHOLE = 0.3
"""Distance of a jump from a whole turn, over a turn, up to which an angle is wrapped."""
ANGLE = (
    "theta|phi|psi|alpha|beta|angle|ang|rot|joint|shoulder|elbow|hip|knee|ankle|wrist|pole|arm|link"
    "|pendulum|upper|lower|roll|pitch|yaw|motor|wheel"
)
SLIDE = "x|y|z|pos|position|cart|slide|slider|lin|linear|prismatic|height|stroke|carriage|table|d"
"""Words in the names of angles and of positions."""
DELAYS = np.arange(-0.04, 0.0601, 0.01)
"""Delays of inputs that are tried [s], in proportion to a time step below ``UNHURRIED``."""
UNHURRIED = 0.005
"""Time step from which all of ``DELAYS`` are tried [s]."""
GAIN = 0.05
"""Share of the unexplained power that a delay explains at least to be a candidate."""
ABOVE_NOISE = 10.0
"""Range of a coordinate over its noise from which it moves."""
EXAMINED, NODES = 60.0, 3000
"""Length of the training part that delay and speeds are estimated from [s], and its nodes at
least."""
REST = 0.05
"""Velocity below which dry friction fades, over the root mean square of a coordinate's."""
USUAL_REST = 0.1
"""That of machines that are not slow, in their units: the default of dissipation.rest_velocity."""
SLOW = 0.3
"""Share of the usual one below which it is lowered."""
DAMPING = 0.01
"""Friction at the start of training over the inertia, in the units of the machine."""
FAR = 100.0
"""Factor from 1 up to which times and inertias are learned in SI units."""
Sampled = tuple[Samples, np.ndarray, np.ndarray]
"""Samples, nodes a time step apart, and configurations at the nodes."""


@dataclass(frozen=True)
class Machine:
    """A recorded machine: the settings of its system, and what its candidates depend on.

    Args:
        settings: Overrides that every candidate has.
        angular: Which coordinates are angles.
        driven: Whether any input is not zero.
        time_step: That of the candidates [s].
        finest_step: Distance of the samples [s], the largest over recordings.
        seconds: Length of the training and validation part [s].
        recordings: How many there are in these parts.
        rest_velocity: Below which dry friction fades at first, in ``units``: a small part of the
            speed of the slowest coordinate.
        units: Those in which parameters are learned.
        delay: Of the inputs [s], if one explains the motion better than none; else 0.
        explained: Share of the accelerations' power that is explained; ``None``: unknown.
        moves: Whether any coordinate moves by more than its noise.
        stiffness: Of springs that explain accelerations better than gravity, in ``units``; else
            ``None``.
        notes: The inferred properties, a line each.
    """

    settings: tuple[str, ...]
    angular: tuple[bool, ...]
    driven: bool
    time_step: float
    finest_step: float
    seconds: float
    recordings: int
    rest_velocity: float
    units: Units
    delay: float
    explained: float | None
    moves: bool
    stiffness: tuple[tuple[float, ...], ...] | None
    notes: tuple[str, ...]

    @property
    def nodes(self) -> int:
        """Nodes of the training and validation parts."""
        return max(1, round(self.seconds / self.time_step))

    @property
    def n(self) -> int:
        """Number of coordinates."""
        return len(self.angular)


def examine(
    data: Mapping[str, Any],
    *,
    angular: Any = None,
    input_matrix: Any = None,
    time_step: float | None = None,
) -> Machine:
    """Read recordings and infer what is not given.

    Args:
        data: Settings of ``RecordedData``, those of files, columns, units and parts.
        angular: As ``system.angular``; ``None``: by names and ranges.
        input_matrix: As ``system.input_matrix``; ``None``: by names.
        time_step: As ``system.time_step``; ``None``: by the fastest motion.

    Raises:
        ConfigError: If something can neither be read nor inferred.
    """
    path, columns = data["path"], data.get("columns")
    found = header(path, columns)
    coordinates, inputs = names("q", found), names("u", found)
    _refuse_rotations(coordinates)
    settings, notes = [], []
    if input_matrix is None:
        input_matrix = _input_matrix(coordinates, inputs)
        if input_matrix is not None:
            settings.append(f"system.input_matrix={str(input_matrix).replace(' ', '')}")
            pairs = ", ".join(f"u_{name} drives q_{name}" for name in inputs)
            notes.append(f"inputs: {pairs}, by their names")

    def system(which: Any) -> Recorded:
        return Recorded(
            names=coordinates, angular=which, inputs=inputs, input_matrix=input_matrix,
            time_step=1.0,
        )  # fmt: skip

    used, test, told = _parts(data, system("none"), time_step)
    notes += told
    recordings = len(used)
    if angular is None:
        which = [
            _is_angle(name, [r.samples.q[:, i] for r in used]) for i, name in enumerate(coordinates)
        ]
        chosen = [name for name, angle in zip(coordinates, which, strict=True) if angle]
        settings.append(f"system.angular=[{','.join(chosen)}]" if chosen else "system.angular=none")
        notes.append(_told(chosen, coordinates))
    else:
        which = list(system(angular).coordinates.angular)
    angles = np.array(which)
    if units := _jumps(used, angles, data):
        settings += [f"data.{name}=true" for name in units]
        notes.append(f"angles jump by a turn: read with {' '.join(settings[-len(units) :])}")
        data = {**data, **dict.fromkeys(units, True)}
    used = [_in_radians(one, angles, data) for one in used]
    if data.get("degrees") is None:
        _ask_for_degrees(used, angles, coordinates)
    finest = max(float(np.median(np.diff(one.samples.t))) for one in (*used, *test))
    if time_step is None:
        time_step = _time_step(used, angles, finest)
        settings.append(f"system.time_step={time_step:g}")
        notes.append(f"time step: {time_step:g} s, samples every {finest:.3g} s")
    _, note = uninterrupted([*used, *test], time_step)
    notes += [note] if note else []
    used, _ = uninterrupted(used, time_step)
    driven = any(bool(one.samples.u.any()) for one in used)
    motions = _motions(_beginning(used, max(EXAMINED, NODES * time_step)), time_step)
    delays = DELAYS * min(1.0, time_step / UNHURRIED) if driven else np.zeros(1)
    left = _unexplained(motions, angles, time_step, delays)
    delay, line = _delay(left)
    own = _units(motions, angles, time_step)
    light, step = 1.0, time_step / own.time
    sizes = np.where(angles, 1.0, own.length)
    scaled = [(q / sizes, u) for q, u in _pairs(motions, time_step, delay)]
    if driven and left and 1.0 - left[delay] > POOR:
        matrix = system("none").input_matrix.numpy() * sizes[:, None] / own.size("N m")
        light = _inertia(scaled, angles, step, matrix)
        own = own._replace(mass=_unit(light, FAR))
        notes.append(f"scale: training starts with an inertia of {light:.2g}, as inputs suggest")
        light /= own.mass
        settings += [f"lagrangian.initial_inertia={light:.2g}"]
        settings += [f"dissipation.start={DAMPING * light:.2g}"]
    if own != SI:
        sized = own._asdict().items()
        settings += [f"system.scale.{name}={size:g}" for name, size in sized if size != 1.0]
        notes.append(
            f"units: parameters are learned in {own.length:g} m, {own.time:g} s and "
            f"{own.mass:g} kg, in which the motion is of order one"
        )
    if (rest := _rest_velocity([q for q, _ in scaled], step)) != USUAL_REST:
        settings.append(f"dissipation.rest_velocity={rest:g}")
        unit = "units of velocity" if own != SI else "m/s or rad/s"
        notes.append(f"friction: a slow machine, dry friction fades below {rest:g} {unit}")
    stiffness = _stiffness(scaled, angles, step, light)
    if stiffness is not None:
        notes.append("springs: they explain accelerations better than gravity alone")
    return Machine(
        settings=tuple(settings),
        angular=tuple(which),
        driven=driven,
        time_step=time_step,
        finest_step=finest,
        seconds=sum(float(np.ptp(one.samples.t)) for one in used),
        recordings=recordings,
        rest_velocity=rest,
        units=own,
        delay=delay,
        explained=1.0 - left[delay] if left else None,
        moves=_moves(used),
        stiffness=stiffness,
        notes=(*notes, line) if driven else tuple(notes),
    )


def _refuse_rotations(names: Sequence[str]) -> None:
    """Refuse columns that are the entries of a quaternion."""
    stems = [name.removesuffix("_w") for name in names if name.endswith("_w")]
    for stem in stems:
        columns = [f"q_{stem}_{entry}" for entry in "wxyz"]
        if {column.removeprefix("q_") for column in columns} <= set(names):
            raise ConfigError(
                f"{', '.join(columns)} are a rotation, and the search learns lengths and angles "
                f"only: learn it by one run with system.rotations=[{stem}] (docs/rotations.md)"
            )


def _parts(
    data: Mapping[str, Any], system: Recorded, time_step: float | None
) -> tuple[list[Recording], list[Recording], list[str]]:
    """Return the recordings for training and validation, those for testing, and lines on both."""
    path = data["path"]
    table = read_recordings(path, system, data.get("columns"), data.get("time_unit"))
    named = {part: data.get(part) for part in ("train", "val", "test")}
    counts = data.get("n_val"), data.get("n_test")
    recordings, notes = list(table.recordings), list(table.notes)
    if all(given is None for given in (*named.values(), *counts)):
        recordings, note = with_every_part(recordings, time_step or STEPS[0])
        notes += [note] if note else []
    parts = divided(shown(path), recordings, named, *counts)
    return [*parts["train"], *parts["val"]], parts["test"], notes


def _in_radians(recording: Recording, angular: np.ndarray, data: Mapping[str, Any]) -> Recording:
    """Return a recording whose angles are in radians and go on beyond a turn."""
    q = recording.samples.q
    if data.get("degrees"):
        q = q * np.where(angular, np.pi / 180, 1.0)
    if data.get("wrapped"):
        q = np.where(angular, np.unwrap(q, axis=0), q)
    return recording._replace(samples=recording.samples._replace(q=q))


def _jumps(
    recordings: Sequence[Recording], angular: np.ndarray, data: Mapping[str, Any]
) -> tuple[str, ...]:
    """Return the settings of data with which angles that jump by a turn are read."""
    columns = [r.samples.q[:, i] for r in recordings for i in np.flatnonzero(angular)]
    if data.get("wrapped") is not None or not columns:
        return ()
    if not data.get("degrees") and _wraps(columns, 2 * np.pi):
        return ("wrapped",)
    if _wraps(columns, 360.0):
        return ("wrapped",) if data.get("degrees") else ("degrees", "wrapped")
    return ()


def _wraps(columns: Sequence[np.ndarray], turn: float) -> bool:
    """Return whether all steps of more than half a turn are nearly of a whole one."""
    steps = np.concatenate([np.abs(np.diff(x)) for x in columns])
    jumps = steps[steps > 0.5 * turn]
    return bool(jumps.size and (np.abs(jumps - turn) < WHOLE * turn).all())


def _ask_for_degrees(
    recordings: Sequence[Recording], angular: np.ndarray, names: Sequence[str]
) -> None:
    """Refuse angles whose motion is explained much better if their numbers are degrees."""
    ranges = [max(np.ptp(r.samples.q[:, i]) for r in recordings) for i in range(len(names))]
    wide = [i for i, angle in enumerate(angular) if angle and ranges[i] > SPAN]
    if not wide:
        return
    step = max(STEPS[0], *(float(np.median(np.diff(r.samples.t))) for r in recordings))
    pairs = _pairs(_motions(_beginning(recordings, EXAMINED), step), step, 0.0)
    given = pairs, _coordinates(angular), step
    plain, degrees = explained_power(*given, driven=True), explained_in_degrees(*given)
    if plain is None or degrees is None or plain > POOR:
        return
    if 1 - degrees < SUSPECT * (1 - plain):
        told = ", ".join(f"q_{names[i]} moves by {ranges[i]:.3g}" for i in wide)
        raise ConfigError(
            f"data.degrees has no value yet: {told}; {100 * degrees:.3g} % of the accelerations' "
            f"power is explained if these are degrees, {100 * plain:.3g} % if they are radians; "
            "give data.degrees=true or false"
        )


def _moves(recordings: Sequence[Recording]) -> bool:
    for column in zip(*(one.samples.q.T for one in recordings), strict=True):
        noise = np.nan_to_num(noise_of(column))
        if max(np.ptp(x) for x in column) > max(ABOVE_NOISE * noise, np.finfo(float).tiny):
            return True
    return False


def _input_matrix(coordinates: Sequence[str], inputs: Sequence[str]) -> list[list[int]] | None:
    """Return the matrix of inputs that have the names of coordinates, else ``None``."""
    if not inputs or not set(inputs) <= set(coordinates) or tuple(inputs) == tuple(coordinates):
        return None
    return [[int(name == other) for other in inputs] for name in coordinates]


def _is_angle(name: str, columns: Sequence[np.ndarray]) -> bool:
    """Return whether a coordinate is an angle; refuse one whose name and range do not tell."""
    words = re.split(r"[^a-z]+", name.lower())
    if any(re.fullmatch(ANGLE, word) for word in words):
        return True
    if any(re.fullmatch(SLIDE, word) for word in words):
        return False
    low, high = min(x.min() for x in columns), max(x.max() for x in columns)
    if high - low > SPAN or _wraps(columns, 2 * np.pi):
        return True
    raise ConfigError(
        f"system.angular has no value yet: is q_{name}, which goes from {low:.3g} to {high:.3g}, "
        "an angle [rad] or a position [m]? Give all, none or a list of names"
    )


def _told(chosen: Sequence[str], all_names: Sequence[str]) -> str:
    positions = [name for name in all_names if name not in chosen]
    parts = [f"angles [rad]: {', '.join(chosen)}" * bool(chosen)]
    parts += [f"positions [m]: {', '.join(positions)}" * bool(positions)]
    return "; ".join(filter(None, parts)) + " (by names and ranges; system.angular says otherwise)"


def _time_step(recordings: Sequence[Recording], angular: np.ndarray, finest: float) -> float:
    usable = [h for h in STEPS if h >= finest * (1 - 1e-3)]
    if not usable:
        return float(f"{finest:.4g}")
    speeds = [
        np.abs(np.diff(r.samples.q, axis=0)) / np.diff(r.samples.t)[:, None] for r in recordings
    ]
    fast = np.quantile(np.concatenate(speeds)[:, angular], 0.999) if angular.any() else 0.0
    beginning = _beginning(recordings, EXAMINED)
    return next(
        (h for h in usable if fast * h <= COARSE and _phase(beginning, h) <= COARSE), usable[-1]
    )


def _phase(recordings: Sequence[Recording], h: float) -> float:
    """Return ``ω h``, the phase by which the fastest coordinate vibrates in a time step [rad].

    It is infinite where lines between the nodes miss much of the motion.
    """
    motions = _motions(recordings, h)
    if not motions:
        return 0.0
    return np.inf if _missed(motions) > MISSED else h * _frequency(motions, h)


def _frequency(motions: Sequence[Sampled], h: float) -> float:
    """Return the frequency ``ω`` at which the fastest coordinate vibrates [rad/s].

    It is the ratio of the root mean squares of accelerations and velocities, without the noise of
    the nodes; 0 where noise hides them.
    """
    first, second = (np.concatenate([np.diff(q, k, axis=0) for _, _, q in motions]) for k in (1, 2))
    columns = zip(*(samples.q.T for samples, _, _ in motions), strict=True)
    noise = np.array([np.nan_to_num(noise_of(each)) for each in columns])
    count = h / np.median(np.concatenate([np.diff(samples.t) for samples, _, _ in motions]))
    blur = blur_of(noise, count) ** 2
    velocity = np.mean(first**2, axis=0) - 2 * blur
    acceleration = np.mean(second**2, axis=0) - 6 * blur
    seen = (velocity > blur) & (acceleration > blur)
    return float(np.sqrt(acceleration[seen] / velocity[seen]).max(initial=0.0)) / h


def _units(motions: Sequence[Sampled], angular: np.ndarray, h: float) -> Units:
    """Return units of length and time in which motions are of order one, with SI prefixes.

    Lengths have the prefix nearest to their range, so that logs in m and in mm are learned as the
    same; time has the unit s unless the motion is faster or slower by ``FAR``.
    """
    if not motions:
        return SI
    q = np.concatenate([nodes for _, _, nodes in motions])[:, ~angular]
    frequency = _frequency(motions, h)
    return Units(
        length=_unit(float(np.ptp(q, axis=0).max(initial=0.0)), 1.0),
        time=_unit(1.0 / frequency, FAR) if frequency > 0.0 else 1.0,
    )


def _unit(size: float, far: float) -> float:
    """Return the power of 1000 nearest to a size, 1 where it is up to ``far`` from 1 or zero."""
    if not size > 0.0 or 1.0 / far <= size <= far:
        return 1.0
    return float(f"1e{3 * round(np.log10(size) / 3)}")


def _missed(motions: Sequence[Sampled]) -> float:
    """Return the share of a coordinate's motion that lines between nodes miss, the largest."""
    left, motion = 0.0, np.finfo(float).tiny
    for samples, nodes, q in motions:
        inside = (samples.t >= nodes[0]) & (samples.t <= nodes[-1])
        lines = np.stack([np.interp(samples.t[inside], nodes, x) for x in q.T], axis=1)
        left = left + np.sum((samples.q[inside] - lines) ** 2, axis=0)
        motion = motion + np.sum((samples.q[inside] - samples.q[inside].mean(axis=0)) ** 2, axis=0)
    return float(np.sqrt(left / motion).max())


def _beginning(recordings: Sequence[Recording], seconds: float) -> list[Recording]:
    found, total = [], 0.0
    for one in recordings:
        if total >= seconds:
            break
        t = one.samples.t
        inside = t - t[0] <= seconds - total
        total += float(np.ptp(t))
        found.append(one._replace(samples=one.samples.rows(inside)))
    return [one for one in found if len(one.samples.t) > 20]


def _motions(recordings: Sequence[Recording], h: float) -> list[Sampled]:
    motions = []
    for one in recordings:
        t = one.samples.t
        nodes = np.arange(t[0] + h, t[-1] - h, h)
        if len(nodes) > 13:
            motions.append((one.samples, nodes, fitted(t, one.samples.q, nodes, h)[0]))
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


def _unexplained(
    motions: Sequence[Sampled], angular: np.ndarray, h: float, delays: np.ndarray
) -> dict[float, float]:
    """Return the share of the accelerations' power that inputs with each delay do not explain."""
    left = {}
    for delay in map(float, delays):
        pairs = _pairs(motions, h, delay)
        share = explained_power(pairs, _coordinates(angular), h, driven=True) if pairs else None
        if share is not None:
            left[round(delay, 4)] = 1.0 - share
    return left


def _inertia(
    pairs: Sequence[Motion], angular: np.ndarray, h: float, input_matrix: np.ndarray
) -> float:
    """Return the inertia that the inputs move, that of the lightest coordinates.

    A training that starts with too much inertia does not find its way: the accelerations due to the
    inputs are then lost among those of the potential and of friction.
    """
    gains = input_gains(pairs, _coordinates(angular), h)
    assert gains is not None
    size = float(np.linalg.norm(gains))
    return float(np.linalg.norm(input_matrix)) / size if size > 0 else 1.0


def _stiffness(
    pairs: Sequence[Motion], angular: np.ndarray, h: float, inertia: float
) -> tuple[tuple[float, ...], ...] | None:
    """Return the stiffness of springs at that inertia, ``None`` if they explain little.

    Training does not find springs from none within some tens of epochs: the inertia of what they
    move falls instead.
    """
    found = spring_slopes(pairs, _coordinates(angular), h) if pairs else None
    if found is None or found[0] > SPRUNG:
        return None
    stiffness = -0.5 * inertia * (found[1] + found[1].T)
    return tuple(tuple(float(f"{x:.3g}") for x in row) for row in stiffness)


def _pairs(motions: Sequence[Sampled], h: float, delay: float) -> list[Motion]:
    """Return configurations and inputs, which act ``delay`` after their record, at the nodes."""
    return [
        (q, averaged(samples.t, delayed(samples, delay).u, nodes, h))
        for samples, nodes, q in motions
    ]


def _coordinates(angular: np.ndarray) -> Coordinates:
    return Coordinates(tuple(map(str, range(len(angular)))), tuple(map(bool, angular)))


def _delay(left: Mapping[float, float]) -> tuple[float, str]:
    """Return the delay with which inputs explain most, if it is much, and a line about it."""
    if 0.0 not in left:
        return 0.0, "inputs: too few nodes to tell their delay"
    best = min(left, key=lambda delay: left[delay])
    if best != 0.0 and left[best] <= (1.0 - GAIN) * left[0.0]:
        return best, (
            f"inputs: {100 * (1 - left[best]):.3g} % of the accelerations' power is explained with "
            f"a delay of {1e3 * best:g} ms, {100 * (1 - left[0.0]):.3g} % without"
        )
    return 0.0, f"inputs: no delay; {100 * (1 - left[0.0]):.3g} % of the power is explained"
