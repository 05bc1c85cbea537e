"""Properties of a machine that are inferred from its recordings before training."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np

from symo_exp.data.delays import acting_as_given
from symo_exp.data.folds import any_moves, at_rest
from symo_exp.data.header import header
from symo_exp.data.naming import names, unit_of
from symo_exp.data.parts import PARTS, divided, uninterrupted, without
from symo_exp.data.paths import few, shown, titled
from symo_exp.data.resample import TIME_TOLERANCE
from symo_exp.data.sensors import noise_of
from symo_exp.data.table import Recording, RecordingTable, read_recordings
from symo_exp.data.turns import continuous, refuse_counts, turned
from symo_exp.errors import ConfigError
from symo_exp.identify.angles import (
    ask_for_angles,
    ask_for_degrees,
    ask_which_turn,
    is_angle,
    told_units,
    turn_settings,
)
from symo_exp.identify.dynamics import Dynamics, dynamics
from symo_exp.identify.inputs import ACTING, reversed_inputs
from symo_exp.identify.left_out import REASONS, Stretch
from symo_exp.identify.pace import STEPS, fitting_time_step
from symo_exp.identify.remarks import Remarks
from symo_exp.identify.sampled import along_turns
from symo_exp.mechanics.types import Coordinates
from symo_exp.mechanics.units import Units
from symo_exp.shell import override_value
from symo_exp.systems.base import System
from symo_exp.systems.recorded import (
    Recorded,
    matrix_by_names,
    matrix_setting,
    quaternions,
    without_unit,
)

Stiffness = tuple[tuple[float, ...], ...]
REMOTE = 20.0
"""Distance of a length from zero, over its range, beyond which it is counted from its middle."""
SPARSE = 1.5
"""Distance of samples, over that of most recordings, from which a recording is named."""
UNSEEN = 1e-3
"""Share of a motion, of angles at most of 1 rad, up to which errors may be those of integrators."""
TOO_FAR, MOVES = 1e4, 20.0
"""That beyond which trainings lose too many digits, and the range over the noise of what moves."""


@dataclass(frozen=True, kw_only=True)
class Machine(Dynamics):
    """A recorded machine: its dynamics, and what else its candidates depend on.

    Args:
        coordinates: Its coordinates.
        driven: Whether any input is not zero.
        time_step: That of the candidates [s].
        finest_step: Distance of the samples [s], the largest over recordings.
        seconds: Length of the training and validation part [s].
        gap: Longest distance of the samples of this part [s], without those at which it is cut.
        recordings: How many there are in these parts that are not at rest.
        moves: Whether any coordinate moves by more than its noise.
        body: Whether it is a single rigid body that turns freely, and may move.
        learned_inputs: Number of inputs of a body whose matrix is learned; 0: it is given, or there
            are none.
        known: Whether its equations are known, but for their constants.
        unseen: Errors of a fit that say nothing against it, root mean square over lengths and
            angles: their noise, or ``UNSEEN`` of their motion if that is more, in ``units``.

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
    gap: float = 0.0
    body: bool = False
    learned_inputs: int = 0
    known: bool = False
    unseen: float = 0.0

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
    scale: Mapping[str, float] = MappingProxyType({}),
    known: System | None = None,
) -> Machine:
    """Read recordings and infer what is not given.

    Args:
        data: Settings of ``RecordedData``, those of files, columns, units, parts and when inputs
            act.
        angular: As ``system.angular``; ``None``: by names and ranges.
        input_matrix: As ``system.input_matrix``; ``None``: by names.
        time_step: As ``system.time_step``; ``None``: by the fastest motion.
        rotations: As ``system.rotations``; none: by the names of quaternions.
        scale: Units of ``system.scale`` that are given; others by the motion and the inputs.
        known: The system, if its equations are known; it has the coordinates and the inputs.

    Raises:
        ConfigError: If something can neither be read nor inferred.
    """
    if known is not None:
        flat, turning = known.coordinates.flat, known.coordinates.angular
        angular = [name for name, angle in zip(flat, turning, strict=False) if angle] or "none"
        input_matrix, rotations = known.input_matrix.tolist(), known.coordinates.rotations
    given = dict(data), angular, input_matrix, time_step, rotations, scale, known
    return _Examination(*given).machine()


@dataclass
class _Examination:
    """The steps of ``examine``, whose arguments it has: each infers what is not given.

    ``settings`` and ``notes`` grow with every step, and ``used``, the recordings for training and
    validation, become what a model is trained on.
    """

    data: dict[str, Any]
    angular: Any
    input_matrix: Any
    time_step: float | None
    rotations: Sequence[str]
    scale: Mapping[str, float]
    known: System | None
    settings: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    used: list[Recording] = field(init=False)
    test: list[Recording] = field(init=False)
    header: list[str] = field(init=False)  # names of all columns
    moving: int = field(init=False)  # how many of ``used`` are not at rest
    angles: list[str] = field(init=False)
    space: Coordinates = field(init=False)
    remote: np.ndarray = field(init=False)  # which coordinates are lengths far from zero
    written: dict[str, str] = field(init=False)  # by coordinate: the name that states its unit

    def __post_init__(self) -> None:
        self.columns, self.where = self.data.get("columns"), shown(self.data["path"])
        self.matrix_is_given = self.input_matrix is not None
        self.header = header(self.data["path"], self.columns)
        self.names, self.inputs = names("q", self.header), names("u", self.header)
        if self.known is not None:
            self.names, self.inputs = self.known.coordinates.measured, tuple(self.known.inputs)

    def machine(self) -> Machine:
        """Take all steps and return the machine."""
        self._name_rotations_and_inputs()
        self._divide(self.time_step)
        self._tell_angles()
        self._ask_for_matrix()
        self._read_units()
        self.notes += self._divide(self.time_step, self.space)  # rests depend on the units
        self._tell_rest()
        remarks = Remarks(self.used, self.space, self.inputs, self.header, self.columns)
        self.notes += [*remarks.on_coordinates(), *remarks.on_velocities()]
        self.notes += remarks.on_idle_inputs() if self.known is None else ()
        self.notes += remarks.on_units_of_inputs()
        finest = max(one.samples.step for one in (*self.used, *self.test))
        self.used = self._near()
        time_step = self._choose_time_step(finest)
        self._leave_out(time_step)
        driven = any(bool(one.samples.u.any()) for one in self.used)
        matrix = self._direct_inputs(time_step) if driven else None
        known = self.known is not None
        shown_by = dynamics(
            self.used, self.space, time_step, matrix,
            scale=self.scale, known=known, acting=[x for x in ACTING if not self._is_open(x)],
        )  # fmt: skip
        lists = {
            "settings": (*self.settings, *shown_by.settings),
            "notes": (*self.notes, *shown_by.notes),
            "stiffness": self._starting(shown_by.stiffness),
        }
        return Machine(
            **vars(shown_by) | lists,
            coordinates=self.space,
            driven=driven,
            time_step=time_step,
            finest_step=finest,
            seconds=sum(one.samples.seconds for one in self.used),
            gap=max(float(np.diff(one.samples.t).max()) for one in self.used),
            recordings=self.moving,
            moves=any_moves(self.used),
            body=self.body and not self.angles,
            learned_inputs=self.learned_inputs,
            known=known,
            unseen=self._unseen(shown_by.units),
        )

    def _unseen(self, units: Units) -> float:
        """Return ``Machine.unseen``."""
        squares = []
        for i, angle in enumerate(self.space.angular[: len(self.flat)]):
            columns = [one.samples.q[:, i] for one in self.used]
            motion = float(np.std(np.concatenate(columns)))
            size = np.fmax(noise_of(columns), UNSEEN * (min(motion, 1.0) if angle else motion))
            squares.append((size if angle else size / units.length) ** 2)
        return math.sqrt(np.mean(squares)) if squares else 0.0

    def _system(self, angular: Any, matrix: Any = None) -> Recorded:
        return Recorded(
            names=self.names, rotations=self.rotations, angular=angular, inputs=self.inputs,
            input_matrix=self.input_matrix if matrix is None else matrix, time_step=1.0,
        )  # fmt: skip

    def _alone(self, angular: Any) -> Recorded:
        """Return the system without its inputs."""
        return Recorded(names=self.names, rotations=self.rotations, angular=angular, time_step=1.0)

    def _name_rotations_and_inputs(self) -> None:
        """Infer ``rotations`` and ``input_matrix`` from the names of the columns."""
        if not self.rotations and (found := quaternions(self.names)):
            self.rotations = found
            self.settings.append(f"system.rotations={override_value(list(found))}")
            self.notes.append(f"rotations: {', '.join(found)}, each a quaternion, by their names")
        alone = self._alone("none").coordinates
        self.flat, given = alone.flat, self.columns or {}
        files = {name: str(given.get(f"q_{name}") or name) for name in self.flat}
        self.written = {name: file if unit_of(file) else name for name, file in files.items()}
        self.body = self.known is None and len(self.rotations) == 1 and len(self.flat) in (0, 3)
        self.learned_inputs = 0
        if not self.matrix_is_given:
            self._infer_matrix(alone.names)

    def _infer_matrix(self, coordinates: tuple[str, ...]) -> None:
        """Infer the matrix of the inputs, where anything tells it.

        Inputs with the names of coordinates, units apart, drive these. The matrix of a body that
        turns freely is zero, and is to be learned. No inputs, or one for each coordinate, need no
        matrix.
        """
        inputs = self.inputs
        if not inputs or [*map(without_unit, inputs)] == [*map(without_unit, coordinates)]:
            return
        if found := matrix_by_names(coordinates, inputs):
            driven = [coordinates[row.index(1)] for row in zip(*found, strict=True)]
            pairs = [f"u_{x} drives q_{y}" for x, y in zip(inputs, driven, strict=True)]
            self.notes.append(f"inputs: {', '.join(pairs)}, by their names")
        elif self.body:
            found, self.learned_inputs = [[0] * len(inputs) for _ in coordinates], len(inputs)
            self.notes.append(
                "inputs: the forces and torques that they cause are learned, in body axes, so that "
                "the inertia is known up to a factor (system.input_matrix=... gives them)"
            )
        else:
            return
        self.input_matrix = found
        self.settings.append(matrix_setting(found))

    @cached_property
    def table(self) -> RecordingTable:
        """The whole table, whose inputs act as they are given."""
        everything = [[1.0] * len(self.inputs) for _ in self._alone("none").coordinates.names]
        system = self._system("none", everything)  # to read them, it does not matter
        how = (self.data.get(name) for name in ("columns", "time_unit", "sample_time"))
        found = read_recordings(self.data["path"], system, *how)
        acting = (self.data.get(name) for name in ACTING)
        return found._replace(recordings=tuple(acting_as_given(found.recordings, *acting)))

    def _divide(self, time_step: float | None, space: Coordinates | None = None) -> list[str]:
        """Divide the table into ``used`` and ``test``, and return lines on them.

        With the coordinates ``space``, angles are in radians and continuous, otherwise as recorded.
        """
        data = self.data
        named = {part: data.get(part) for part in PARTS}
        recordings: Sequence[Recording] = self.table.recordings
        # until it is chosen, the time step is as small as samples allow
        step = time_step or max((one.samples.step for one in recordings), default=STEPS[0])
        if space is not None:
            recordings = self._continuous(recordings, space)
        if data.get("leave_out") is not None:
            recordings = without(recordings, data["leave_out"], step)
        counts = data.get("n_val"), data.get("n_test")
        parts, _, note = divided(self.where, recordings, named, *counts, step)
        self.used, self.test = [*parts["train"], *parts["val"]], parts["test"]
        if note is None:
            count, tested = len(self.used), few([one.label for one in self.test])
            note = f"recordings: {count} to choose and train models; for the test: {tested}"
        return [*self.table.notes, note]

    def _tell_rest(self) -> None:
        """Count the recordings that move, and tell of those at rest."""
        rest = at_rest(self.used)
        self.moving = rest.count(False)
        if still := [one.label for one, rests in zip(self.used, rest, strict=True) if rests]:
            self.notes.append(f"at rest, for training only: {few(still)}")

    def _tell_angles(self) -> None:
        """Infer which coordinates are angles."""
        which: Sequence[bool | None]
        columns = {
            name: [one.samples.q[:, i] for one in self.used] for i, name in enumerate(self.flat)
        }
        if self.angular is None:
            kinds = {name: is_angle(name, self.written[name], x) for name, x in columns.items()}
            ask_which_turn(kinds, columns)
            which = list(kinds.values())
        else:
            which = list(self._alone(self.angular).coordinates.angular)[: len(self.flat)]
        self.angles = [name for name, angle in zip(self.flat, which, strict=True) if angle]
        self.space = self._alone(self.angles or "none").coordinates
        if self.angular is None:
            chosen = override_value(self.angles) if self.angles else "none"
            self.settings.append(f"system.angular={chosen}")
            self.notes += told_units(self.angles, self.written, columns) if columns else []

    def _ask_for_matrix(self) -> None:
        """Refuse inputs of which nothing tells how they drive the coordinates.

        The refusal also says if other coordinates are needed, for which it is another question, and
        which inputs never act.
        """
        if self.angles and self.learned_inputs:  # the machine is more than a body
            self.input_matrix = None
        try:
            self._system(self.angles or "none")
        except ConfigError as error:
            remarks = Remarks(self.used, self.space, self.inputs, self.header, self.columns)
            more = [*remarks.on_circles(), *remarks.on_idle_inputs()]
            raise ConfigError("; ".join([str(error), *more])) from error

    def _read_units(self) -> None:
        """Infer whether angles are in degrees and wrapped.

        Units and angles that are open are refused where another reading explains far more.
        """
        stated = [name for name in self.angles if unit_of(self.written[name]) == "deg"]
        if self._is_open("degrees") and 0 < len(stated) < len(self.angles):
            raise ConfigError(
                f"data.degrees has no value yet: {few(stated)} is in degrees by its name, but not "
                f"every one of {few(self.angles)}; give data.degrees=true if all are, else convert "
                "it in the file"
            )
        if self._is_open("degrees") and stated:
            self.settings.append("data.degrees=true")
            self.notes.append("angles are in degrees, as their names say")
            self.data["degrees"] = True
        refuse_counts(self.where, self.space, self.used, self.data.get("degrees"))
        if units := turn_settings(self.used, self.space, self.data):
            settings = [f"data.{name}=true" for name in units]
            self.settings += settings
            self.notes.append(f"angles jump by a turn: read with {' '.join(settings)}")
            self.data |= dict.fromkeys(units, True)
        found = self._continuous(self.used, self.space)
        if self._is_open("degrees") and not self.rotations:
            ask_for_degrees(found, self.space)
        if self.angular is None and not self.rotations:
            ask_for_angles(found, self.space)

    def _continuous(self, recordings: Sequence[Recording], space: Coordinates) -> list[Recording]:
        """Return recordings with angles in radians that go on beyond a turn."""
        how = {name: bool(self.data.get(name)) for name in ("degrees", "wrapped")}
        return continuous(recordings, space, **how)

    def _is_open(self, name: str) -> bool:
        """Return whether a setting of data has no value yet."""
        return self.data.get(name) is None

    def _near(self) -> list[Recording]:
        """Return ``used`` with rotation matrices and lengths near zero; regressions lose no digits.

        Raises:
            ConfigError: If a length is so far from zero that trainings would lose too many.
        """
        every = np.concatenate([one.samples.q for one in self.used])
        low, high = every.min(axis=0), every.max(axis=0)
        middle, size = (low + high) / 2, high - low
        far = (size > 0.0) & (np.abs(middle) > REMOTE * size)
        far[[i for i in range(len(far)) if i >= len(self.flat) or self.space.angular[i]]] = False
        for i in np.flatnonzero(far & (np.abs(middle) > TOO_FAR * size)):
            if size[i] > MOVES * noise_of([one.samples.q[:, i] for one in self.used]):
                raise ConfigError(
                    f"q_{self.flat[i]} goes from {low[i]:.9g} to {high[i]:.9g}, too far from zero "
                    "for its motion; subtract its first value from all of them in the file"
                )
        self.remote = far[: len(self.flat)]
        shift = np.where(far, middle, 0.0)
        moved = [one.samples._replace(q=one.samples.q - shift) for one in self.used]
        return [
            one._replace(samples=turned(f"{self.where}: {titled(one.label)}", samples, self.space))
            for one, samples in zip(self.used, moved, strict=True)
        ]

    def _starting(self, stiffness: Stiffness | None) -> Stiffness | None:
        """Return a stiffness to start from, zero where its force at the place would be huge."""
        if stiffness is None:
            return None
        near = np.outer(~self.remote, ~self.remote)
        return tuple(map(tuple, np.where(near, stiffness, 0.0).tolist()))

    def _choose_time_step(self, finest: float) -> float:
        """Return the time step, and leave out stretches without samples for it."""
        found = self.time_step
        if found is None:
            paths = [along_turns(one, self.space) for one in self.used]
            turns = Coordinates(self.space.names, self.space.turning)
            found = fitting_time_step(paths, turns, finest)
            self.settings.append(f"system.time_step={found:g}")
            self.notes.append(f"time step: {found:g} s, samples every {finest:.3g} s")
            steps = {one.label: one.samples.step for one in (*self.used, *self.test)}
            usual = float(np.median(list(steps.values())))
            if odd := [label for label, step in steps.items() if step > SPARSE * usual]:
                self.notes[-1] += (
                    f" in {few(odd)}, every {usual:.3g} s in most recordings; without the former, "
                    "the time step may be shorter"
                )
        elif finest > found * (1 + TIME_TOLERANCE):
            raise ConfigError(
                f"system.time_step={found:g} is shorter than the {finest:.4g} s between samples of "
                f"{self.where}; give {finest:.4g} or more, or leave it out"
            )
        _, note = uninterrupted([*self.used, *self.test], found)
        self.notes += [note] if note else []
        self.used, _ = uninterrupted(self.used, found)
        if not self.used:
            raise self._nothing_left(note)
        return found

    def _nothing_left(self, note: str | None) -> ConfigError:
        return ConfigError(f"{self.where}: nothing is left to choose and train models; {note}")

    def _leave_out(self, time_step: float) -> None:
        """Leave out where samples do not resolve the motion or something else moves the machine.

        Stretches that are given are left out again, since how far they reach depends on the time
        step.
        """
        if not self._is_open("leave_out"):
            self._divide_again(time_step, "data.leave_out leaves pieces that are too short")
            return
        left_out: list[Stretch] = []
        for finds, reason in REASONS.items():
            found = finds(self.used, self.space, time_step)
            if not found:
                continue
            stretches = [self._in_table(one, time_step) for one in found]
            told = few([f"{name} {low:g} to {high:g} s".lstrip() for name, low, high in stretches])
            self.notes.append(f"left out: {told}; {reason} (data.leave_out=[] keeps all)")
            left_out += stretches
            self.data["leave_out"] = left_out
            self._divide_again(time_step, self.notes[-1])
        if left_out:
            self.settings.append(f"data.leave_out={override_value(left_out)}")

    def _divide_again(self, time_step: float, note: str) -> None:
        """Divide the table without what is left out; the note says why nothing may be left."""
        self._divide(time_step, self.space)
        self.used, _ = uninterrupted(self._near(), time_step)
        if not self.used:
            raise self._nothing_left(note)

    def _in_table(self, stretch: Stretch, time_step: float) -> Stretch:
        """Return the trajectory of the table that has a stretch, and its times after the start.

        Times are rounded to a tenth of a time step at most.
        """
        label, low, high = stretch
        starts = {one.label: float(one.samples.t[0]) for one in self.table.recordings}
        whole = [x for x in starts if x in ("", label) or label.startswith(f"{x}/")]
        name = max(whole, key=len)  # pieces have the name of the trajectory first
        start, digits = starts[name], max(4, 1 - math.floor(math.log10(time_step)))
        return name, round(low - start, digits), round(high - start, digits)

    def _direct_inputs(self, time_step: float) -> np.ndarray:
        """Return the matrix of the inputs, in the directions in which they act."""
        matrix = self._system("none").input_matrix.numpy()
        against = reversed_inputs(self.used, self.space, time_step, matrix)
        if not against.any():
            return matrix
        acting = few([f"u_{name}" for name, x in zip(self.inputs, against, strict=True) if x])
        if self.known is not None:
            raise ConfigError(
                f"{self.where}: {acting} acts in the other direction than the system's equations "
                "say; change the sign of its gear in the model, or of the column"
            )
        matrix = np.where(against, -matrix, matrix) + 0.0
        mended = matrix_setting(matrix.tolist())
        self.settings += [] if self.matrix_is_given else [mended]
        self.notes.append(f"inputs: {acting} acts in the other direction; {mended}")
        return matrix
