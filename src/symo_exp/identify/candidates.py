"""Candidate models of a machine."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

FEW = 3
"""Number of coordinates up to which an epoch costs as stated."""


@dataclass(frozen=True)
class Candidate:
    """A model to try.

    Args:
        name: In words.
        rank: Place in the order of simplicity; smaller is simpler.
        settings: Overrides by key.
        cost: Of an epoch, relative to rigid links in a plane in the midpoint rule.
        starts: How many starts the optimiser has.
        growth: Power of the number of coordinates with which the cost grows beyond ``FEW``:
            equations of many parameters take long to solve.
        forces: Epochs before the first start in which residuals are forces.
        drawn: Whether the first start is drawn as well.
    """

    name: str
    rank: float
    settings: Mapping[str, str]
    cost: float = 1.0
    starts: int = 1
    growth: float = 0.0
    forces: int = 0
    drawn: bool = False

    @property
    def has_minima(self) -> bool:
        """Whether fits from different seeds end at different minima."""
        return self.starts > 1 or self.drawn

    def continued(self) -> Candidate:
        """Return the candidate as it is trained from trained parameters: without starts."""
        return replace(self, starts=0, forces=0)

    def cost_of_epoch(self, n: int) -> float:
        """Return the cost of an epoch with so many coordinates."""
        return self.cost * max(1.0, n / FEW) ** self.growth

    def overrides(self) -> list[str]:
        """Return the settings as Hydra's overrides, choices of files first."""
        ordered = sorted(self.settings.items(), key=lambda item: "." in item[0])
        return [f"{key}={value}" for key, value in ordered]

    def changed(self, name: str, more: float, cost: float = 1.0, **settings: str) -> Candidate:
        """Return a variation; ``more`` is what it adds to the rank."""
        given = {key.replace("__", "."): value for key, value in settings.items()}
        return replace(
            self,
            name=f"{self.name}, {name}",
            rank=self.rank + more,
            settings={**self.settings, **given},
            cost=self.cost * cost,
        )


def left_open(settings: Mapping[str, str], given: Collection[str]) -> dict[str, str]:
    """Return the settings that given ones leave in force, by key.

    A given choice of a file, a key without a dot, replaces all settings of another choice.
    """
    return {
        key: value
        for key, value in settings.items()
        if key not in given and key.partition(".")[0] not in given
    }


def with_lagrangian(
    candidates: Sequence[Candidate], given: Mapping[str, str]
) -> Sequence[Candidate]:
    """Return the candidates with a given Lagrangian, all where it is not given or none has it."""
    chosen = given.get("lagrangian", "").partition("=")[2]
    return [one for one in candidates if one.settings["lagrangian"] == chosen] or candidates


def distinct_candidates(
    candidates: Iterable[Candidate], given: Collection[str], known: Iterable[Candidate] = ()
) -> list[Candidate]:
    """Return the candidates that given settings do not make equal to earlier or known ones."""
    seen = [left_open(one.settings, given) for one in known]
    found = []
    for one in candidates:
        if (settings := left_open(one.settings, given)) not in seen:
            seen.append(settings)
            found.append(one)
    return found


def structure_of(candidate: Candidate) -> tuple[tuple[str, str], ...]:
    """Return the settings of a candidate that are not those of its friction, sorted."""
    settings = candidate.settings.items()
    return tuple(sorted((k, v) for k, v in settings if not k.startswith("dissipation")))


def exclude(base: Candidate, one: Candidate, other: Candidate) -> bool:
    """Return whether two variations of a candidate change a setting to different values.

    Switches do not exclude each other.
    """
    changed = set(other.settings.items()) - set(base.settings.items())
    return any(
        one.settings.get(key, value) not in (value, base.settings.get(key), "true", "false")
        for key, value in changed
    )


def joined(base: Candidate, one: Candidate, other: Candidate) -> Candidate:
    """Return the candidate that has what distinguishes ``one`` and ``other`` from ``base``.

    A switch that is on in either of them is on.
    """
    if other == base:
        return one
    settings = dict(one.settings)
    for key, value in other.settings.items():
        if base.settings.get(key) != value and settings.get(key) != "true":
            settings[key] = value
    added = other.name.removeprefix(f"{base.name}, ")
    return replace(
        one,
        name=f"{one.name}, {added}",
        rank=one.rank + other.rank - base.rank,
        settings=settings,
        cost=one.cost * other.cost / base.cost,
    )
