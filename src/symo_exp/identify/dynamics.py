"""Properties of a machine's dynamics that its motions show."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from symo_exp.data.delays import acting_late
from symo_exp.data.table import Recording
from symo_exp.evaluation.horizon import HORIZONS
from symo_exp.identify.inputs import timing
from symo_exp.identify.pace import growth_of_errors, suitable_horizons
from symo_exp.identify.sampled import EXAMINED, NODES, at_nodes, first_seconds, with_inputs
from symo_exp.identify.scales import InitialSizes, initial_sizes
from symo_exp.identify.senses import told_reversed
from symo_exp.mechanics.types import Coordinates


@dataclass(frozen=True, kw_only=True)
class Dynamics(InitialSizes):
    """Properties of a machine's dynamics that its motions show, with the sizes to start from.

    Args:
        delay: Of the inputs [s], if one explains the motion better than none; else 0; ``None`` if
            ``settings`` have it.
        explained: Share of the accelerations' power that is explained; ``None``: unknown.
        horizon: Longest time over which errors are compared [s].

    The other arguments are those of ``InitialSizes``; ``settings`` and ``notes`` are those of the
    whole dynamics.
    """

    delay: float | None
    explained: float | None
    horizon: float = HORIZONS[-1]


def dynamics(
    recordings: Sequence[Recording],
    coordinates: Coordinates,
    time_step: float,
    input_matrix: np.ndarray | None,
    *,
    scale: Mapping[str, float],
    known: bool,
    acting: Collection[str],
) -> Dynamics:
    """Return the dynamics that recordings show.

    Args:
        recordings: Configurations (T, N), angles in radians and rotations as their nine entries.
        coordinates: Those of the machine.
        time_step: Distance of the nodes [s].
        input_matrix: That of the inputs, zero where it is to be learned; ``None``: no inputs.
        scale: Units of parameters that are given, by name.
        known: Whether the equations are known, in SI units and with values to start from.
        acting: Those of ``ACTING`` that are given, so that the inputs of the recordings act so.
    """
    recordings = first_seconds(recordings, max(EXAMINED, NODES * time_step))
    rotations = coordinates.space.normalised  # whose entries are fitted one by one
    motions = [
        (one, nodes, rotations(torch.tensor(q)).numpy())
        for one, nodes, q in at_nodes(recordings, time_step)
    ]
    driven = input_matrix is not None
    shown = timing(motions, coordinates, time_step, driven=driven, known=known, given=acting)
    sizes = initial_sizes(shown, coordinates, time_step, input_matrix, scale=scale, known=known)
    settings, notes = [*shown.settings, *sizes.settings], [*sizes.notes]
    if not known:
        pairs = with_inputs(shown.motions, time_step, shown.delay)
        notes += told_reversed(pairs, coordinates, time_step, input_matrix)
    delay = shown.delay if shown.clear else 0.0
    late = [acting_late(one, lag=shown.lag) for one in recordings]
    horizons = suitable_horizons(growth_of_errors(late, coordinates, time_step, delay))
    if horizons != HORIZONS:
        times = ", ".join(f"{each:g}" for each in horizons)
        settings.append(f"learner.validation.horizons=[{times}]")
        notes.append(
            f"unstable: the errors of predictions grow fast; those over {times} s are compared"
        )
    lists = {
        "settings": tuple(settings),
        "notes": (*notes, *shown.notes) if driven else tuple(notes),
    }
    return Dynamics(
        **vars(sizes) | lists,
        delay=None if shown.clear else shown.delay,
        explained=shown.explained,
        horizon=horizons[-1],
    )
