"""Units, inertia, friction and stiffness of a machine, with which its training starts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from symo_exp.data.diagnose import POOR
from symo_exp.data.explained import contradiction, input_gains, spring_slopes
from symo_exp.data.weak import Motion, quasi_coordinates
from symo_exp.identify.inputs import Timing
from symo_exp.identify.pace import vibration
from symo_exp.identify.sampled import Sampled, along_turns, scaled_motions, with_inputs
from symo_exp.mechanics.types import Coordinates
from symo_exp.mechanics.units import SI, Units

CONTRADICTED = 2.0
"""Unexplained power with an input matrix over that with any from which the matrix is learned."""
REST = 0.05
"""Velocity below which dry friction fades, over the root mean square of a coordinate's."""
USUAL_REST = 0.1
"""That of machines that are not slow, in their units: the default of dissipation.rest_velocity."""
SLOW = 0.3
"""Share of the usual one below which it is lowered."""
DAMPING = 0.01
"""Friction at the start of training over the inertia, in the units of the machine."""
HELD_BACK = 0.3
"""Share of the forces of inputs that friction starts with where residuals are forces at first."""
FAR = 100.0
"""Factor from 1 up to which times and inertias are learned in SI units."""
NARROW, WIDE = 1e-5, 10.0
"""Radii of gyration of a body at least and at most [units of length]."""
USUAL_RADIUS = 1.0
"""That with which training starts if the inputs do not show it: the ratio of inertia and mass of a
body is not determined then [units of length]."""


@dataclass(frozen=True, kw_only=True)
class InitialSizes:
    """Units and sizes with which training starts.

    Args:
        units: Those in which parameters are learned.
        radius: Radius of gyration of a body that turns freely, in ``units``.
        friction: Friction of each coordinate where residuals are forces at first, in ``units``.
        rest_velocity: Below which dry friction fades at first, in ``units``: a small part of the
            speed of the slowest coordinate.
        stiffness: Of springs that explain what gravity does not, in ``units``; else ``None``.
        settings: Overrides of all candidates.
        notes: The inferred sizes, a line each.
    """

    units: Units
    radius: float = USUAL_RADIUS
    friction: tuple[float, ...] = ()
    rest_velocity: float
    stiffness: tuple[tuple[float, ...], ...] | None
    settings: tuple[str, ...]
    notes: tuple[str, ...]


def initial_sizes(
    timing: Timing,
    coordinates: Coordinates,
    h: float,
    input_matrix: np.ndarray | None,
    *,
    scale: Mapping[str, float],
    known: bool,
) -> InitialSizes:
    """Return the units and sizes that motions show.

    Args:
        timing: The motions at nodes, and when their inputs act.
        coordinates: Those of the machine.
        h: Distance of the nodes [s].
        input_matrix: That of the inputs, zero where it is to be learned; ``None``: no inputs.
        scale: Units of parameters that are given, by name.
        known: Whether the equations are known, in SI units and with values to start from.
    """
    units, mass = SI, scale.get("mass", 1.0)
    if not known:
        units = _units(timing.motions, coordinates, h)._replace(**{**scale, "mass": 1.0})
    space, step = coordinates._replace(units=units), h / units.time
    pairs = scaled_motions(with_inputs(timing.motions, h, timing.delay), space)
    settings: list[str] = []
    notes: list[str] = []
    inertia, radius, friction = 1.0, USUAL_RADIUS, (DAMPING,) * coordinates.n
    acts = any(bool(u.any()) for _, u in pairs)
    if input_matrix is not None and acts and (timing.explained or 0.0) > POOR:
        matrix = input_matrix * space.sizes.numpy()[:, None] / units.size("N m")
        inertia, radius = _inertia(pairs, coordinates, step, matrix)
        if not known:
            source = "as inputs suggest" if timing.vary else "a guess, because inputs never change"
            notes.append(f"scale: training starts with an inertia of {inertia:.2g}, {source}")
            mass = scale.get("mass", _unit(inertia, FAR))
            inertia /= mass
            settings.append(f"lagrangian.initial_inertia={inertia:.2g}")
            settings.append(f"dissipation.start={DAMPING * inertia:.2g}")
            wrong = contradiction(pairs, coordinates, step, matrix)
            if wrong is not None and wrong >= CONTRADICTED:
                settings.append("model.inputs=learned")
                notes.append(
                    f"input matrix: with the given one, {wrong:.2g} times as much power is not "
                    "explained as with any; it is learned (model.inputs=given keeps it)"
                )
        if not coordinates.rotations:
            friction = _friction(pairs, matrix / mass)
    units = units._replace(mass=mass)
    if units != SI:
        sized = units._asdict().items()
        settings += [f"system.scale.{name}={size:g}" for name, size in sized if size != 1.0]
        told = "" if scale else ", in which the motion is of order one"
        notes.append(
            f"units: parameters are learned in {units.length:g} m, {units.time:g} s and "
            f"{units.mass:g} kg{told}"
        )
    rest = USUAL_REST  # bodies that turn freely have no joints with dry friction
    if not coordinates.rotations:
        rest = _rest_velocity([q for q, _ in pairs], step)
    if rest != USUAL_REST:
        settings.append(f"dissipation.rest_velocity={rest:g}")
        speeds = " or ".join(f"{unit}/s" for unit in coordinates.units_of_errors)
        unit = speeds if units == SI else "units of velocity"
        notes.append(f"friction: a slow machine, dry friction fades below {rest:g} {unit}")
    stiffness = _stiffness(pairs, coordinates, step, inertia)
    if stiffness is not None:
        notes.append("springs: they explain accelerations that gravity does not")
    return InitialSizes(
        units=units,
        radius=float(f"{radius:.2g}"),
        friction=friction,
        rest_velocity=rest,
        stiffness=stiffness,
        settings=tuple(settings),
        notes=tuple(notes),
    )


def _units(motions: Sequence[Sampled], coordinates: Coordinates, h: float) -> Units:
    """Return units of length and time in which motions are of order one, with SI prefixes.

    Lengths have the prefix nearest to the range of those that move, so that logs in m and in mm are
    learned as the same; with rotations, if it is far from 1 m, since bodies are smaller than their
    flights. Time has the unit s unless the motion is faster or slower by ``FAR``.
    """
    if not motions:
        return SI
    count = len(coordinates.flat)
    places = [nodes[:, :count] for _, _, nodes in motions]
    moves = np.any([np.ptp(q, axis=0) > 0.0 for q in places], axis=0)
    q = np.concatenate(places)[:, moves & ~np.array(coordinates.angular[:count], dtype=bool)]
    paths = [
        (along_turns(one, coordinates), nodes, quasi_coordinates(q, coordinates))
        for one, nodes, q in motions
    ]  # fmt: skip
    frequency = vibration(paths, h)
    return Units(
        length=_unit(
            float(np.ptp(q, axis=0).max(initial=0.0)), FAR if coordinates.rotations else 1.0
        ),
        time=_unit(1.0 / frequency, FAR) if frequency > 0.0 else 1.0,
    )


def _unit(size: float, far: float) -> float:
    """Return the power of 1000 nearest to a size, 1 where it is up to ``far`` from 1 or zero."""
    if not size > 0.0 or 1.0 / far <= size <= far:
        return 1.0
    return float(f"1e{3 * round(np.log10(size) / 3)}")


def _inertia(
    pairs: Sequence[Motion], coordinates: Coordinates, h: float, input_matrix: np.ndarray
) -> tuple[float, float]:
    """Return the inertia that the inputs move and, of a free body, its radius of gyration.

    The inertia is that of the lightest coordinates, the mass of a free body. A training that starts
    with too much inertia does not find its way: the accelerations due to the inputs are then lost
    among those of the potential and of friction. If the input matrix is to be learned, the inertia
    is such that its entries are about one.
    """
    gains = input_gains(pairs, coordinates, h)
    assert gains is not None
    moves, acts = gains.any(axis=1), gains.any(axis=0)  # what never moves or acts has no gains
    gains, input_matrix = gains[:, acts], input_matrix[:, acts]
    if not coordinates.rotations:
        size = float(np.linalg.norm(gains))
        return (float(np.linalg.norm(input_matrix[moves])) / size if size > 0 else 1.0), 1.0
    turns = np.array(coordinates.turning)
    if not input_matrix.any():
        size = float(np.abs(gains).max(initial=0.0))
        return (1.0 / size if size > 0 else 1.0), USUAL_RADIUS
    mass, inertia = (
        float(np.linalg.norm(input_matrix[rows])) / max(float(np.linalg.norm(gains[rows])), 1e-300)
        for rows in (moves & ~turns, moves & turns)
    )
    if not (mass > 0.0 and inertia > 0.0):
        return max(mass, inertia), USUAL_RADIUS
    return mass, float(np.clip(np.sqrt(inertia / mass), NARROW, WIDE))


def _friction(pairs: Sequence[Motion], input_matrix: np.ndarray) -> tuple[float, ...]:
    """Return a share of the forces of the inputs, a start that is not too small by far."""
    forces = np.concatenate([u for _, u in pairs]) @ input_matrix.T
    sizes = HELD_BACK * np.sqrt(np.mean(forces**2, axis=0))
    return tuple(float(f"{x:.2g}") for x in np.where(sizes > 0.0, sizes, sizes.max()))


def _stiffness(
    pairs: Sequence[Motion], coordinates: Coordinates, h: float, inertia: float
) -> tuple[tuple[float, ...], ...] | None:
    """Return the stiffness of springs at that inertia, ``None`` if they explain little.

    Training does not find springs from none within some tens of epochs: the inertia of what they
    move falls instead.
    """
    slopes = spring_slopes(pairs, coordinates, h)
    if slopes is None:
        return None
    stiffness = -0.5 * inertia * (slopes + slopes.T)
    return tuple(tuple(float(f"{x:.3g}") for x in row) for row in stiffness)


def _rest_velocity(paths: Sequence[np.ndarray], h: float) -> float:
    """Return a small part of the speed of the slowest coordinate that moves, if it is slow."""
    if not paths:
        return USUAL_REST
    speeds = np.concatenate([np.diff(q, axis=0) / h for q in paths])
    pace = np.sqrt(np.mean(speeds**2, axis=0))
    slowest = float(pace[pace > 0].min(initial=np.inf))
    found = float(f"{REST * slowest:.1g}")
    return found if found < SLOW * USUAL_REST else USUAL_REST
