"""The candidates of a machine that a search begins with, the simplest first."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace

from symo_exp.identify.candidates import Candidate
from symo_exp.identify.recordings import Machine
from symo_exp.identify.variations import (
    BETWEEN,
    drag,
    sprung,
    with_kinds,
    with_learned_friction,
    with_less_friction,
    without_springs,
)
from symo_exp.shell import override_value

FREE_DAMPING = 1.0
"""Friction at the start of training over the inertia, of machines without inputs."""
LINKS, BODY, NETWORK, KNOWN = "rigid links", "rigid body", "network", "known equations"
FRICTION = {"dissipation": "friction"}
NEIGHBOURS = {"dissipation": "friction", "dissipation.joints": "neighbours"}
SHARP = 0.2
"""Initial width of the dry friction of known equations over the usual one."""
FORCE_EPOCHS = 20
"""Epochs in which residuals are forces, where equations are known and of rigid links in space."""
ARM = 4
"""Number of driven angles from which links in a plane are less probable than in space."""
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


def ladder(machine: Machine) -> list[Candidate]:
    """Return the candidates that every search begins with, the simplest first."""
    found = structures(machine)
    first = found[0]
    if machine.known:
        kinds = ("asymmetric friction", "constant force")
        return [*found, with_kinds(first, kinds, 0.2, machine)] if machine.driven else found
    if machine.coordinates.rotations:
        found.append(next(with_less_friction(first)))
        return sorted(found, key=lambda candidate: candidate.rank)
    links = [one for one in found if one.settings["lagrangian"] == "planar"]
    plain = list(without_springs(first))
    links += plain
    found += plain
    if machine.driven:  # motors, screws and belts
        found.append(with_kinds(first, ("asymmetric friction", "constant force"), 0.2, machine))
    else:  # bearings: dry friction may be too little to be found
        found += [next(with_less_friction(candidate)) for candidate in links]
    if networks := [one for one in found if one.name.split(", ")[0] == NETWORK]:
        found.append(with_learned_friction(networks[0], machine))
    return sorted(found, key=lambda candidate: candidate.rank)


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
    if _is_arm(machine):
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
    rank = 0.9 if _is_arm(machine) else found.rank
    return [replace(found, rank=rank, settings=settings, forces=FORCE_EPOCHS, drawn=True)]


def _is_arm(machine: Machine) -> bool:
    """Return whether a machine is probably an arm: four driven angles or more, nothing else.

    General links and large networks do not learn arms within a usual budget.
    """
    angular = machine.coordinates.angular
    return machine.driven and len(angular) >= ARM and all(angular)


def _with_springs(candidates: Iterable[Candidate], machine: Machine) -> list[Candidate]:
    """Return candidates in their order, with springs where these explain the motion."""
    found = sorted(candidates, key=lambda candidate: candidate.rank)
    return found if machine.stiffness is None else [sprung(one, machine) for one in found]


def _turning(machine: Machine) -> list[Candidate]:
    """Return a candidate of every structure of a machine that turns freely, the simplest first."""
    found = []
    if machine.body:
        learned = {"lagrangian.learned_inputs": str(machine.learned_inputs)}
        given = {"lagrangian.radius": f"{machine.radius:g}", **learned, **drag(machine)}
        first = _candidate(BODY, 1.0, "body", given, 1.6)
        found.append(first)
        if machine.learned_inputs:
            width = {"lagrangian__input_width": "4"}
            found.append(first.changed("inputs that depend on the attitude", 0.8, 1.3, **width))
        width = {"lagrangian__potential_width": "8"}
        found.append(first.changed("learned potential", 1.2, 1.3, **width))
    if not machine.learned_inputs:
        friction = drag(machine) if machine.body else {"dissipation": "viscous"}
        found.append(_candidate(NETWORK, 4.0, "turning network", friction, 2.5, 2, 3.0))
    return found
