"""Candidate models of a machine, in order of simplicity."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from symo_exp.identify.recordings import Machine
from symo_exp.shell import override_value

FREE_DAMPING = 1.0
"""Friction at the start of training over the inertia, of machines without inputs."""
LINKS, BODY, NETWORK, KNOWN = "rigid links", "rigid body", "network", "known equations"
FRICTION = {"dissipation": "friction"}
NEIGHBOURS = {"dissipation": "friction", "dissipation.joints": "neighbours"}
BETWEEN = "friction between neighbours"
PLACE_AND_START = ("dissipation.joints", "dissipation.start")
"""Settings that a candidate keeps if it is given another choice of friction."""
LEAST_REST = 0.01
"""Width of the dry friction of machines over the initial one, at least."""
KINDS = {"asymmetric friction": 0.2, "constant force": 0.1, "Stribeck friction": 0.2}
"""Kinds of friction of machines, with what each adds to the rank."""
FRICTION_NAMES = {*KINDS, "dry friction", "learned friction", "viscous friction"}
"""Parts of names that say which friction a candidate has."""
FRICTION_RANK = {
    "none": -0.6, "viscous": -0.3, "friction": 0.0, "body_drag": 0.0, "known": 0.0, "learned": 0.6,
}  # fmt: skip
"""Share of the choice of friction in the rank; that of machines is the sum of its kinds."""
FRICTION_COST = {"learned": 1.7, "machine": 1.2}
"""Cost of an epoch with a choice of friction, relative to the others."""
SPRINGS, SPRINGS_RANK = "springs", 0.05
"""Name of springs and what they add to the rank."""
STRIBECK = 5.0
"""Initial velocity at which the Stribeck effect fades, over that below which dry friction does."""
SHARP = 0.2
"""Initial width of the dry friction of known equations over the usual one."""
FORCE_EPOCHS = 20
"""Epochs in which residuals are forces, where equations are known and of rigid links in space."""
ARM = 4
"""Number of driven angles from which links in a plane are less probable than in space."""
INPUT_NOISE = 100.0
"""Noise of inputs over that of configurations where it is estimated, in units of the machine."""
THE_STEP = "the time step"
"""End of the parts of names that say which share of the time step a candidate has."""
HELD = 0.05
"""Difference of delays over the time step up to which they count as equal."""
FEW = 3
"""Number of coordinates up to which an epoch costs as stated."""
STRUCTURES: Mapping[str, Mapping[str, str]] = {
    "relative": {"lagrangian": "planar"},
    "absolute": {"lagrangian": "planar", "lagrangian.relative": "false"},
    "general relative": {"lagrangian": "relative"},
    "general absolute": {"lagrangian": "absolute"},
    "small network": {
        "lagrangian": "network", "net.width": "2", "net.depth": "1", "lagrangian.harmonics": "1",
    },
    "network": {"lagrangian": "network", "net.width": "8", "lagrangian.harmonics": "2"},
    "rigid": {"lagrangian": "rigid"},
    "body": {"lagrangian": "rigid_body"},
    "known": {"lagrangian": "known"},
    "turning network": {"lagrangian": "network", "net.width": "8", "lagrangian.harmonics": "0"},
}  # fmt: skip
"""Settings of the Lagrangians, the only place that names them."""


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


def structures(machine: Machine) -> list[Candidate]:
    """Return a candidate of every structure, with viscous and dry friction, the simplest first.

    All have springs if these explain motion that gravity does not: a fit that starts without
    their stiffness seldom finds it.
    """
    if machine.known:
        missing = {"dissipation.missing": override_value(list(machine.friction))}
        width = {
            "dissipation.rest_velocity": f"{SHARP * machine.rest_velocity:g}",
            "dissipation.learned_rest": "true",
        }
        friction = {"dissipation": "known", **missing, **width}
        known = _candidate(KNOWN, 1.0, "known", friction, growth=0.4)
        return [replace(known, forces=FORCE_EPOCHS if machine.driven else 0)]
    if machine.coordinates.rotations:
        return _turning(machine)
    several = sum(machine.coordinates.angular) > 1
    relative = ", relative angles" if several else ""
    # without inputs only the ratio to the inertia counts, and from too little friction fits hang;
    # with inputs no friction is suitable for all machines, and a second start finds the fit
    start = {} if machine.driven else {"dissipation.start": override_value(FREE_DAMPING)}
    starts = 2 if machine.driven else 1
    name = f"{LINKS}{relative}"
    found = _in_space(machine)
    found.append(_candidate(name, 1.0, "relative", {**FRICTION, **start}, 1.0, starts))
    small = _candidate("small network", 3.0, "small network", FRICTION, cost=1.3, starts=2)
    if is_arm(machine):
        return _with_springs([*found, small], machine)
    if several:
        name = f"{LINKS}, absolute angles"
        found.append(_candidate(name, 1.1, "absolute", {**NEIGHBOURS, **start}, 1.0, starts))
    name = f"general links{relative}"
    found.append(_candidate(name, 1.8, "general relative", FRICTION, 1.2, starts, 1.5))
    if several:
        name = "general links, absolute angles"
        found.append(_candidate(name, 1.9, "general absolute", NEIGHBOURS, 1.2, starts, 1.5))
    found.append(small)
    found.append(_candidate(NETWORK, 4.0, "network", FRICTION, cost=1.7, starts=2, growth=2.9))
    if several:
        name = f"{NETWORK}, {BETWEEN}"
        found.append(_candidate(name, 4.1, "network", NEIGHBOURS, cost=1.7, starts=2, growth=2.9))
    return _with_springs(found, machine)


def is_arm(machine: Machine) -> bool:
    """Return whether a machine is probably an arm: four driven angles or more, nothing else.

    General links and large networks do not learn arms within a usual budget.
    """
    angular = machine.coordinates.angular
    return machine.driven and len(angular) >= ARM and all(angular)


def _with_springs(candidates: Iterable[Candidate], machine: Machine) -> list[Candidate]:
    """Return candidates in their order, with springs where these explain the motion."""
    found = sorted(candidates, key=lambda candidate: candidate.rank)
    return found if machine.stiffness is None else [_sprung(one, machine) for one in found]


def _in_space(machine: Machine) -> list[Candidate]:
    """Return rigid links in space, for three angles or more; arms with motors have them first."""
    n, angular = machine.coordinates.n, machine.coordinates.angular
    if n < 3 or not all(angular):
        return []
    found = _candidate("rigid links in space", 2.0, "rigid", FRICTION, cost=1.8, growth=0.4)
    if not machine.driven:
        return [found]
    start = math.exp(sum(map(math.log, machine.friction)) / n)
    settings = {**found.settings, "dissipation.start": f"{start:.2g}"}
    rank = 0.9 if is_arm(machine) else found.rank
    return [replace(found, rank=rank, settings=settings, forces=FORCE_EPOCHS, drawn=True)]


def _turning(machine: Machine) -> list[Candidate]:
    """Return a candidate of every structure of a machine that turns freely, the simplest first."""
    found = []
    if machine.body:
        learned = {"lagrangian.learned_inputs": str(machine.learned_inputs)}
        given = {"lagrangian.radius": f"{machine.radius:g}", **learned, **_drag(machine)}
        first = _candidate(BODY, 1.0, "body", given, 1.6)
        found.append(first)
        if machine.learned_inputs:
            width = {"lagrangian__input_width": "4"}
            found.append(first.changed("inputs that depend on the attitude", 0.8, 1.3, **width))
        width = {"lagrangian__potential_width": "8"}
        found.append(first.changed("learned potential", 1.2, 1.3, **width))
    if not machine.learned_inputs:
        friction = _drag(machine) if machine.body else {"dissipation": "viscous"}
        found.append(_candidate(NETWORK, 4.0, "turning network", friction, 2.5, 2, 3.0))
    return found


def _drag(machine: Machine) -> dict[str, str]:
    """Return the settings of the drag of a body."""
    return {"dissipation": "body_drag", "dissipation.radius": f"{machine.radius:g}"}


def ladder(machine: Machine) -> list[Candidate]:
    """Return the candidates that every search begins with, the simplest first."""
    found = structures(machine)
    first = found[0]
    if machine.known:
        kinds = ("asymmetric friction", "constant force")
        return [*found, _with_kinds(first, kinds, 0.2, machine)] if machine.driven else found
    if machine.coordinates.rotations:
        found.append(next(with_less_friction(first)))
        return sorted(found, key=lambda candidate: candidate.rank)
    links = [one for one in found if one.settings["lagrangian"] == "planar"]
    plain = list(without_springs(first))
    links += plain
    found += plain
    if machine.driven:  # motors, screws and belts
        found.append(_with_kinds(first, ("asymmetric friction", "constant force"), 0.2, machine))
    else:  # bearings: dry friction may be too little to be found
        found += [next(with_less_friction(candidate)) for candidate in links]
    if networks := [one for one in found if one.name.split(", ")[0] == NETWORK]:
        found.append(_with_learned_friction(networks[0], machine))
    return sorted(found, key=lambda candidate: candidate.rank)


def variations(candidate: Candidate, machine: Machine) -> Iterator[Candidate]:
    """Yield candidates that differ from one in a single respect, the most promising first.

    Without motors, those with the friction of motors are the last.
    """
    settings = candidate.settings
    if machine.coordinates.rotations:
        yield from _of_turning(candidate, machine)
        return
    motors = [
        _with_kinds(candidate, (kind,), more, machine)
        for kind, more in KINDS.items()
        if settings["dissipation"] in ("friction", "machine", "known")
        and settings.get(_switch(kind)) != "true"
    ]
    if settings["dissipation"] == "viscous":
        yield candidate.changed("dry friction", 0.3, dissipation="friction")
    if "springs" not in settings and machine.stiffness is not None and not machine.known:
        yield _sprung(candidate, machine)
    yield from finer(candidate, machine)
    if machine.driven:
        yield from _delayed(candidate, machine)
        yield from motors
    if settings["dissipation"] in ("friction", "viscous", "known"):
        yield _with_learned_friction(candidate, machine)
    if "springs" not in settings and machine.stiffness is None and not machine.known:
        yield _sprung(candidate, machine)
    if machine.driven and "optimizer.input_weight" not in settings:
        force = machine.units.size("N m" if any(machine.coordinates.angular) else "N")
        weight = f"{INPUT_NOISE * force:g}"
        yield candidate.changed("noisy inputs", 0.4, 1.5, optimizer__input_weight=weight)
    if not machine.driven:
        yield from motors


def _of_turning(candidate: Candidate, machine: Machine) -> Iterator[Candidate]:
    """Yield variations of a candidate with rotations, the most promising first."""
    settings = candidate.settings
    if settings["dissipation"] == "viscous" and machine.body:
        yield _with_friction(candidate, _drag(machine), PLACE_AND_START, FRICTION_NAMES, "")
    yield from finer(candidate, machine)
    if machine.driven:
        yield from _delayed(candidate, machine)
    if settings["dissipation"] in ("viscous", "body_drag"):
        learned, name = {"dissipation": "learned"}, "learned friction"
        yield _with_friction(candidate, learned, PLACE_AND_START, FRICTION_NAMES, name)


def finer(candidate: Candidate, machine: Machine) -> Iterator[Candidate]:
    """Yield variations with a more accurate integration, the most promising first."""
    whole = "system.time_step" not in candidate.settings
    halved = with_half_the_step(candidate, machine) if whole else []
    found = [*halved, *of_higher_order(candidate)]
    # motors stick and slip within a step, which no polynomial of a higher order follows
    yield from found if machine.driven else reversed(found)


def with_half_the_step(candidate: Candidate, machine: Machine) -> list[Candidate]:
    """Return the variation with half of its time step, none if no recording has samples for it."""
    step = float(candidate.settings.get("system.time_step", machine.time_step)) / 2
    if step < machine.finest_step * (1 - 1e-3):
        return []
    count = round(machine.time_step / step)
    share = f"half {THE_STEP}" if count == 2 else f"1/{count} of {THE_STEP}"
    parts = [part for part in candidate.name.split(", ") if not part.endswith(THE_STEP)]
    halved = candidate.changed(share, 0.2, 2.0, system__time_step=f"{step:g}")
    return [replace(halved, name=", ".join([*parts, share]))]


def _delayed(candidate: Candidate, machine: Machine) -> Iterator[Candidate]:
    """Yield variations with a delay of the inputs: what the motion shows, and half a sample.

    Digital controllers hold inputs between samples, so that they act half a sample after their
    record. Delays that differ by little from another one or none are left out. Where all candidates
    have the delay that the motion shows, none is the variation: regressions may represent a machine
    badly.
    """
    if "data.input_delay" in candidate.settings:
        return
    if machine.delay is None:
        if any(word.startswith("data.input_delay=") for word in machine.settings):
            yield candidate.changed("no delay", 0.2, data__input_delay="0")
        return
    near, held = HELD * machine.time_step, 0.5 * machine.finest_step
    delays = [machine.delay] if machine.delay else []
    delays += [held] if min(held, abs(held - machine.delay)) > near else []
    for delay in delays:
        name, value = f"delay {1e3 * delay:.2g} ms", f"{delay:.2g}"
        yield candidate.changed(name, 0.2, data__input_delay=value)


def of_higher_order(candidate: Candidate) -> list[Candidate]:
    """Return the variation with an integrator of order 4, none if the candidate has it."""
    if candidate.settings["integrator"] != "midpoint":
        return []
    return [candidate.changed("Galerkin order 4", 0.3, 3.6, integrator="galerkin4")]


def without_springs(candidate: Candidate) -> Iterator[Candidate]:
    """Yield a candidate without its springs, nothing if it has none."""
    if "springs" in candidate.settings:
        parts = candidate.name.split(", ")
        yield replace(
            candidate,
            name=", ".join(part for part in parts if part != SPRINGS),
            rank=candidate.rank - SPRINGS_RANK,
            settings=left_open(candidate.settings, ["springs"]),
        )


def with_less_friction(candidate: Candidate) -> Iterator[Candidate]:
    """Yield simplifications of a candidate: viscous friction alone, then none."""
    if candidate.settings["dissipation"] not in ("viscous", "known", "none"):
        viscous, name = {"dissipation": "viscous"}, "viscous friction"
        yield _with_friction(candidate, viscous, PLACE_AND_START, FRICTION_NAMES, name)
    if candidate.settings["dissipation"] != "none":
        none, replaced = {"dissipation": "none"}, {*FRICTION_NAMES, BETWEEN}
        yield _with_friction(candidate, none, (), replaced, "no friction")


def with_friction_of(candidate: Candidate, other: Candidate) -> Candidate:
    """Return a candidate with the friction of another one.

    Where friction acts, on coordinates or between neighbours, and its start remain.
    """
    given = {
        key: value
        for key, value in other.settings.items()
        if key.startswith("dissipation") and key not in PLACE_AND_START
    }
    name = ", ".join(part for part in other.name.split(", ") if part in FRICTION_NAMES)
    return _with_friction(candidate, given, PLACE_AND_START, FRICTION_NAMES, name)


def structure_of(candidate: Candidate) -> tuple[tuple[str, str], ...]:
    """Return the settings of a candidate that are not those of its friction, sorted."""
    settings = candidate.settings.items()
    return tuple(sorted((k, v) for k, v in settings if not k.startswith("dissipation")))


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

    What either switches on is on.
    """
    if other == base:
        return one
    settings = dict(one.settings)
    for key, value in other.settings.items():
        if base.settings.get(key) != value and settings.get(key) != "true":
            settings[key] = value
    added = other.name.removeprefix(f"{base.name}, ")
    return Candidate(
        name=f"{one.name}, {added}",
        rank=one.rank + other.rank - base.rank,
        settings=settings,
        cost=one.cost * other.cost / base.cost,
        starts=one.starts,
        growth=one.growth,
        forces=one.forces,
        drawn=one.drawn,
    )


def _with_kinds(
    candidate: Candidate, kinds: Sequence[str], more: float, machine: Machine
) -> Candidate:
    """Return a variation with some of the kinds of friction that machines have."""
    off = dict.fromkeys(map(_switch, KINDS), "false") | {
        "dissipation": "machine",
        "dissipation.least_rest_velocity": f"{LEAST_REST * machine.rest_velocity:g}",
        "dissipation.stribeck_velocity": f"{STRIBECK * machine.rest_velocity:g}",
    }
    on = dict.fromkeys(map(_switch, kinds), "true")
    settings = {**off, **_learned_anew(candidate, machine), **on, "dissipation": "machine"}
    cost = FRICTION_COST["machine"] / _friction_cost(candidate.settings)
    return replace(candidate.changed(", ".join(kinds), more, cost), settings=settings)


def _switch(kind: str) -> str:
    """Return the setting that switches a kind of friction on."""
    return f"dissipation.{kind.partition(' ')[0].lower()}"


def _sprung(candidate: Candidate, machine: Machine) -> Candidate:
    found = candidate.changed(SPRINGS, SPRINGS_RANK, springs="linear")
    if machine.stiffness is None:
        return found
    start = override_value(machine.stiffness)
    return replace(found, settings={**found.settings, "springs.start": start})


def _with_friction(
    candidate: Candidate,
    given: Mapping[str, str],
    kept: Collection[str],
    replaced: Collection[str],
    name: str,
) -> Candidate:
    """Return a candidate with other settings of friction, whose name replaces others."""
    settings = {
        key: value
        for key, value in candidate.settings.items()
        if key in kept or not key.startswith("dissipation")
    } | dict(given)
    parts = [part for part in candidate.name.split(", ") if part not in replaced]
    return replace(
        candidate,
        name=", ".join([*parts, *([name] if name else [])]),
        rank=round(
            candidate.rank + _friction_rank(settings) - _friction_rank(candidate.settings), 9
        ),
        settings=settings,
        cost=candidate.cost * _friction_cost(settings) / _friction_cost(candidate.settings),
    )


def _friction_rank(settings: Mapping[str, str]) -> float:
    if settings["dissipation"] in FRICTION_RANK:
        return FRICTION_RANK[settings["dissipation"]]
    return sum(more for kind, more in KINDS.items() if settings.get(_switch(kind)) == "true")


def _friction_cost(settings: Mapping[str, str]) -> float:
    return FRICTION_COST.get(settings["dissipation"], 1.0)


def _learned_anew(candidate: Candidate, machine: Machine) -> dict[str, str]:
    """Return the settings of a candidate, with a start of other friction for that of a system."""
    settings = dict(candidate.settings)
    if settings.pop("dissipation.missing", None) is not None:
        for name in "rest_velocity", "learned_rest":
            settings.pop(f"dissipation.{name}")
        settings["dissipation.start"] = f"{min(machine.friction):g}"
    return settings


def _with_learned_friction(candidate: Candidate, machine: Machine) -> Candidate:
    more = FRICTION_RANK["learned"] - _friction_rank(candidate.settings)
    cost = FRICTION_COST["learned"] / _friction_cost(candidate.settings)
    found = replace(candidate, settings=_learned_anew(candidate, machine))
    return found.changed("learned friction", more, cost, dissipation="learned")


def _candidate(
    name: str,
    rank: float,
    structure: str,
    friction: Mapping[str, str],
    cost: float = 1.0,
    starts: int = 1,
    growth: float = 0.0,
) -> Candidate:
    settings = {"integrator": "midpoint", **STRUCTURES[structure], **friction}
    return Candidate(name, rank, settings, cost, starts, growth)
