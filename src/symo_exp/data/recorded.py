"""Recordings of a real machine as data."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any, final

import numpy as np
import torch
from typing_extensions import Unpack, override

from symo_exp.checks import real, whole_number
from symo_exp.data.advice import Columns
from symo_exp.data.base import DataModule, DataOptions, Splits, central_differences, stacked
from symo_exp.data.delays import acting_as_given
from symo_exp.data.diagnose import Diagnosis, diagnose
from symo_exp.data.folds import VALIDATED, folded, thinned
from symo_exp.data.header import header
from symo_exp.data.naming import names
from symo_exp.data.parts import FEWEST, Parts, divided, uninterrupted, without
from symo_exp.data.paths import Location, shown, titled
from symo_exp.data.resample import TIME_TOLERANCE, Samples, at_equal_times, resample
from symo_exp.data.table import Recording, read_recordings
from symo_exp.data.turns import continuous, refuse_counts, refuse_turns, turned
from symo_exp.data.velocities import contradicting_velocities
from symo_exp.errors import ConfigError
from symo_exp.mechanics.space import Space
from symo_exp.mechanics.types import Coordinates, Trajectory
from symo_exp.mechanics.windows import NODES
from symo_exp.systems.base import System
from symo_exp.systems.recorded import Recorded
from symo_exp.words import counted

SWINGS = 4
"""Sweeps from which the size of an oscillation is judged."""
BATCHES = 8
"""In an epoch, unless their size is given."""


def recorded_system(
    path: Location,
    *,
    time_step: float,
    angular: str | Sequence[str],
    columns: Columns | None = None,
    rotations: Sequence[str] = (),
    input_matrix: Any = None,
) -> Recorded:
    """Return the machine whose coordinates and inputs are the columns of recordings.

    Its trajectories, from Python::

        system = recorded_system("mine.csv", time_step=0.02, angular="all")
        data = RecordedData(system=system, path="mine.csv")
        data.setup()
        data.trajectories("test")

    Args:
        path: A file, a folder, a glob pattern or a list of them.
        time_step: Of the nodes to which recordings are resampled [s].
        angular: Coordinates that are angles [rad]: ``"all"``, ``"none"`` or their names.
        columns: A mapping of this project's names to those of the file; ``None`` instead of a name
            leaves the column out.
        rotations: Names of the rotations.
        input_matrix: As that of ``Recorded``.

    Raises:
        ConfigError: If a file cannot be read or has no coordinates, or for invalid arguments.
    """
    found = header(path, columns)
    return Recorded(
        names=names("q", found), inputs=names("u", found), time_step=time_step, angular=angular,
        rotations=rotations, input_matrix=input_matrix,
    )  # fmt: skip


@final
class RecordedData(DataModule):
    """Recorded trajectories instead of simulated ones.

    A table has one row a sample and the columns

    - ``trajectory``: which trajectory the row belongs to, a number or a name;
    - ``split``, if there is one: ``train``, ``val`` or ``test``, the same all along a trajectory;
      those of any other split are not used;
    - ``t``: time;
    - ``q_<name>``: one for each coordinate of the system; angles go on beyond a turn, or are
      ``wrapped``;
    - ``q_<R>_w``, ``q_<R>_x``, ``q_<R>_y``, ``q_<R>_z`` of a rotation: the unit quaternion from
      body to world axes, the scalar first, of either sign;
    - ``v_<name>``: velocities, ``v_<R>_x``, … the body rates of a rotation; without any, they come
      from the configurations;
    - ``u_<name>``: the inputs, ``u_0``, ``u_1``, … of a system that does not name its own; without
      any, zero.

    Equal steps of ``system.time_step`` are taken as they are, other times resampled
    (``data.resample``). Trajectories may differ in length. Fewer than three without a split are
    split in time (``data.parts.with_every_part``).

    Args:
        system: Whose motions were recorded.
        path: A ``.parquet``, ``.csv``, ``.npz`` or ``.mat`` file, a ROS 2 bag, a folder or glob
            pattern of these, or a list.
        columns: A mapping of the names above to those of the table; ``None`` instead of a name
            leaves the column out.
        wrapped: Whether angles jump by a turn; they are unwrapped then.
        degrees: Whether angles and their velocities are in degrees.
        time_unit: ``d``, ``h``, ``min``, ``s``, ``ms``, ``us`` or ``ns``; ``None``: as the column's
            name or values say (``t_ms``), else seconds.
        sample_time: Time from a row to the next [s], for tables without times.
        train: Names of the training trajectories. ``None``: the column ``split`` says.
        val: Those for validation.
        test: Those for testing.
        n_traj: The first so many training trajectories; ``None``: all.
        n_val: Without names and split, the number of trajectories for validation, before the test
            ones; ``None``: one.
        n_test: Likewise for testing, the last ones.
        n_integration: Rollouts are compared with the first so many test trajectories, up to the
            end of the shortest.
        fold: Division of the training and validation parts for a cross-validation
            (``data.folds.folded``); ``None``: none.
        seconds: Length of the training part at most [s]; ``None``: all of it.
        val_seconds: Length of the validation part at most [s]; ``None``: all of it.
        input_delay: From the record of an input to its force [s].
        input_lag: Time constant with which the force follows the input [s], as that of a motor
            follows its voltage.
        leave_out: Stretches of trajectories that are not used, ``[NAME, FROM, TO]`` each
            (``data.parts.without``); ``None``: none.
        batch_size: ``None``: an eighth of the samples.

    The other arguments are those of ``DataModule``.

    Raises:
        ConfigError: If the recordings cannot be read, or not as recordings of this system.
    """

    recorded = True

    def __init__(
        self,
        *,
        system: System,
        path: Location,
        columns: Columns | None = None,
        wrapped: bool = False,
        degrees: bool = False,
        time_unit: str | None = None,
        sample_time: float | None = None,
        train: Sequence[str | int] | None = None,
        val: Sequence[str | int] | None = None,
        test: Sequence[str | int] | None = None,
        n_traj: int | None = None,
        n_val: int | None = None,
        n_test: int | None = None,
        n_integration: int = 16,
        fold: Sequence[int] | str | None = None,
        seconds: float | None = None,
        val_seconds: float | None = None,
        input_delay: float = 0.0,
        input_lag: float = 0.0,
        leave_out: Sequence[Sequence[str | float]] | None = None,
        batch_size: int | None = None,
        **options: Unpack[DataOptions],
    ) -> None:
        whole_number("data.n_integration", n_integration)
        where, coordinates, h = shown(path), system.coordinates, system.time_step
        table = read_recordings(path, system, columns, time_unit, sample_time)
        recordings: Sequence[Recording] = acting_as_given(table.recordings, input_delay, input_lag)
        refuse_counts(where, coordinates, recordings, degrees)
        recordings = continuous(recordings, coordinates, degrees=degrees, wrapped=wrapped)
        if leave_out is not None:
            recordings = without(recordings, leave_out, h)
        named = {"train": train, "val": val, "test": test}
        parts, recordings, note = divided(where, recordings, named, n_val, n_test, h)
        self._is_compared = fold is not None
        if fold is not None:
            parts = folded(parts, fold)
        if seconds is not None:
            most = real("data.seconds", seconds, low=h)
            parts["train"] = thinned(parts["train"], most, least=FEWEST * h)
        if val_seconds is not None:
            most = real("data.val_seconds", val_seconds, low=h)
            parts["val"] = thinned(parts["val"], most, VALIDATED, FEWEST * h)
        parts, gaps = _cut_at_gaps(where, parts, h)
        if n_traj is not None:
            whole_number("data.n_traj", n_traj, high=len(parts["train"]))
        parts["train"] = parts["train"][:n_traj]
        if not wrapped:
            refuse_turns(where, list(itertools.chain(*parts.values())), coordinates)
        self._coordinates = coordinates
        found = {
            name: [_trajectory(where, one, coordinates, h) for one in part]
            for name, part in parts.items()
        }
        self.test_names = [one.label for one in parts["test"]]
        rollouts = found["test"][:n_integration]
        shortest = min(len(t.q) for t in rollouts)
        self._splits = Splits(**found, integration=stacked(rollouts, shortest))
        self._sampled = [recording.samples for recording in parts["train"]]
        with np.errstate(all="ignore"):  # values that overflow
            doubts = [
                *_wide_swings(coordinates, self._sampled),
                *contradicting_velocities(coordinates, self._sampled, columns),
            ]
        read, resampled = _told_read(where, recordings, parts), _told_resampled(parts, h)
        notes = filter(None, (*table.notes, note))
        self._report = [read, *notes, *resampled, *gaps, *doubts]
        if batch_size is None:
            batch_size = math.ceil(sum(len(t.q) - 2 for t in found["train"]) / BATCHES)
        n_traj = len(parts["train"])
        super().__init__(time_step=h, n_traj=n_traj, batch_size=batch_size, **options)

    @override
    def load(self) -> Splits:
        return self._splits

    @override
    def lines(self) -> Sequence[str]:
        # a search examines the recordings once, and its fits are many
        if self._coordinates.rotations or self._is_compared:
            return self._report
        return [*self._report, *self.diagnosis().lines()]

    def diagnosis(self) -> Diagnosis:
        """Return the diagnosis of the training trajectories."""
        motions = [(q.numpy(), u.numpy()) for q, _, u in self._splits.train]
        raw = [samples.q for samples in self._sampled]
        gap = float(np.median(np.concatenate([np.diff(samples.t) for samples in self._sampled])))
        with np.errstate(all="ignore"):  # values that overflow
            return diagnose(
                motions, raw, self._coordinates, self.time_step, samples=self.time_step / gap
            )


def _cut_at_gaps(where: str, parts: Parts, h: float) -> tuple[Parts, list[str]]:
    """Return the uninterrupted pieces of every part, and a line on the gaps of each.

    Raises:
        ConfigError: If a part has no piece that is long enough.
    """
    pieces: Parts = {}
    gaps = []
    for name, part in parts.items():
        pieces[name], note = uninterrupted(part, h)
        gaps += [f"{name}: {note}"] if note else []
    for name, part in pieces.items():
        if not part:
            raise ConfigError(f"{where}: nothing is left for {name}; {'; '.join(gaps)}")
    return pieces, gaps


def _trajectory(where: str, recording: Recording, coordinates: Coordinates, h: float) -> Trajectory:
    """Return a recording as a trajectory with nodes a time step apart.

    Raises:
        ConfigError: If samples are too far apart or quaternions have not the norm 1.
    """
    where, space = f"{where}: {titled(recording.label)}", coordinates.space
    samples = turned(where, recording.acting(), coordinates)
    if not at_equal_times(samples.t, h):
        if samples.step > h * (1 + TIME_TOLERANCE):
            raise ConfigError(
                f"{where} has a sample every {samples.step:.6g} s, and system.time_step={h:g} "
                f"may not be shorter; set system.time_step={samples.step:.4g} or more"
            )
        samples = _resampled(samples, space, h)
    if len(samples.t) < NODES:
        nodes = counted(len(samples.t), "node")
        raise ConfigError(
            f"{where} has {nodes} at system.time_step={h:g}; at least {NODES} are needed"
        )
    q, u = torch.tensor(samples.q), torch.tensor(samples.u)
    v = central_differences(q, h, space) if samples.v is None else torch.tensor(samples.v)
    return Trajectory(q, v, u)


def _resampled(samples: Samples, space: Space, h: float) -> Samples:
    """Resample; rotations by their nine entries, with the rotation next to them."""
    found = resample(samples, h)
    q, rate = space.normalised(torch.tensor(found.q)), torch.tensor(found.v)
    v = space.velocity(q, rate) if samples.v is None else rate
    return found._replace(q=q.numpy(), v=v.numpy())


def _told_read(where: str, recordings: Sequence[Recording], parts: Parts) -> str:
    """Return a line on how many recordings are in each part and how many are not used."""
    text = ", ".join(f"{len(part)} {name}" for name, part in parts.items())
    used = Counter(one.part for one in itertools.chain(*parts.values()))
    others = Counter(one.part for one in recordings) - used
    hint = ", ".join(f"{count} {part}".rstrip() for part, count in others.items())
    return f"{where}: {text}" + (f"; not used: {hint}" if hint else "")


def _told_resampled(parts: Parts, h: float) -> list[str]:
    """Return a line on how times were resampled, if any were."""
    used = [one.samples for one in itertools.chain(*parts.values())]
    resampled = [samples for samples in used if not at_equal_times(samples.t, h)]
    if not resampled:
        return []
    usual = sorted(samples.step for samples in resampled)
    rate = f"{usual[0]:.5g}" + (f" to {usual[-1]:.5g}" if usual[-1] > 1.01 * usual[0] else "")
    largest = max(float(np.diff(samples.t).max()) for samples in resampled)
    inputs = "; inputs averaged over a step" * bool(used[0].u.shape[1])
    return [
        f"resampled: {len(resampled)} of {len(used)} trajectories from {rate} s (the longest "
        f"gap {largest:.3g} s) to {h:g} s, by local cubics{inputs}"
    ]


def _wide_swings(coordinates: Coordinates, sampled: Sequence[Samples]) -> Iterator[str]:
    """Yield a line on each angle that seems to be in degrees."""
    for i, (name, angular) in enumerate(zip(coordinates.flat, coordinates.angular, strict=False)):
        sweeps = np.concatenate([_sweeps(one.q[:, i]) for one in sampled])
        if angular and len(sweeps) >= SWINGS and np.median(sweeps) > 2 * np.pi:
            yield (
                f"q_{name} swings back and forth by {np.median(sweeps):.3g} rad, more than a turn: "
                "if angles are in degrees, give data.degrees=true"
            )


def _sweeps(x: np.ndarray) -> np.ndarray:
    """Return distances between turning points, those beyond a tenth of the range."""
    turns = np.flatnonzero(np.diff(np.sign(np.diff(x))) != 0) + 1
    sweeps = np.abs(np.diff(x[turns]))
    return np.asarray(sweeps[sweeps > 0.1 * np.ptp(x)])
