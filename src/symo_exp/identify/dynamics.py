"""Properties of a machine's dynamics that its motions show."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from symo_exp.data.delays import acting_late
from symo_exp.data.table import Recording
from symo_exp.evaluation.horizon import HORIZONS
from symo_exp.identify.inputs import timing
from symo_exp.identify.pace import growth_of_errors, suitable_horizons
from symo_exp.identify.sampled import EXAMINED, NODES, at_nodes, first_seconds, with_inputs
from symo_exp.identify.scales import USUAL_RADIUS, initial_sizes
from symo_exp.identify.senses import told_reversed
from symo_exp.mechanics.types import Coordinates
from symo_exp.mechanics.units import Units


@dataclass(frozen=True, kw_only=True)
class Dynamics:
    """Properties of a machine's dynamics that its motions show.

    Args:
        rest_velocity: Below which dry friction fades at first, in ``units``: a small part of the
            speed of the slowest coordinate.
        units: Those in which parameters are learned.
        delay: Of the inputs [s], if one explains the motion better than none; else 0; ``None`` if
            ``settings`` have it.
        explained: Share of the accelerations' power that is explained; ``None``: unknown.
        stiffness: Of springs that explain what gravity does not, in ``units``; else
            ``None``.
        horizon: Longest time over which errors are compared [s].
        friction: Friction of each coordinate to start from where residuals are forces at first, in
            ``units``.
        radius: Radius of gyration of a body that turns freely, in ``units``.
        settings: Overrides that every candidate has.
        notes: The inferred properties, a line each.
    """

    rest_velocity: float
    units: Units
    delay: float | None
    explained: float | None
    stiffness: tuple[tuple[float, ...], ...] | None
    horizon: float = HORIZONS[-1]
    friction: tuple[float, ...] = ()
    radius: float = USUAL_RADIUS
    settings: tuple[str, ...]
    notes: tuple[str, ...]


def dynamics(
    recordings: Sequence[Recording],
    coordinates: Coordinates,
    time_step: float,
    input_matrix: np.ndarray | None,
    *,
    scale: Mapping[str, float],
    known: bool,
) -> Dynamics:
    """Return the dynamics that recordings show.

    Args:
        recordings: Configurations (T, N), angles in radians and rotations as their nine entries.
        coordinates: Those of the machine.
        time_step: Distance of the nodes [s].
        input_matrix: That of the inputs, zero where it is to be learned; ``None``: no inputs.
        scale: Units of parameters that are given, by name.
        known: Whether the equations are known, in SI units and with values to start from.
    """
    recordings = first_seconds(recordings, max(EXAMINED, NODES * time_step))
    rotations = coordinates.space.normalised  # whose entries are fitted one by one
    motions = [
        (one, nodes, rotations(torch.tensor(q)).numpy())
        for one, nodes, q in at_nodes(recordings, time_step)
    ]
    driven = input_matrix is not None
    acting = timing(motions, coordinates, time_step, driven=driven, known=known)
    sizes = initial_sizes(acting, coordinates, time_step, input_matrix, scale=scale, known=known)
    settings, notes = [*acting.settings, *sizes.settings], [*sizes.notes]
    if not known:
        pairs = with_inputs(acting.motions, time_step, acting.delay)
        notes += told_reversed(pairs, coordinates, time_step, input_matrix)
    delay = acting.delay if acting.clear else 0.0
    late = [acting_late(one, lag=acting.lag) for one in recordings] if acting.lag else recordings
    horizons = suitable_horizons(growth_of_errors(late, coordinates, time_step, delay))
    if horizons != HORIZONS:
        times = ", ".join(f"{each:g}" for each in horizons)
        settings.append(f"learner.validation.horizons=[{times}]")
        notes.append(
            f"unstable: the errors of predictions grow fast; those over {times} s are compared"
        )
    return Dynamics(
        rest_velocity=sizes.rest_velocity,
        units=sizes.units,
        delay=None if acting.clear else acting.delay,
        explained=acting.explained,
        stiffness=sizes.stiffness,
        horizon=horizons[-1],
        friction=sizes.friction,
        radius=sizes.radius,
        settings=tuple(settings),
        notes=(*notes, *acting.notes) if driven else tuple(notes),
    )
