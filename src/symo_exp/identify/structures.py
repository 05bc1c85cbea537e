"""The candidates of a machine that a search begins with, the simplest first."""

from __future__ import annotations

import math
from collections.abc import Mapping
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
PLANAR = {"lagrangian": "planar"}
WIDE = {"lagrangian": "network", "net.width": "8"}
SMALL = {"lagrangian": "network", "net.width": "2", "net.depth": "1", "lagrangian.harmonics": "1"}


def ladder(machine: Machine) -> list[Candidate]:
    """Return the candidates that every search begins with, the simplest first."""
    found = structures(machine)
    first = found[0]
    kinds = ("asymmetric friction", "constant force")  # of motors, screws and belts
    motors = [with_kinds(first, kinds, 0.2, machine)] if machine.driven else []
    if machine.known:
        return [*found, *motors]
    if machine.coordinates.rotations:
        found.append(next(with_less_friction(first)))
        return sorted(found, key=lambda candidate: candidate.rank)
    links = [one for one in found if one.settings["lagrangian"] == "planar"]
    plain = list(without_springs(first))
    links += plain
    found += plain
    found += motors
    if not machine.driven:  # bearings: dry friction may be too little to be found
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
        known = _candidate(KNOWN, 1.0, {"lagrangian": "known"}, friction, growth=0.4)
        return [replace(known, forces=FORCE_EPOCHS if machine.driven else 0)]
    if machine.coordinates.rotations:
        return _turning(machine)
    several = sum(machine.coordinates.angular) > 1
    relative = ", relative angles" if several else ""
    # without inputs only the ratio to the inertia counts, and from too little friction fits hang;
    # with inputs no friction is suitable for all machines, and a second start finds the fit
    start = {} if machine.driven else {"dissipation.start": override_value(FREE_DAMPING)}
    starts = 2 if machine.driven else 1
    found = [
        *_in_space(machine),
        _candidate(f"{LINKS}{relative}", 1.0, PLANAR, FRICTION | start, 1.0, starts),
        _candidate("small network", 3.0, SMALL, FRICTION, 1.3, 2),
    ]
    if not _is_arm(machine):
        general, network = {"lagrangian": "relative"}, WIDE | {"lagrangian.harmonics": "2"}
        found += [
            _candidate(f"general links{relative}", 1.8, general, FRICTION, 1.2, starts, 1.5),
            _candidate(NETWORK, 4.0, network, FRICTION, 1.7, 2, 2.9),
        ]
        if several:
            planar, general = {**PLANAR, "lagrangian.relative": "false"}, {"lagrangian": "absolute"}
            links, general_links = f"{LINKS}, absolute angles", "general links, absolute angles"
            found += [
                _candidate(links, 1.1, planar, NEIGHBOURS | start, 1.0, starts),
                _candidate(general_links, 1.9, general, NEIGHBOURS, 1.2, starts, 1.5),
                _candidate(f"{NETWORK}, {BETWEEN}", 4.1, network, NEIGHBOURS, 1.7, 2, 2.9),
            ]
    found.sort(key=lambda candidate: candidate.rank)
    return found if machine.stiffness is None else [sprung(one, machine) for one in found]


def _candidate(
    name: str,
    rank: float,
    lagrangian: Mapping[str, str],
    friction: Mapping[str, str],
    cost: float = 1.0,
    starts: int = 1,
    growth: float = 0.0,
) -> Candidate:
    settings = {"integrator": "midpoint", **lagrangian, **friction}
    return Candidate(name, rank, settings, cost, starts, growth)


def _in_space(machine: Machine) -> list[Candidate]:
    """Return rigid links in space, for three angles or more; arms with motors have them first."""
    n, angular = machine.coordinates.n, machine.coordinates.angular
    if n < 3 or not all(angular):
        return []
    rigid = {"lagrangian": "rigid"}
    found = _candidate("rigid links in space", 2.0, rigid, FRICTION, cost=1.8, growth=0.4)
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


def _turning(machine: Machine) -> list[Candidate]:
    """Return a candidate of every structure of a machine that turns freely, the simplest first."""
    found = []
    if machine.body:
        learned = {"lagrangian.learned_inputs": str(machine.learned_inputs)}
        given = {"lagrangian": "rigid_body", "lagrangian.radius": f"{machine.radius:g}", **learned}
        first = _candidate(BODY, 1.0, given, drag(machine), 1.6)
        found.append(first)
        if machine.learned_inputs:
            width = {"lagrangian__input_width": "4"}
            found.append(first.changed("inputs that depend on the attitude", 0.8, 1.3, **width))
        width = {"lagrangian__potential_width": "8"}
        found.append(first.changed("learned potential", 1.2, 1.3, **width))
    if not machine.learned_inputs:
        friction = drag(machine) if machine.body else {"dissipation": "viscous"}
        network = WIDE | {"lagrangian.harmonics": "0"}
        found.append(_candidate(NETWORK, 4.0, network, friction, 2.5, 2, 3.0))
    return found
