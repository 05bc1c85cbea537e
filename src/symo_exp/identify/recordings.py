"""Properties of a machine that are inferred from its recordings before training."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from symo_exp.data.advice import Columns, omitting
from symo_exp.data.diagnose import POOR, ROUNDING, SUSPECT, noise_of, quasi_coordinates
from symo_exp.data.folds import any_moves, at_rest
from symo_exp.data.formats import few, shown
from symo_exp.data.header import header
from symo_exp.data.naming import ANGLE, SLIDE, in_degrees, length_unit, names
from symo_exp.data.parts import divided, uninterrupted, with_every_part, without
from symo_exp.data.recorded import in_radians, refuse_counts, turned, unwrapped
from symo_exp.data.table import Recording, read_recordings
from symo_exp.errors import ConfigError
from symo_exp.identify.motions import (
    STEPS,
    Dynamics,
    Shock,
    dynamics,
    explained_by_angles,
    fitting_time_step,
    reversed_inputs,
    struck,
)
from symo_exp.mechanics.types import Coordinates
from symo_exp.shell import override_value
from symo_exp.systems.base import System
from symo_exp.systems.recorded import Recorded

SPAN = 2 * np.pi
"""Range of a coordinate beyond which it is an angle."""
WHOLE = 0.3
"""Distance of a jump from a whole turn, over a turn, up to which an angle is wrapped."""
TOGETHER, SMALL = 3.0, 0.1
"""Distance of two coordinates in a constant ratio over their noise, and over their motion, up to
which they are one."""


@dataclass(frozen=True, kw_only=True)
class Machine(Dynamics):
    """A recorded machine: its dynamics, and what else its candidates depend on.

    Args:
        coordinates: Its coordinates.
        driven: Whether any input is not zero.
        time_step: That of the candidates [s].
        finest_step: Distance of the samples [s], the largest over recordings.
        seconds: Length of the training and validation part [s].
        recordings: How many there are in these parts that are not at rest.
        moves: Whether any coordinate moves by more than its noise.
        body: Whether it is a single rigid body that turns freely, and may move.
        learned_inputs: Number of inputs of a body whose matrix is learned; 0: it is given, or there
            are none.
        known: Whether its equations are known, but for their constants.

    The other arguments are those of ``Dynamics``; ``settings`` and ``notes`` are those of the whole
    machine.
    """

    coordinates: Coordinates
    driven: bool
    time_step: float
    finest_step: float
    seconds: float
    recordings: int
    moves: bool
    body: bool = False
    learned_inputs: int = 0
    known: bool = False

    @property
    def nodes(self) -> int:
        """Nodes of the training and validation parts."""
        return max(1, round(self.seconds / self.time_step))


def examine(
    data: Mapping[str, Any],
    *,
    angular: Any = None,
    input_matrix: Any = None,
    time_step: float | None = None,
    rotations: Sequence[str] = (),
    known: System | None = None,
) -> Machine:
    """Read recordings and infer what is not given.

    Args:
        data: Settings of ``RecordedData``, those of files, columns, units and parts.
        angular: As ``system.angular``; ``None``: by names and ranges.
        input_matrix: As ``system.input_matrix``; ``None``: by names.
        time_step: As ``system.time_step``; ``None``: by the fastest motion.
        rotations: As ``system.rotations``; none: by the names of quaternions.
        known: The system, if its equations are known; it has the coordinates and the inputs.

    Raises:
        ConfigError: If something can neither be read nor inferred.
    """
    path, columns = data["path"], data.get("columns")
    found = header(path, columns)
    coordinates, inputs = names("q", found), names("u", found)
    settings, notes = [], []
    if known is not None:
        coordinates, inputs = known.coordinates.measured, tuple(known.inputs)
        flat, turning = known.coordinates.flat, known.coordinates.angular
        angular = [name for name, angle in zip(flat, turning, strict=False) if angle] or "none"
        input_matrix, rotations = known.input_matrix.tolist(), known.coordinates.rotations
    given = input_matrix
    if not rotations and (rotations := _quaternions(coordinates)):
        settings.append(f"system.rotations={override_value(list(rotations))}")
        notes.append(f"rotations: {', '.join(rotations)}, each a quaternion, by their names")
    alone = Recorded(names=coordinates, rotations=rotations, angular="none", time_step=1.0)
    flat, freedoms = alone.coordinates.flat, alone.coordinates.names
    body = known is None and len(rotations) == 1 and len(flat) in (0, 3)
    learned_inputs = 0
    if given is None and (inferred := _inferred_matrix(freedoms, inputs, body)) is not None:
        input_matrix, line = inferred
        learned_inputs = 0 if np.any(input_matrix) else len(inputs)
        settings.append(f"system.input_matrix={str(input_matrix).replace(' ', '')}")
        notes.append(line)

    def system(which: Any) -> Recorded:
        return Recorded(
            names=coordinates, rotations=rotations, angular=which, inputs=inputs,
            input_matrix=input_matrix, time_step=1.0,
        )  # fmt: skip

    used, test, starts, told = _parts(data, system("none"), time_step)
    notes += told
    recordings = len(used)
    if still := [one.label for one, rests in zip(used, at_rest(used), strict=True) if rests]:
        recordings -= len(still)
        notes.append(f"at rest, for training only: {few(still)}")
    if angular is None:
        which = [_is_angle(name, [r.samples.q[:, i] for r in used]) for i, name in enumerate(flat)]
    else:
        which = list(system(angular).coordinates.angular)[: len(flat)]
    chosen = [name for name, angle in zip(flat, which, strict=True) if angle]
    if chosen and learned_inputs:  # the machine is more than a body
        input_matrix = None
    space = system(chosen or "none").coordinates  # or asks for the matrix
    if angular is None:
        settings.append(f"system.angular={override_value(chosen) if chosen else 'none'}")
        notes += _told(chosen, flat) if flat else []
    stated = [name for name in chosen if in_degrees(name)]
    if data.get("degrees") is None and 0 < len(stated) < len(chosen):
        raise ConfigError(
            f"data.degrees has no value yet: {few(stated)} is in degrees by its name, but not "
            f"every one of {few(chosen)}; give data.degrees=true if all are, else convert it in "
            "the file"
        )
    if data.get("degrees") is None and stated:
        settings.append("data.degrees=true")
        notes.append("angles are in degrees, as their names say")
        data = {**data, "degrees": True}
    refuse_counts(shown(path), space, used, data.get("degrees"))
    if units := _jumps(used, space, data):
        settings += [f"data.{name}=true" for name in units]
        notes.append(f"angles jump by a turn: read with {' '.join(settings[-len(units) :])}")
        data = {**data, **dict.fromkeys(units, True)}
    used = [_continuous(one, space, data) for one in used]
    notes += _told_still(used, flat, columns)
    notes += _told_together(used, flat, columns)
    if data.get("degrees") is None and not rotations:
        _ask_for_degrees(used, space)
    if angular is None and not rotations:
        _ask_for_angles(used, space)
    finest = max(one.samples.step for one in (*used, *test))
    used = [_turned(shown(path), one, space) for one in used]
    if time_step is None:
        paths = [_along(one, space) for one in used]
        time_step = fitting_time_step(paths, Coordinates(space.names, space.turning), finest)
        settings.append(f"system.time_step={time_step:g}")
        notes.append(f"time step: {time_step:g} s, samples every {finest:.3g} s")
    _, note = uninterrupted([*used, *test], time_step)
    notes += [note] if note else []
    used, _ = uninterrupted(used, time_step)
    if data.get("leave_out") is None and (hit := struck(used, space, time_step)):
        stretches = [_in_table(one, starts) for one in hit]
        settings.append(f"data.leave_out={override_value(stretches)}")
        notes.append(_told_shocks(stretches))
        data = {**data, "leave_out": stretches}
        used, *_ = _parts(data, system("none"), time_step)
        used, _ = uninterrupted([_continuous(one, space, data) for one in used], time_step)
    driven = any(bool(one.samples.u.any()) for one in used)
    matrix = system("none").input_matrix.numpy() if driven else None
    if matrix is not None and (against := reversed_inputs(used, space, time_step, matrix)).any():
        matrix = np.where(against, -matrix, matrix) + 0.0
        acting = [f"u_{name}" for name, x in zip(inputs, against, strict=True) if x]
        if known is not None:
            raise ConfigError(
                f"{shown(path)}: {few(acting)} acts in the other direction than the system's "
                "equations say; change the sign of its gear in the model, or of the column"
            )
        mended = f"system.input_matrix={str(matrix.tolist()).replace(' ', '')}"
        settings += [mended] if given is None else []
        notes.append(f"inputs: {few(acting)} acts in the other direction; {mended}")
    shown_by = dynamics(used, space, time_step, matrix, known=known is not None)
    lists = {
        "settings": (*settings, *shown_by.settings),
        "notes": (*notes, *shown_by.notes),
    }
    return Machine(
        **vars(shown_by) | lists,
        coordinates=space,
        driven=driven,
        time_step=time_step,
        finest_step=finest,
        seconds=sum(one.samples.seconds for one in used),
        recordings=recordings,
        moves=any_moves(used),
        body=body and not chosen,
        learned_inputs=learned_inputs,
        known=known is not None,
    )


def _quaternions(names: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the rotations whose quaternions are among the columns."""
    stems = [name.removesuffix("_w") for name in names if name.endswith("_w")]
    return tuple(stem for stem in stems if {f"{stem}_{part}" for part in "wxyz"} <= set(names))


def _turned(where: str, recording: Recording, space: Coordinates) -> Recording:
    """Return a recording with rotation matrices instead of quaternions."""
    where = f"{where}: trajectory {recording.label}"
    return recording._replace(samples=turned(where, recording.samples, space))


def _along(recording: Recording, space: Coordinates) -> Recording:
    """Return a recording of the sums of the turns of rotations (``quasi_coordinates``)."""
    samples = recording.samples
    return recording._replace(samples=samples._replace(q=quasi_coordinates(samples.q, space)))


def _parts(
    data: Mapping[str, Any], system: Recorded, time_step: float | None
) -> tuple[list[Recording], list[Recording], dict[str, float], list[str]]:
    """Return the recordings for training and validation, those for testing, and lines on both.

    The third result is the time of the first sample of each trajectory of the table.
    """
    path = data["path"]
    table = read_recordings(path, system, data.get("columns"), data.get("time_unit"))
    named = {part: data.get(part) for part in ("train", "val", "test")}
    counts = data.get("n_val"), data.get("n_test")
    recordings, notes, note = list(table.recordings), list(table.notes), None
    starts = {one.label: float(one.samples.t[0]) for one in recordings}
    if data.get("leave_out") is not None:
        recordings = list(without(recordings, data["leave_out"], time_step or STEPS[0]))
    if all(given is None for given in (*named.values(), *counts)):
        finest = min(one.samples.step for one in recordings)
        recordings, note = with_every_part(recordings, time_step or min(STEPS[0], finest))
        notes += [note] if note else []
    parts = divided(shown(path), recordings, named, *counts)
    used = [*parts["train"], *parts["val"]]
    if not note:
        tested = few([one.label for one in parts["test"]])
        notes.append(f"recordings: {len(used)} to choose and train models, for the test {tested}")
    return used, parts["test"], starts, notes


def _in_table(shock: Shock, starts: Mapping[str, float]) -> tuple[str, float, float]:
    """Return the trajectory of the table that a shock is in, and its times after the start."""
    label, low, high = shock
    whole = [name for name in starts if name in ("", label) or label.startswith(f"{name}/")]
    name = max(whole, key=len)  # pieces have the name of the trajectory first
    return name, round(low - starts[name], 4), round(high - starts[name], 4)


def _told_shocks(stretches: Sequence[tuple[str, float, float]]) -> str:
    where = few([f"{name} {low:g} to {high:g} s".lstrip() for name, low, high in stretches])
    return (
        f"left out: {where}; something else moved the machine there, as the same states at other "
        "times show (data.leave_out=[] keeps all)"
    )


def _continuous(recording: Recording, space: Coordinates, data: Mapping[str, Any]) -> Recording:
    """Return a recording whose angles are in radians and go on beyond a turn."""
    samples = recording.samples
    if data.get("degrees"):
        samples = in_radians(samples, space)
    if data.get("wrapped"):
        samples = unwrapped(samples, space)
    return recording._replace(samples=samples)


def _jumps(
    recordings: Sequence[Recording], space: Coordinates, data: Mapping[str, Any]
) -> tuple[str, ...]:
    """Return the settings of data with which angles that jump by a turn are read."""
    columns = [r.samples.q[:, i] for r in recordings for i in np.flatnonzero(space.angular)]
    if data.get("wrapped") is not None or not columns:
        return ()
    if not data.get("degrees") and _wraps(columns, 2 * np.pi):
        return ("wrapped",)
    if _wraps(columns, 360.0):
        return ("wrapped",) if data.get("degrees") else ("degrees", "wrapped")
    return ()


def _wraps(columns: Sequence[np.ndarray], turn: float) -> bool:
    """Return whether steps that change by more than half a turn do by nearly a whole one."""
    steps = np.concatenate([np.abs(np.diff(x, 2)) for x in columns])
    jumps = steps[steps > 0.5 * turn]
    return bool(jumps.size and (np.abs(jumps - turn) < WHOLE * turn).all())


def _ask_for_degrees(recordings: Sequence[Recording], space: Coordinates) -> None:
    """Refuse angles whose motion is explained much better if their numbers are degrees."""
    if wide := _beyond_a_turn(recordings, space, angular=True):
        plain, degrees = explained_by_angles(recordings, space)
        readings = {"degrees": degrees, "radians": plain}
        _ask("data.degrees", "true or false", wide, readings)


def _ask_for_angles(recordings: Sequence[Recording], space: Coordinates) -> None:
    """Refuse lengths, by their names, whose motion is explained much better if they are angles."""
    if wide := _beyond_a_turn(recordings, space, angular=False):
        every = zip(space.names, space.angular, strict=True)
        other = space._replace(angular=tuple(angle or name in wide for name, angle in every))
        shares = (explained_by_angles(recordings, x)[0] for x in (other, space))
        readings = dict(zip(("angles [rad]", "lengths"), shares, strict=True))
        _ask("system.angular", "all, none or a list of names", wide, readings)


def _beyond_a_turn(
    recordings: Sequence[Recording], space: Coordinates, *, angular: bool
) -> dict[str, float]:
    """Return the ranges of the angles, or the lengths, that are larger than ``SPAN``."""
    ranges = np.max([np.ptp(one.samples.q, axis=0) for one in recordings], axis=0)
    every = zip(space.names, space.angular, ranges, strict=True)
    return {name: size for name, angle, size in every if angle == angular and size > SPAN}


def _ask(
    setting: str, choices: str, ranges: Mapping[str, float], readings: Mapping[str, float | None]
) -> None:
    """Refuse a setting that is left open if another reading explains a motion much better.

    Args:
        setting: Its name.
        choices: Its values.
        ranges: Ranges of the coordinates in question.
        readings: Explained share of the accelerations' power by another reading and the present.
    """
    (reading, other), (present, plain) = readings.items()
    if plain is None or other is None or plain > POOR or not 1 - other < SUSPECT * (1 - plain):
        return
    told = ", ".join(f"q_{name} moves by {size:.3g}" for name, size in ranges.items())
    raise ConfigError(
        f"{setting} has no value yet: {told}; {100 * other:.3g} % of the accelerations' power is "
        f"explained if these are {reading}, {100 * plain:.3g} % if they are {present}; give "
        f"{setting}={choices}"
    )


def _told_still(
    recordings: Sequence[Recording], names: Sequence[str], columns: Columns | None
) -> list[str]:
    """Return a line on the lengths and angles that never move, if others or a rotation do."""
    motion = np.max([np.ptp(one.samples.q, axis=0) for one in recordings], axis=0)
    still = [f"q_{name}" for name, size in zip(names, motion, strict=False) if size == 0.0]
    if not 0 < len(still) < len(motion):
        return []
    told = "never moves" if len(still) == 1 else "never move"
    mend = omitting(still, columns)
    return [f"{few(still)} {told}; for a model without such a coordinate, give {mend}"]


def _told_together(
    recordings: Sequence[Recording], names: Sequence[str], columns: Columns | None
) -> list[str]:
    """Return a line on the lengths and angles that are in a constant ratio to an earlier one."""
    noise = [noise_of([one.samples.q[:, i] for one in recordings]) for i in range(len(names))]
    about = np.concatenate([one.samples.q - one.samples.q.mean(axis=0) for one in recordings])
    found = {}
    for i, j in itertools.combinations(range(len(names)), 2):
        x, y = about[:, i], about[:, j]
        if names[j] in found or not (x.any() and y.any()):
            continue
        ratio = float(x @ y / (x @ x))
        apart = float(np.std(y - ratio * x))
        most = TOGETHER * math.hypot(noise[j], ratio * noise[i]) + ROUNDING * float(np.ptp(y))
        if apart <= most and apart <= SMALL * float(np.std(y)):
            found[names[j]] = f"q_{names[j]} is {ratio:.3g} times q_{names[i]}"
    if not found:
        return []
    mend = omitting([f"q_{name}" for name in found], columns)
    return [
        f"{few(list(found.values()))}, but for noise: a gear joins them, or one is what the other "
        f"should be; for a model without such a coordinate, give {mend}"
    ]


def _inferred_matrix(
    coordinates: tuple[str, ...], inputs: tuple[str, ...], body: bool
) -> tuple[list[list[int]], str] | None:
    """Return the matrix of inputs and a line on it, ``None`` where nothing tells it.

    Inputs with the names of coordinates drive these. The matrix of a ``body`` that turns freely is
    zero, and is to be learned. No inputs, or one for each coordinate, need no matrix.
    """
    if not inputs or inputs == coordinates:
        return None
    if set(inputs) <= set(coordinates):
        pairs = ", ".join(f"u_{name} drives q_{name}" for name in inputs)
        matrix = [[int(name == other) for other in inputs] for name in coordinates]
        return matrix, f"inputs: {pairs}, by their names"
    learned = (
        "inputs: the forces and torques that they cause are learned, in body axes, so that the "
        "inertia is known up to a factor (system.input_matrix=... gives them)"
    )
    return ([[0] * len(inputs) for _ in coordinates], learned) if body else None


def _is_angle(name: str, columns: Sequence[np.ndarray]) -> bool:
    """Return whether a coordinate is an angle; refuse one whose name and range do not tell."""
    words = re.split(r"[^a-z]+", name.lower())
    if in_degrees(name) or any(re.fullmatch(ANGLE, word) for word in words):
        return True
    if any(re.fullmatch(SLIDE, word) for word in words):
        return False
    low, high = min(x.min() for x in columns), max(x.max() for x in columns)
    if high - low > SPAN or _wraps(columns, 2 * np.pi):
        return True
    raise ConfigError(
        f"system.angular has no value yet: is q_{name}, which goes from {low:.3g} to {high:.3g}, "
        f"an angle [rad] or a position [m]? Give system.angular=all, none or a list, as [{name}]"
    )


def _told(chosen: Sequence[str], all_names: Sequence[str]) -> list[str]:
    """Return a line on which coordinates are angles, and one on lengths in other units than m."""
    kinds = dict.fromkeys(chosen, "angles [rad]")
    positions = [name for name in all_names if name not in chosen]
    kinds |= {name: f"positions [{length_unit(name)}]" for name in positions}
    groups = {kind: [x for x in kinds if kinds[x] == kind] for kind in kinds.values()}
    parts = "; ".join(f"{kind}: {', '.join(group)}" for kind, group in groups.items())
    lines = [f"{parts} (by names and ranges; system.angular says otherwise)"]
    if odd := [name for name in positions if length_unit(name) != "m"]:
        lines.append(
            f"lengths of {few(odd)} are used as they are: where results say m, they are in "
            f"{length_unit(odd[0])}; convert them in the file for results in SI units"
        )
    return lines
