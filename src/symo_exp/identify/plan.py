"""The plan of a search: the use of its budget, decided before the first run starts."""

from __future__ import annotations

import json
import math
import os
import re
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from symo_exp.errors import ConfigError
from symo_exp.files import write_whole
from symo_exp.identify.candidates import Candidate
from symo_exp.identify.recordings import Machine

UNITS = {"s": 1.0, "min": 60.0, "h": 3600.0}
REFERENCE = 0.37
"""Time of ``_exercise`` on the machine on which ``NODE`` and ``MEASURING`` were measured [s]."""
NODE = 30e-6
"""Time of an epoch of links in a plane, midpoint rule, a node and coordinate [s]."""
VALIDATION = 0.2
"""Time of the rollouts of a validation, a coordinate [s]; hardly more with more windows."""
STARTING = 1.0
"""Time of a run that depends on nothing [s]."""
SCREENING, VARYING, REFITTING = 0.45, 0.35, 0.2
"""Shares of the budget; in the last one a model is fitted to as many data as there is time for."""
MEASURED = 60.0
"""Length of held-out data at most, on which candidates are measured [s]."""
FOLDS, FEWEST_NODES, MOST_NODES = 6, 800, 30_000
EFFORTS = ((20, 20), (10, 10))
"""Epochs with held nodes and for each epsilon, from the most thorough."""
PROMOTED, VARIED = 3, 1.5
"""Variations that are tried on all folds, and the cost of one over its candidate's."""
FEWEST_VARIATIONS = 2
"""Of the best candidate, with any budget: one has finer steps, unless springs show."""
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
        speed: Of this machine, relative to the one of ``REFERENCE``.
        folds: Of the cross-validation.
        first: Folds of the first round.
        seconds: Length of the training part of a fold [s].
        start: Epochs with held nodes.
        epochs: Epochs for each epsilon.
        names: Candidates of the first round.
        variations: How many variations of the best candidate are tried.
        key: Digest of the arguments that the plan depends on.
        without: Stages that are left out, since the search has grossly overrun its budget.
    """

    budget: float
    cores: int
    speed: float
    folds: int
    first: int
    seconds: float
    start: int
    epochs: int
    names: tuple[str, ...]
    variations: int
    key: str
    without: tuple[str, ...] = ()

    def overrides(self, candidate: Candidate) -> list[str]:
        """Return the settings of the training of a candidate."""
        return [
            f"optimizer.start={self.start}",
            f"optimizer.epochs={self.epochs}",
            f"trainer.validate_every={self.epochs}",
            f"optimizer.starts={candidate.starts}",
        ]

    def expected(self, candidate: Candidate, nodes: int, n: int) -> float:
        """Return the time of a run on so many nodes and coordinates [s]."""
        return _expected(candidate, nodes, n, self.start, self.epochs) / self.speed

    def most_seconds(self, candidate: Candidate, machine: Machine) -> float:
        """Return the length of data that a candidate can be fitted to in its time [s]."""
        nodes, time = machine.nodes, REFITTING * self.budget
        time += self.expected(candidate, 0, machine.n)  # what does not depend on the nodes
        while nodes > FEWEST_NODES and (
            nodes > MOST_NODES or self.expected(candidate, nodes, machine.n) > time
        ):
            nodes = max(FEWEST_NODES, int(nodes / 1.25))
        return machine.seconds if nodes == machine.nodes else nodes * machine.time_step

    def limit(self, candidate: Candidate, nodes: int, n: int) -> float:
        """Return the time after which a training is ended [s]."""
        return max(20.0, PATIENCE * self.expected(candidate, nodes, n))


def seconds_of(text: object) -> float:
    """Return a duration such as ``90s``, ``10min``, ``1.5h`` or a number of seconds.

    Raises:
        ConfigError: If it is none.
    """
    found = re.fullmatch(r"\s*([0-9.]+(?:e[+-]?[0-9]+)?)\s*(s|min|h)?\s*", str(text))
    try:
        value = float(found[1]) * UNITS[found[2] or "s"] if found else math.nan
    except ValueError:
        value = math.nan
    if not (value > 0 and math.isfinite(value)):
        raise ConfigError(f"budget={text}: expected a duration such as 90s, 10min or 1.5h")
    return value


def make_plan(
    machine: Machine, candidates: Sequence[Candidate], budget: float, cores: int, speed: float,
    key: str,
) -> Plan:  # fmt: skip
    """Return the most thorough plan that fits the budget.

    First the epochs are reduced, then the data where they take most of the time, then the folds and
    the candidates, the costliest first. Two variations are always tried.
    """
    work = budget * cores * speed
    folds = max(2, min(FOLDS, machine.recordings if machine.recordings >= 3 else FOLDS))
    share = (folds - 1) / folds
    nodes_all, chosen = machine.nodes, list(candidates)
    first = min(2, folds)

    def screening(effort: tuple[int, int], nodes: int, tried: Sequence[Candidate]) -> float:
        each = [_expected(c, nodes, machine.n, *effort) for c in tried]
        best = sorted(each)[: max(2, len(each) // 2)]
        return first * sum(each) + (folds - first) * sum(best)

    nodes = max(1, round(share * nodes_all))
    effort = EFFORTS[0]
    for effort in EFFORTS:
        if screening(effort, nodes, chosen) <= SCREENING * work:
            break

    def too_much() -> bool:
        return screening(effort, nodes, chosen) > SCREENING * work

    def data_matter() -> bool:
        return screening(effort, FEWEST_NODES, chosen) < DATA * screening(effort, nodes, chosen)

    while too_much() and nodes > FEWEST_NODES and data_matter():
        nodes = max(FEWEST_NODES, int(nodes / 1.25))
    while too_much() and folds > 4:
        folds -= 1
    while too_much() and len(chosen) > 2:
        chosen.remove(max(chosen, key=lambda c: (_expected(c, nodes, machine.n, *effort), c.rank)))
    while too_much() and nodes > FEWEST_NODES:
        nodes = max(FEWEST_NODES, int(nodes / 1.25))
    while too_much() and folds > 3:
        folds -= 1
    one = VARIED * _expected(chosen[0], nodes, machine.n, *effort)
    variations, left = FEWEST_VARIATIONS, VARYING * work / one
    while first * (variations + 1) + min(PROMOTED, variations // 2 + 1) * (folds - first) <= left:
        variations += 1
    return Plan(
        budget=budget,
        cores=cores,
        speed=speed,
        folds=folds,
        first=first,
        seconds=nodes * machine.time_step,
        start=effort[0],
        epochs=effort[1],
        names=tuple(c.name for c in chosen),
        variations=variations,
        key=key,
    )


def kept_plan(file: Path, key: str) -> Plan | None:
    """Return the plan of an earlier start of the same search."""
    try:
        kept = json.loads(file.read_text(encoding="utf-8"))
        found = Plan(**{**kept, **{name: tuple(kept[name]) for name in ("names", "without")}})
    except (OSError, ValueError, TypeError, KeyError):
        return None
    return found if found.key == key else None


def keep_plan(file: Path, plan: Plan) -> None:
    """Write the plan where the same command finds it."""
    file.parent.mkdir(parents=True, exist_ok=True)
    text = json.dumps(asdict(plan), indent=1) + "\n"
    write_whole(file, lambda whole: whole.write_text(text, encoding="utf-8"))


def machine_speed() -> float:
    """Return the speed of a core of this machine, measured once and kept in the user's cache."""
    cache = Path(os.environ.get("XDG_CACHE_HOME", "~/.cache")).expanduser()
    file = cache / "symo_exp" / "speed.json"
    try:
        return float(json.loads(file.read_text(encoding="utf-8"))["speed"])
    except (OSError, ValueError, TypeError, KeyError):
        pass
    speed = float(f"{REFERENCE / min(_exercise() for _ in range(2)):.2g}")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        write_whole(
            file, lambda whole: whole.write_text(json.dumps({"speed": speed}), encoding="utf-8")
        )
    except OSError:
        pass  # a home that cannot be written: it is measured again
    return speed


def _expected(candidate: Candidate, nodes: int, n: int, start: int, epochs: int) -> float:
    """Return the time of a run on the reference machine [s]."""
    stages = 4 + 3 * (candidate.settings.get("dissipation") == "learned")
    total = candidate.starts * start + stages * epochs
    training = NODE * candidate.cost * n * nodes * total
    measuring = VALIDATION * n * math.sqrt(candidate.cost) * total / epochs
    return STARTING + training + measuring


def _exercise() -> float:
    """Return the processor time of operations like those of a training [s]."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        generator = torch.Generator().manual_seed(0)
        x = torch.rand(1024, 32, generator=generator, dtype=torch.float64)
        w = torch.rand(32, 32, generator=generator, dtype=torch.float64)
        small = torch.rand(1024, 3, 3, generator=generator, dtype=torch.float64)
        small = small @ small.mT + torch.eye(3)
        start = time.process_time()
        for _ in range(2000):
            torch.tanh(x @ w).square().sum(1)
            torch.linalg.solve(small, small)
        return time.process_time() - start
    finally:
        torch.set_num_threads(before)
