"""The effort of a training, and the time that it takes."""

from __future__ import annotations

import math
from dataclasses import dataclass

from symo_exp.data.folds import VALIDATED
from symo_exp.evaluation.horizon import EVERY, HORIZONS, LONG, RUN_IN
from symo_exp.identify.candidates import Candidate
from symo_exp.identify.recordings import Machine

EPOCH, NODE = 8e-3, 4.5e-6
"""Times of an epoch of rigid links in a plane, midpoint rule: a fixed one, and what a node and pair
of coordinates adds: each of n residuals is differentiated, and solved with those around it [s]."""
DRIVEN = 1.5
"""Factor of the time of an epoch with inputs: the friction of motors bends residuals, so that more
trials of a step are refused."""
WARM_UP = 1.0
"""Time of Adam's steps before each start of the optimiser but the first [s]."""
STEP, ROW = 0.75e-3, 1.4e-6
"""Time of a step of the rollouts of a validation, and what a rollout and a pair of coordinates, a
coordinate and itself included twice, add to it [s]."""
STICKING = 4.0
"""Factor of the time of a validation with inputs and several coordinates: steps in which some stick
are taken one by one."""
FITTED, LEAD = 6.0, 0.25
"""Times that the run-in of a window is rolled out to fit its start, and its share of a recording at
most."""
EPSILONS, LATE = 4, 3
"""Stages of the optimiser after its starts, and further ones if friction is learned late."""
STARTING = 0.5
"""Time of a run that depends on nothing [s]."""
MEASURED = (60.0, 4 * VALIDATED, 2 * VALIDATED)
"""Lengths of held-out data at most, on which candidates are measured [s]."""
FOLDS = 6
"""Of a cross-validation, if there are enough recordings or these are long."""
SPARSE = 2
"""Validations of a training where they are dominant: in the middle and at the end."""


@dataclass(frozen=True)
class Effort:
    """The effort of a training.

    Args:
        epochs: Epochs of each start with held nodes, and for each epsilon.
        sparse: Whether there are few validations, instead of one after each stage.
        measured: Length of held-out data at most [s].
    """

    epochs: int
    sparse: bool = False
    measured: float = MEASURED[0]

    def total(self, candidate: Candidate) -> int:
        """Return the epochs of a training."""
        late = candidate.settings.get("dissipation") == "learned" and candidate.starts > 0
        stages = candidate.starts + EPSILONS + LATE * late
        return candidate.forces + stages * self.epochs

    def between(self, candidate: Candidate) -> int:
        """Return the epochs between validations."""
        return math.ceil(self.total(candidate) / SPARSE) if self.sparse else self.epochs

    def training(self, candidate: Candidate, nodes: int, machine: Machine) -> float:
        """Return the time of a training on the reference machine without validations [s]."""
        n = machine.coordinates.n
        epoch = candidate.cost_of_epoch(n) * (EPOCH + NODE * n**2 * nodes)
        epoch *= DRIVEN if machine.driven else 1.0
        return STARTING + WARM_UP * max(0, candidate.starts - 1) + epoch * self.total(candidate)

    def validation(self, candidate: Candidate, machine: Machine) -> float:
        """Return the time of the validations of a training on the reference machine [s].

        Steps are taken one after another, for all windows at once, and again along the longest
        recording as a whole, unless errors are compared over shorter times than usual.
        """
        n = machine.coordinates.n
        step = float(candidate.settings.get("system.time_step", machine.time_step))
        held_out = machine.seconds / FOLDS
        piece = min(machine.seconds / machine.recordings, held_out)
        seconds = min(held_out, self.measured)
        piece = min(piece, max(VALIDATED, piece * seconds / held_out))

        def rolled(length: float, rows: float) -> float:
            return length / step * (STEP + ROW * n * (n + 1) * rows)

        window = min(machine.horizon, piece) + FITTED * min(RUN_IN, LEAD * piece)
        found = rolled(window, max(1.0, seconds / min(EVERY, piece)))
        if piece >= LONG and machine.horizon >= HORIZONS[-1]:
            found += rolled(piece, seconds / piece)
        slow = math.sqrt(candidate.cost * step / machine.time_step)
        if machine.driven and n > 1 and not machine.coordinates.rotations:
            slow *= STICKING
        return slow * found * self.total(candidate) / self.between(candidate)

    def expected(self, candidate: Candidate, nodes: int, machine: Machine) -> float:
        """Return the time of a run on the reference machine [s]."""
        training = self.training(candidate, nodes, machine)
        return training + self.validation(candidate, machine)


EFFORTS = (Effort(20), Effort(10))
"""Of trainings, from the most thorough."""
