"""A user's own recordings, read from Parquet or CSV."""

from __future__ import annotations

import logging
import math
import os
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, final

import numpy as np
import torch

from symo_exp.data.base import DataModule, Splits, central_differences
from symo_exp.data.diagnose import Diagnosis, diagnose
from symo_exp.data.header import few
from symo_exp.data.parts import divided
from symo_exp.data.resample import Samples, resample
from symo_exp.data.table import Recording, read, write
from symo_exp.errors import ConfigError
from symo_exp.mechanics.types import Coordinates, Trajectories, Trajectory
from symo_exp.systems.base import System
from symo_exp.systems.checks import whole

__all__ = ["RecordedData", "central_differences", "write"]

log = logging.getLogger(__name__)

TIME_TOLERANCE = 1e-3
"""How far a recorded step may be from ``system.time_step``, as a share of it, to be one."""
LONGEST_GAP = 3
"""Steps over which a motion is interpolated, at most."""
BATCHES = 8
"""In an epoch, unless their size is given."""


@final
class RecordedData(DataModule):
    """Recorded trajectories in the place of simulated ones.

    ``path`` is a ``.parquet`` or ``.csv`` table with one row a sample and the columns

    - ``trajectory``: which trajectory the row belongs to, a number or a name;
    - ``split``, if there is one: ``train``, ``val`` or ``test``, the same all along a trajectory;
      those of any other split are not used;
    - ``t``: time [s];
    - ``q_<name>``: one for each coordinate of the system; angles [rad] go on beyond a turn, or are
      ``wrapped``, whatever the interval;
    - ``v_<name>``: velocities; without any, they come from the configurations;
    - ``u_<name>``: the inputs, ``u_0``, ``u_1``, … of a system that does not name its own; without
      any, zero.

    ``columns`` maps names of this list to those of the table. Equal steps of ``system.time_step``
    are taken as they are, other times resampled (``data.resample``).

    Trajectories may differ in length. ``train``, ``val`` and ``test`` list them, else ``split``
    says which is which, else the last ``n_test`` are for testing, the ``n_val`` before them for
    validation (``None``: one each) and the others for training, which takes the first ``n_traj``
    (``None``: all). Rollouts are held against the first ``n_integration`` test trajectories, up to
    the end of the shortest. An epoch has batches of ``batch_size`` samples, ``None``: an eighth of
    them. ``base`` holds the other arguments of ``DataModule``.
    """

    recorded = True

    def __init__(
        self,
        *,
        system: System,
        path: str | os.PathLike[str],
        columns: Mapping[str, str] | None = None,
        wrapped: bool = False,
        train: Sequence[str | int] | None = None,
        val: Sequence[str | int] | None = None,
        test: Sequence[str | int] | None = None,
        n_traj: int | None = None,
        n_val: int | None = None,
        n_test: int | None = None,
        n_integration: int = 16,
        batch_size: int | None = None,
        **base: Any,
    ) -> None:
        whole("data.n_integration", n_integration)
        where = f"data.path={path}"
        table = read(path, system, columns)
        named = {"train": train, "val": val, "test": test}
        parts = divided(where, table.recordings, named, n_val, n_test)
        available = len(parts["train"])
        n_traj = whole("data.n_traj", available if n_traj is None else n_traj, high=available)
        parts["train"] = parts["train"][:n_traj]
        nodes = Nodes(where, system.coordinates, system.time_step, wrapped)
        found = {name: [nodes.of(r) for r in part] for name, part in parts.items()}
        self._splits = Splits(**found, integration=_shortest(found["test"][:n_integration]))
        self._report = list(_report(where, table.recordings, table.unread, parts, system.time_step))
        self._sampled = [recording.samples for recording in parts["train"]]
        self._system, self.time_step = system, system.time_step
        if batch_size is None:
            batch_size = math.ceil(sum(len(t.q) - 2 for t in found["train"]) / BATCHES)
        super().__init__(n_traj=n_traj, batch_size=batch_size, **base)

    @property
    def counts(self) -> dict[str, int]:
        train, val, test, integration = self._splits
        return {
            "train": len(train), "val": len(val), "test": len(test),
            "integration": len(integration.q),
        }  # fmt: skip

    def load(self) -> Splits:
        return self._splits

    def setup(self, stage: str | None = None) -> None:
        if not hasattr(self, "train"):
            for line in (*self._report, *self.diagnosis().lines()):
                log.info(line)
        super().setup(stage)

    def diagnosis(self) -> Diagnosis:
        """What the training trajectories can teach."""
        h, sampled = self._system.time_step, self._sampled
        motions = [(q.numpy(), u.numpy()) for q, _, u in self._splits.train]
        gap = float(np.median(np.concatenate([np.diff(samples.t) for samples in sampled])))
        with np.errstate(all="ignore"):  # of numbers beyond all measure
            raw = [samples.q for samples in sampled]
            return diagnose(motions, raw, self._system.coordinates, h, samples=h / gap)


class Nodes:
    """Recordings as trajectories with nodes a time step ``h`` apart."""

    def __init__(self, where: str, coordinates: Coordinates, h: float, wrapped: bool) -> None:
        self._where, self._coordinates, self._h, self._wrapped = where, coordinates, h, wrapped

    def of(self, recording: Recording) -> Trajectory:
        """Raises ``ConfigError`` where angles are wrapped or samples too far apart."""
        where, h = f"{self._where}: trajectory {recording.label}", self._h
        with np.errstate(over="ignore", invalid="ignore"):
            return self._of(where, recording.samples, h)

    def _of(self, where: str, samples: Samples, h: float) -> Trajectory:
        samples = self._unwrapped(where, samples)
        if not _equal(samples.t, h):
            _check_gaps(where, samples.t, h)
            samples = resample(samples, h)
            if len(samples.t) < 3:
                raise ConfigError(
                    f"{where} lasts for {len(samples.t)} node(s) at system.time_step={h:g}; "
                    "a sample needs 3"
                )
        q, u = samples.q, samples.u
        v = samples.v
        if v is None:
            v = central_differences(torch.tensor(q), h).numpy()
        if not all(np.isfinite(np.diff(field, 2, axis=0) / h**2).all() for field in (q, v, u)):
            raise ConfigError(f"{where} has numbers too large to reckon with")
        return Trajectory(*(torch.tensor(field) for field in (q, v, u)))

    def _unwrapped(self, where: str, samples: Samples) -> Samples:
        q, angular = samples.q, np.array(self._coordinates.angular)
        if self._wrapped:
            return samples._replace(q=np.where(angular, np.unwrap(q, axis=0), q))
        turns = np.where(angular, np.abs(np.diff(q, axis=0)).max(0), 0)
        if turns.max() > np.pi:
            name = self._coordinates.names[int(turns.argmax())]
            raise ConfigError(
                f"{where} turns q_{name} by {turns.max():.3g} rad in one step; angles must not be "
                "wrapped (data.wrapped=true mends them) and be in radians"
            )
        return samples


def _equal(t: np.ndarray, h: float) -> bool:
    return bool((np.abs(np.diff(t) - h) <= TIME_TOLERANCE * h).all())


def _check_gaps(where: str, t: np.ndarray, h: float) -> None:
    gaps = np.diff(t)
    usual, worst = float(np.median(gaps)), int(np.argmax(gaps))
    if usual > h * (1 + TIME_TOLERANCE):
        raise ConfigError(
            f"{where} steps by {usual:.6g} s, but system.time_step={h:g}, which may not be finer "
            f"than the recording; set system.time_step={usual:.3g} or more"
        )
    if gaps[worst] > LONGEST_GAP * h:
        raise ConfigError(
            f"{where} steps by {gaps[worst]:.6g} s at t={t[worst]:.6g}, too much at "
            f"system.time_step={h:g} (three steps are the most); make it two trajectories there"
        )


def _shortest(trajectories: Sequence[Trajectory]) -> Trajectories:
    nodes = min(len(t.q) for t in trajectories)
    fields = zip(*trajectories, strict=True)
    return Trajectories(*(torch.stack([x[:nodes] for x in field]) for field in fields))


def _report(
    where: str, recordings: Sequence[Recording], unread: Sequence[str],
    parts: Mapping[str, Sequence[Recording]], h: float,
) -> Iterator[str]:  # fmt: skip
    """What was read, what was not, and what was done to the times; a line each."""
    used = [r for part in parts.values() for r in part]
    text = ", ".join(f"{len(part)} {name}" for name, part in parts.items())
    others = Counter(r.part for r in recordings) - Counter(r.part for r in used)
    hint = ", ".join(f"{count} {part}".rstrip() for part, count in others.items())
    yield f"{where}: {text}" + (f"; not used: {hint}" if hint else "")
    if unread:
        yield f"columns that are not read: {few(unread)}"
    gaps = [np.diff(r.samples.t) for r in used if not _equal(r.samples.t, h)]
    if gaps:
        usual = sorted(float(np.median(g)) for g in gaps)
        rate = f"{usual[0]:.3g}" + (f" to {usual[-1]:.3g}" if usual[-1] > 1.01 * usual[0] else "")
        largest = max(float(g.max()) for g in gaps)
        yield (
            f"resampled: {len(gaps)} of {len(used)} trajectories from {rate} s (the longest gap "
            f"{largest:.3g} s) to {h:g} s, by local cubics; inputs averaged over a step"
        )
