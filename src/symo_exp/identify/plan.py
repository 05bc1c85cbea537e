"""The plan of a search: the use of its budget, decided before the first run starts."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from symo_exp.data.header import UNITS
from symo_exp.errors import ConfigError
from symo_exp.evaluation.horizon import LONG
from symo_exp.files import read_json, write_text
from symo_exp.identify.candidates import Candidate
from symo_exp.identify.effort import EFFORTS, FOLDS, MEASURED, Effort
from symo_exp.identify.recordings import Machine

LONGEST = 3.6e7
"""Budget at most [s]."""
SCREENING, VARYING, REFITTING = 0.45, 0.35, 0.2
"""Shares of the budget; in the last one a model is fitted to as many data as there is time for."""
FEWEST_NODES, MOST_NODES = 800, 30_000
DOMINANT = 0.5
"""Share of the time of a training from which there are fewer validations, on fewer data."""
FIRST = 2
"""Folds of the first round."""
PROMOTED, VARIED = 3, 2.0
"""Variations that are tried on all folds, and the cost of one over its candidate's."""
FEWEST_VARIATIONS = 2
"""Of a cheap candidate with any budget: one has finer steps, unless springs show."""
DATA = 0.6
"""Share of the time that fewer data leave at least where data are reduced first."""
PATIENCE = 4.0
"""A run that takes so many times longer than planned is ended."""


@dataclass(frozen=True)
class Plan:
    """The stages of a search and their planned times.

    Args:
        budget: Wall time [s].
        cores: How many runs are done at a time.
        speed: Of this machine (``identify.speed``).
        folds: Of the cross-validation.
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
            f"optimizer.start={self.effort.epochs}",
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
        """Return the length of data that the last fit of a candidate has time for [s]."""
        nodes, work = machine.nodes, REFITTING * self.budget * self.speed
        last = candidate.continued()
        fixed = self.effort.training(last, 0, machine)  # does not depend on the nodes
        while nodes > FEWEST_NODES and (
            nodes > MOST_NODES or self.effort.training(last, nodes, machine) - fixed > work
        ):
            nodes = max(FEWEST_NODES, int(nodes / 1.25))
        return machine.seconds if nodes == machine.nodes else nodes * machine.time_step

    def search_time(self, candidate: Candidate, machine: Machine, pace: float) -> float:
        """Return the planned time of all runs before the last fit, one after another [s].

        Args:
            candidate: The one of the last fit.
            machine: The recorded machine.
            pace: How many times longer than planned runs take.
        """
        nodes = round(self.most_seconds(candidate, machine) / machine.time_step)
        last = self.effort.training(candidate.continued(), nodes, machine) / self.speed
        return self.cores * (max(self.budget, self.needed) / pace - last)

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
    draft = _Draft(machine, list(candidates), budget * cores * speed)
    draft.fit()
    searched = (draft.screening(draft.nodes) + draft.varying()) / (cores * speed)
    return Plan(
        budget=budget,
        cores=cores,
        speed=speed,
        folds=draft.folds,
        seconds=draft.nodes * machine.time_step,
        effort=draft.effort,
        needed=searched + REFITTING * budget,
        reserved=(FIRST * FEWEST_VARIATIONS + draft.folds - FIRST) * draft.varied() / speed,
        names=tuple(c.name for c in draft.chosen),
        key=key,
        recordings=recordings,
    )


class _Draft:
    """A plan that becomes less thorough until it fits the time that there is.

    Args:
        machine: The recorded machine.
        chosen: Candidates of the first round, the simplest first.
        work: Time of all cores [s], on the reference machine, like all times here.
    """

    def __init__(self, machine: Machine, chosen: list[Candidate], work: float) -> None:
        self._machine, self._work = machine, work
        self.chosen, self.effort = chosen, EFFORTS[0]
        whole = 3 <= machine.recordings < FOLDS and machine.seconds < FOLDS * LONG
        self.folds = machine.recordings if whole else FOLDS  # blocks of long recordings
        share = (self.folds - 1) / self.folds
        self.nodes = max(1, round(share * machine.nodes))  # of the training part of a fold

    def screening(self, nodes: int) -> float:
        """Return the time of the first rounds with so many nodes: the worse half ends early."""
        each = [self.effort.expected(c, nodes, self._machine) for c in self.chosen]
        best = sorted(each)[: max(2, len(each) // 2)]
        return FIRST * sum(each) + (self.folds - FIRST) * sum(best)

    def varied(self) -> float:
        """Return the time of a variation of the simplest candidate on a fold."""
        return VARIED * self.effort.expected(self.chosen[0], self.nodes, self._machine)

    def varying(self) -> float:
        """Return the time of the fewest variations, two joined, and the trials after them."""
        runs = FIRST * (FEWEST_VARIATIONS + 3) + (self.folds - FIRST) + 2 * self.folds
        return runs * self.varied()

    def fit(self) -> None:
        """Make the plan less thorough until it fits, or nothing is left to reduce."""
        for lighter in EFFORTS[1:]:
            if self._too_much():
                self.effort = lighter
        thrifty = [replace(self.effort, sparse=True, measured=seconds) for seconds in MEASURED]
        self._lighten(thrifty, anyway=False)
        self._reduce_folds(4)
        while self._too_much() and len(self.chosen) > 2:
            self.chosen.remove(max(self.chosen[1:], key=self._cost))
        self._lighten(thrifty, anyway=True)
        self._reduce_folds(3)

    def _too_much(self) -> bool:
        least = max(VARYING * self._work, self.varying())
        return self.screening(self.nodes) + least > (SCREENING + VARYING) * self._work

    def _lighten(self, thrifty: list[Effort], *, anyway: bool) -> None:
        """Reduce validations, to the next ``thrifty`` effort, and data.

        They are reduced where they matter, or ``anyway``.
        """
        while self._too_much():
            if thrifty and self._validations_matter():
                self.effort = thrifty.pop(0)
            elif self.nodes > FEWEST_NODES and (anyway or self._data_matter()):
                self.nodes = max(FEWEST_NODES, int(self.nodes / 1.25))
            elif anyway and thrifty:
                self.effort = thrifty.pop(0)
            else:
                break

    def _reduce_folds(self, least: int) -> None:
        while self._too_much() and self.folds > least:
            self.folds -= 1

    def _data_matter(self) -> bool:
        return self.screening(FEWEST_NODES) < DATA * self.screening(self.nodes)

    def _validations_matter(self) -> bool:
        simplest = self.chosen[0]
        validation = self.effort.validation(simplest, self._machine)
        return validation > DOMINANT * self.effort.expected(simplest, self.nodes, self._machine)

    def _cost(self, candidate: Candidate) -> tuple[float, float]:
        return self.effort.expected(candidate, self.nodes, self._machine), candidate.rank


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
