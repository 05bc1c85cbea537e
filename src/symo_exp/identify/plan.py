"""The plan of a search: the use of its budget, decided before the first run starts."""

from __future__ import annotations

import json
import math
import re
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from symo_exp.data.folds import VALIDATED
from symo_exp.data.header import UNITS
from symo_exp.errors import ConfigError
from symo_exp.evaluation.horizon import EVERY, HORIZONS, LONG, RUN_IN
from symo_exp.files import read_json, user_cache, write_text
from symo_exp.identify.candidates import Candidate
from symo_exp.identify.recordings import Machine

LONGEST = 3.6e7
"""Budget at most [s]."""
REFERENCE = 0.25
"""Time of ``exercise`` on the machine on which the times below were measured [s]."""
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
SCREENING, VARYING, REFITTING = 0.45, 0.35, 0.2
"""Shares of the budget; in the last one a model is fitted to as many data as there is time for."""
MEASURED = (60.0, 4 * VALIDATED, 2 * VALIDATED)
"""Lengths of held-out data at most, on which candidates are measured [s]."""
FOLDS, FEWEST_NODES, MOST_NODES = 6, 800, 30_000
DOMINANT = 0.5
"""Share of the time of a training from which there are fewer validations, on fewer data."""
SPARSE = 2
"""Validations of a training where they are dominant: in the middle and at the end."""
PROMOTED, VARIED = 3, 2.0
"""Variations that are tried on all folds, and the cost of one over its candidate's."""
FEWEST_VARIATIONS = 2
"""Of a cheap candidate with any budget: one has finer steps, unless springs show."""
FEWEST_FITS, MOST_FITS = 2, 4
"""Last fits of a candidate with several starts."""
DATA = 0.6
"""Share of the time that fewer data leave at least where data are reduced first."""
PATIENCE = 4.0
"""A run that takes so many times longer than planned is ended."""


@dataclass(frozen=True)
class Effort:
    """The effort of a training.

    Args:
        start: Epochs with held nodes.
        epochs: Epochs for each epsilon.
        sparse: Whether there are few validations, instead of one after each stage.
        measured: Length of held-out data at most [s].
    """

    start: int
    epochs: int
    sparse: bool = False
    measured: float = MEASURED[0]

    def total(self, candidate: Candidate) -> int:
        """Return the epochs of a training."""
        late = LATE * (candidate.settings.get("dissipation") == "learned")
        return self.fewest(candidate) + late * self.epochs

    def fewest(self, candidate: Candidate) -> int:
        """Return the epochs of a training that ends before the late stages."""
        return self.begun(candidate) + EPSILONS * self.epochs

    def begun(self, candidate: Candidate) -> int:
        """Return the epochs of a training with smoothed nodes."""
        return candidate.forces + candidate.starts * self.start

    def between(self, candidate: Candidate) -> int:
        """Return the epochs between validations."""
        return math.ceil(self.total(candidate) / SPARSE) if self.sparse else self.epochs

    def training(self, candidate: Candidate, nodes: int, machine: Machine) -> float:
        """Return the time of a training on the reference machine without validations [s]."""
        n = machine.coordinates.n
        epoch = candidate.cost_of_epoch(n) * (EPOCH + NODE * n**2 * nodes)
        epoch *= DRIVEN if machine.driven else 1.0
        return STARTING + WARM_UP * (candidate.starts - 1) + epoch * self.total(candidate)

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


EFFORTS = (Effort(20, 20), Effort(10, 10))
"""Of trainings, from the most thorough."""


@dataclass(frozen=True)
class Plan:
    """The stages of a search and their planned times.

    Args:
        budget: Wall time [s].
        cores: How many runs are done at a time.
        speed: Of this machine, relative to the one of ``REFERENCE``.
        folds: Of the cross-validation.
        first: Folds of the first round.
        seconds: Length of the training part of a fold [s].
        effort: Of the trainings.
        needed: Wall time that the search takes at least [s]; more than the budget where that is too
            little.
        reserved: Planned time that the stages after the first rounds have in any case, one run
            after another [s].
        names: Candidates of the first round.
        key: Digest of the arguments that the plan depends on.
        recordings: Digest of the recordings.
    """

    budget: float
    cores: int
    speed: float
    folds: int
    first: int
    seconds: float
    effort: Effort
    needed: float
    reserved: float
    names: tuple[str, ...]
    key: str
    recordings: str = ""

    def overrides(self, candidate: Candidate) -> list[str]:
        """Return the settings of the training of a candidate."""
        return [
            f"optimizer.start={self.effort.start}",
            f"optimizer.epochs={self.effort.epochs}",
            f"trainer.validate_every={self.effort.between(candidate)}",
            f"optimizer.starts={candidate.starts}",
            f"optimizer.force_epochs={candidate.forces}",
            f"data.val_seconds={self.effort.measured:g}",
        ]

    def expected(self, candidate: Candidate, nodes: int, machine: Machine) -> float:
        """Return the time of a run on so many nodes [s]."""
        return self.effort.expected(candidate, nodes, machine) / self.speed

    def most_seconds(self, candidate: Candidate, machine: Machine) -> float:
        """Return the length of data that a candidate can be fitted to in its time [s]."""
        nodes, work = machine.nodes, self._refitting / self._rounds(candidate, machine)
        fixed = self.effort.training(candidate, 0, machine)  # does not depend on the nodes
        while nodes > FEWEST_NODES and (
            nodes > MOST_NODES or self.effort.training(candidate, nodes, machine) - fixed > work
        ):
            nodes = max(FEWEST_NODES, int(nodes / 1.25))
        return machine.seconds if nodes == machine.nodes else nodes * machine.time_step

    @property
    def total(self) -> float:
        """The wall time of the search [s]."""
        return max(self.budget, self.needed)

    def search_time(self, candidate: Candidate, machine: Machine, pace: float = 1.0) -> float:
        """Return the planned time of all runs before the last fits, one after another [s].

        Args:
            candidate: The one of the last fits.
            machine: The recorded machine.
            pace: How many times longer than planned runs take.
        """
        nodes = round(self.most_seconds(candidate, machine) / machine.time_step)
        fit = self.effort.training(candidate, nodes, machine) / self.speed
        last = self._rounds(candidate, machine) * fit
        return self.cores * (self.total / pace - last)

    def last_fits(self, candidate: Candidate, machine: Machine) -> int:
        """Return how many fits to all data a chosen candidate has, from different seeds.

        Candidates whose starts are drawn have several minima, and the start with the smallest
        residuals does not always lead to the deepest one. There are ``MOST_FITS`` if there is time
        for these, else one for each core, at least ``FEWEST_FITS``.
        """
        if not candidate.has_minima:
            return 1
        rounds = math.ceil(MOST_FITS / self.cores)
        every = rounds * self.effort.training(candidate, machine.nodes, machine)
        if machine.nodes <= MOST_NODES and every <= self._refitting:
            return MOST_FITS
        return min(max(FEWEST_FITS, self.cores), MOST_FITS)

    @property
    def _refitting(self) -> float:
        """The time of all rounds of last fits on the reference machine [s]."""
        return REFITTING * self.budget * self.speed

    def _rounds(self, candidate: Candidate, machine: Machine) -> int:
        """Return in how many rounds the last fits are done, side by side."""
        return math.ceil(self.last_fits(candidate, machine) / self.cores)

    def limit(self, candidate: Candidate, nodes: int, machine: Machine) -> float:
        """Return the time after which a training is ended [s]."""
        return max(20.0, PATIENCE * self.expected(candidate, nodes, machine))


def seconds_of(text: object) -> float:
    """Return a duration such as ``90s``, ``10min``, ``1.5h`` or a number of seconds.

    Raises:
        ConfigError: If it is none.
    """
    number = r"(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:e[+-]?[0-9]+)?"
    found = re.fullmatch(rf"\s*({number})\s*(s|min|h)?\s*", str(text))
    value = float(found[1]) * UNITS[found[2] or "s"] if found else math.nan
    if not 0 < value <= LONGEST:
        raise ConfigError(
            f"budget={text}: expected a duration such as 90s, 10min or 1.5h, at most "
            f"{LONGEST / UNITS['h']:g}h"
        )
    return value


def make_plan(
    machine: Machine, candidates: Sequence[Candidate], budget: float, cores: int, speed: float,
    key: str, recordings: str = "",
) -> Plan:  # fmt: skip
    """Return the most thorough plan that fits the budget.

    First the epochs are reduced, then validations where they take most of the time of a training
    and the data where these take much, then the folds and the candidates, the costliest first. Two
    variations of the simplest candidate are always counted.
    """
    work = budget * cores * speed
    whole = 3 <= machine.recordings < FOLDS and machine.seconds < FOLDS * LONG
    folds = machine.recordings if whole else FOLDS  # blocks of long recordings
    share = (folds - 1) / folds
    nodes_all, chosen = machine.nodes, list(candidates)
    first = min(2, folds)

    def screening(effort: Effort, nodes: int, tried: Sequence[Candidate]) -> float:
        each = [effort.expected(c, nodes, machine) for c in tried]
        best = sorted(each)[: max(2, len(each) // 2)]
        return first * sum(each) + (folds - first) * sum(best)

    nodes, effort = max(1, round(share * nodes_all)), EFFORTS[0]

    def varied() -> float:
        """Return the time of a variation of the simplest candidate on a fold."""
        return VARIED * effort.expected(chosen[0], nodes, machine)

    def varying() -> float:
        """Return the time of the fewest variations, two joined, and the trials after them."""
        return (first * (FEWEST_VARIATIONS + 3) + (folds - first) + 2 * folds) * varied()

    def too_much() -> bool:
        least = max(VARYING * work, varying())
        return screening(effort, nodes, chosen) + least > (SCREENING + VARYING) * work

    for lighter in EFFORTS[1:]:
        if too_much():
            effort = lighter

    def data_matter() -> bool:
        return screening(effort, FEWEST_NODES, chosen) < DATA * screening(effort, nodes, chosen)

    def validations_matter() -> bool:
        validation = effort.validation(chosen[0], machine)
        return validation > DOMINANT * effort.expected(chosen[0], nodes, machine)

    thrifty = [replace(effort, sparse=True, measured=seconds) for seconds in MEASURED]

    def lighten(*, anyway: bool) -> None:
        """Reduce validations and data where they matter, or ``anyway``."""
        nonlocal effort, nodes
        while too_much():
            if thrifty and validations_matter():
                effort = thrifty.pop(0)
            elif nodes > FEWEST_NODES and (anyway or data_matter()):
                nodes = max(FEWEST_NODES, int(nodes / 1.25))
            elif anyway and thrifty:
                effort = thrifty.pop(0)
            else:
                break

    lighten(anyway=False)
    while too_much() and folds > 4:
        folds -= 1
    while too_much() and len(chosen) > 2:
        others = chosen[1:]
        chosen.remove(max(others, key=lambda c: (effort.expected(c, nodes, machine), c.rank)))
    lighten(anyway=True)
    while too_much() and folds > 3:
        folds -= 1
    needed = (screening(effort, nodes, chosen) + varying()) / (cores * speed) + REFITTING * budget
    return Plan(
        budget=budget,
        cores=cores,
        speed=speed,
        folds=folds,
        first=first,
        seconds=nodes * machine.time_step,
        effort=effort,
        needed=needed,
        reserved=(first * FEWEST_VARIATIONS + folds - first) * varied() / speed,
        names=tuple(c.name for c in chosen),
        key=key,
        recordings=recordings,
    )


def kept_plan(file: Path, key: str) -> Plan | None:
    """Return the plan of an earlier start of the same search."""
    kept = read_json(file)
    try:
        names, effort = tuple(kept.pop("names")), Effort(**kept.pop("effort"))
        found = Plan(**kept, names=names, effort=effort)
    except (TypeError, KeyError):
        return None
    return found if found.key == key else None


def keep_plan(file: Path, plan: Plan) -> None:
    """Write the plan where the same command finds it."""
    write_text(file, json.dumps(asdict(plan), indent=1) + "\n")


def machine_speed() -> float:
    """Return the speed of a core of this machine, measured once and kept in the user's cache."""
    file = user_cache() / "speed.json"
    kept = read_json(file)
    known = kept.get("speed")
    if kept.get("reference") == REFERENCE and isinstance(known, float):  # of this version
        return known
    speed = float(f"{REFERENCE / min(exercise() for _ in range(2)):.2g}")
    with suppress(OSError):  # a home that cannot be written: it is measured again
        write_text(file, json.dumps({"speed": speed, "reference": REFERENCE}))
    return speed


def exercise() -> float:
    """Return the processor time of operations like those of a training [s].

    These are short: their number counts more than their arithmetic.
    """
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        generator = torch.Generator().manual_seed(0)
        q = torch.rand(1500, 2, generator=generator, dtype=torch.float64)
        m = torch.rand(1500, 2, 2, generator=generator, dtype=torch.float64)
        start = time.process_time()
        for _ in range(1000):
            x = q.clone().requires_grad_()
            moved = (m @ x.unsqueeze(-1)).squeeze(-1)
            energy = (moved * x).sum(1) + torch.sin(x).square().sum(1)
            torch.autograd.grad(energy.sum(), x)
        return time.process_time() - start
    finally:
        torch.set_num_threads(before)
