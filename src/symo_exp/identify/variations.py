"""Candidates that differ from another one in a single respect."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

from symo_exp.data.resample import LONGEST_GAP, TIME_TOLERANCE
from symo_exp.identify.candidates import Candidate, left_open
from symo_exp.identify.recordings import Machine
from symo_exp.shell import override_value

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
INPUT_NOISE = 100.0
"""Noise of inputs over that of configurations where it is estimated, in units of the machine."""
THE_STEP = "the time step"
"""Words of the parts of names that say which share of the time step a candidate has."""
ORDER = "Galerkin order"
"""Words of those that say the order of its integrator."""
HIGHER = {"midpoint": (4, 3.6), "galerkin4": (6, 2.0)}
"""The next order of an integrator, and the cost of an epoch with it, relative to before."""
HELD = 0.05
"""Difference of delays over the time step up to which they count as equal."""


def variations(candidate: Candidate, machine: Machine) -> Iterator[Candidate]:
    """Yield candidates that differ from one in a single respect, the most promising first.

    Without motors, those with the friction of motors are the last.
    """
    settings = candidate.settings
    if machine.coordinates.rotations:
        yield from _of_turning(candidate, machine)
        return
    motors = [
        with_kinds(candidate, (kind,), more, machine)
        for kind, more in KINDS.items()
        if settings["dissipation"] in ("friction", "machine", "known")
        and settings.get(_switch(kind)) != "true"
    ]
    if settings["dissipation"] == "viscous":
        yield candidate.changed("dry friction", 0.3, dissipation="friction")
    if "springs" not in settings and machine.stiffness is not None and not machine.known:
        yield sprung(candidate, machine)
    if machine.driven:
        yield from with_finer_predictions(candidate)
    yield from finer(candidate, machine)
    if machine.driven:
        yield from _delayed(candidate, machine)
        yield from motors
    if settings["dissipation"] in ("friction", "viscous", "known"):
        yield with_learned_friction(candidate, machine)
    if "springs" not in settings and machine.stiffness is None and not machine.known:
        yield sprung(candidate, machine)
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
        yield _with_friction(candidate, drag(machine), "")
    yield from finer(candidate, machine)
    if machine.driven:
        yield from _delayed(candidate, machine)
    if settings["dissipation"] in ("viscous", "body_drag"):
        yield _with_friction(candidate, {"dissipation": "learned"}, "learned friction")


def finer(candidate: Candidate, machine: Machine) -> Iterator[Candidate]:
    """Yield variations with a more accurate integration, the most promising first."""
    whole = "system.time_step" not in candidate.settings
    halved = with_half_the_step(candidate, machine) if whole else []
    found = [*halved, *of_higher_order(candidate, machine)]
    # motors stick and slip within a step, which no polynomial of a higher order follows
    yield from found if machine.driven else reversed(found)


def with_half_the_step(candidate: Candidate, machine: Machine) -> list[Candidate]:
    """Return the variation with half of its time step, none if no recording has samples for it.

    There is also none if recordings would be cut at more gaps: errors over shorter pieces are
    smaller.
    """
    step = float(candidate.settings.get("system.time_step", machine.time_step)) / 2
    cut = machine.gap > LONGEST_GAP * step * (1 + TIME_TOLERANCE)
    if cut or machine.finest_step > step * (1 + TIME_TOLERANCE):
        return []
    count = round(machine.time_step / step)
    share = f"half {THE_STEP}" if count == 2 else f"1/{count} of {THE_STEP}"
    whole = _without(THE_STEP, candidate)
    return [whole.changed(share, 0.2, 2.0, system__time_step=f"{step:g}")]


def of_higher_order(candidate: Candidate, machine: Machine) -> list[Candidate]:
    """Return the variation with an integrator of the next order, 4 or 6, none if there is none.

    Order 6 is for recordings without samples for half the time step.
    """
    integrator = candidate.settings["integrator"]
    if integrator not in HIGHER or (
        integrator == "galerkin4" and with_half_the_step(candidate, machine)
    ):
        return []
    order, cost = HIGHER[integrator]
    lower = _without(ORDER, candidate)
    return [lower.changed(f"{ORDER} {order}", 0.3, cost, integrator=f"galerkin{order}")]


def with_finer_predictions(candidate: Candidate) -> list[Candidate]:
    """Return the variation that predicts in parts of time steps, none without dry friction.

    Its training is the same. Recorded motions that stick determine the parameters of dry friction,
    and velocities of the midpoint rule alternate where they should vanish.
    """
    dry = candidate.settings["dissipation"] not in ("none", "viscous", "body_drag")
    if candidate.settings["integrator"] != "midpoint" or not dry:
        return []
    return [candidate.changed("predictions in quarter steps", 0.1, integrator="refined_midpoint")]


def _without(said: str, candidate: Candidate) -> Candidate:
    """Return a candidate whose name has no part that says something."""
    parts = (part for part in candidate.name.split(", ") if said not in part)
    return replace(candidate, name=", ".join(parts))


def _delayed(candidate: Candidate, machine: Machine) -> Iterator[Candidate]:
    """Yield variations with a delay of the inputs: what the motion shows, and half a sample.

    Digital controllers hold inputs between samples, so that they act half a sample after their
    record. Delays that differ little from another one or from zero are left out. Where all
    candidates have the delay that the motion shows, the variation has no delay: regressions may
    represent a machine badly.
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
        name, value = f"delay {1e3 * delay:.3g} ms", f"{delay:.3g}"
        yield candidate.changed(name, 0.2, data__input_delay=value)


def sprung(candidate: Candidate, machine: Machine) -> Candidate:
    """Return a candidate with springs, which start with the stiffness that the motions show."""
    found = candidate.changed(SPRINGS, SPRINGS_RANK, springs="linear")
    if machine.stiffness is None:
        return found
    start = override_value(machine.stiffness)
    return replace(found, settings={**found.settings, "springs.start": start})


def without_springs(candidate: Candidate) -> Iterator[Candidate]:
    """Yield a candidate without its springs, nothing if it has none."""
    if "springs" in candidate.settings:
        rank, settings = candidate.rank - SPRINGS_RANK, left_open(candidate.settings, ["springs"])
        yield replace(_without(SPRINGS, candidate), rank=rank, settings=settings)


def drag(machine: Machine) -> dict[str, str]:
    """Return the settings of the drag of a body."""
    return {"dissipation": "body_drag", "dissipation.radius": f"{machine.radius:g}"}


def with_kinds(
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


def with_learned_friction(candidate: Candidate, machine: Machine) -> Candidate:
    """Return a candidate whose friction is a network."""
    more = FRICTION_RANK["learned"] - _friction_rank(candidate.settings)
    cost = FRICTION_COST["learned"] / _friction_cost(candidate.settings)
    found = replace(candidate, settings=_learned_anew(candidate, machine))
    return found.changed("learned friction", more, cost, dissipation="learned")


def with_less_friction(candidate: Candidate) -> Iterator[Candidate]:
    """Yield simplifications of a candidate: viscous friction alone, then none."""
    if candidate.settings["dissipation"] not in ("viscous", "known", "none"):
        yield _with_friction(candidate, {"dissipation": "viscous"}, "viscous friction")
    if candidate.settings["dissipation"] != "none":
        yield _with_friction(candidate, {"dissipation": "none"}, "no friction")


def with_friction_of(candidate: Candidate, other: Candidate) -> Candidate:
    """Return a candidate with the friction of another one."""
    given = {
        key: value
        for key, value in other.settings.items()
        if key.startswith("dissipation") and key not in PLACE_AND_START
    }
    name = ", ".join(part for part in other.name.split(", ") if part in FRICTION_NAMES)
    return _with_friction(candidate, given, name)


def _with_friction(candidate: Candidate, given: Mapping[str, str], name: str) -> Candidate:
    """Return a candidate with other settings of friction, whose name replaces others.

    Where friction acts, on coordinates or between neighbours, and its start remain if there is any.
    """
    none = given["dissipation"] == "none"
    kept = () if none else PLACE_AND_START
    replaced = {*FRICTION_NAMES, BETWEEN} if none else FRICTION_NAMES
    settings = {
        key: value
        for key, value in candidate.settings.items()
        if key in kept or not key.startswith("dissipation")
    } | dict(given)
    parts = (part for part in candidate.name.split(", ") if part not in replaced)
    more = _friction_rank(settings) - _friction_rank(candidate.settings)
    return replace(
        candidate,
        name=", ".join(filter(None, [*parts, name])),
        rank=round(candidate.rank + more, 9),
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


def _switch(kind: str) -> str:
    """Return the setting that switches a kind of friction on."""
    return f"dissipation.{kind.partition(' ')[0].lower()}"
