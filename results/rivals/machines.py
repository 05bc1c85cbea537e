"""The real machines, what a rival is given, and how it chooses its settings."""

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

from symo_exp.data.recorded import RecordedData, recorded_system
from symo_exp.evaluation.horizon import cut, median, predict
from symo_exp.mechanics.types import Trajectory
from symo_exp.models.starts import RollsOut

TIME_STEP = 0.02
"""Distance of the nodes of predictions [s]."""
FINE = {"motor_pendulum": 0.02}
"""Distance of the samples that rivals may differentiate [s]; 5 ms where the recording has them."""


@dataclass(frozen=True)
class Machine:
    """A machine: all angles in radians, zero hanging down, an input for each or for none.

    Attributes:
        name: Of its table in ``recordings``.
        train: Training trajectories, nodes ``TIME_STEP`` apart, with measured velocities.
        val: Those on which settings are chosen.
        fine: The training trajectories, samples ``fine_step`` apart.
        fine_step: Distance of these samples [s].
    """

    name: str
    train: Sequence[Trajectory]
    val: Sequence[Trajectory]
    test: Sequence[Trajectory]
    fine: Sequence[Trajectory]
    fine_step: float

    @property
    def n(self) -> int:
        return self.train[0].q.shape[1]

    @property
    def m(self) -> int:
        return self.train[0].u.shape[1]

    @property
    def driven(self) -> bool:
        """Whether an input acts in the training trajectories."""
        return any(bool(t.u.any()) for t in self.train)


class Rival(Protocol):
    """A method with its own package."""

    NAME: str
    GIVEN: str
    """The knowledge about the machine that a package is given."""

    def candidates(self, machine: Machine) -> Iterable[tuple[str, Callable[[], RollsOut]]]:
        """Yield settings in words, and how to fit a model with them, the likely ones first."""


def machine(name: str) -> Machine:
    """Read a machine's recordings."""
    fine_step = FINE.get(name, 0.005)
    coarse, fine = _data(name, TIME_STEP), _data(name, fine_step)
    parts = {part: coarse.trajectories(part) for part in ("train", "val", "test")}
    return Machine(name=name, fine=fine.trajectories("train"), fine_step=fine_step, **parts)


def _data(name: str, step: float) -> RecordedData:
    path = f"recordings/{name}.parquet"
    system = recorded_system(path, time_step=step, angular="all")
    data = RecordedData(system=system, path=path)
    data.setup()
    return data


def chosen(rival: Rival, of: Machine, budget: float) -> tuple[RollsOut, str, int, float]:
    """Fit candidates until the processor time [s] is used; return the best on ``val``.

    The best has the smallest median error of rollouts over 1 s from fitted starts. Returned are
    the model, its settings, the number of candidates and the time.
    """
    begin, tried = time.process_time(), 0
    least, best = float("inf"), None
    windows = cut(of.val, TIME_STEP, run_in=True)
    assert windows is not None
    for settings, fit in rival.candidates(of):
        model = fit()
        error = median(predict(model, windows).rmse(1.0))
        tried += 1
        print(f"  {rival.NAME}, {settings}: val {error:.4g}", flush=True)
        if best is None or error < least:
            least, best = error, (model, settings)
        if time.process_time() - begin > budget:
            break
    assert best is not None
    return *best, tried, time.process_time() - begin


def measures(model: RollsOut, of: Machine) -> dict[str, float]:
    """Return the errors on the test part."""
    windows = cut(of.test, TIME_STEP, run_in=True)
    assert windows is not None
    return predict(model, windows).measures()
