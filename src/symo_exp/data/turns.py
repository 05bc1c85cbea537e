"""Angles and rotations of samples: their units, jumps and norms."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from symo_exp.data.paths import titled
from symo_exp.data.resample import Samples
from symo_exp.data.table import Recording
from symo_exp.errors import ConfigError
from symo_exp.mechanics.types import Coordinates

FEW_NUMBERS = 8
"""Values of a coordinate up to which whole numbers are no sign of counts."""
UNIT = 1e-3
"""Largest difference of the norm of a quaternion from 1."""


def continuous(
    recordings: Sequence[Recording], coordinates: Coordinates, *, degrees: bool, wrapped: bool
) -> list[Recording]:
    """Return recordings, with quaternions, whose angles are in radians and go on beyond a turn.

    Args:
        recordings: The recordings as they are in a table, before they are divided: an angle at rest
            may jump from sample to sample.
        coordinates: Those of the machine.
        degrees: Whether angles and their velocities are in degrees.
        wrapped: Whether angles jump by a turn.
    """
    angular = _angles(coordinates)
    found = []
    for one in recordings:
        q, v = one.samples.q, one.samples.v
        if degrees:
            q = q * np.where(angular, np.pi / 180, 1.0)
            v = None if v is None else v * np.where(coordinates.turning, np.pi / 180, 1.0)
        if wrapped:
            q = np.where(angular, np.unwrap(q, axis=0), q)
        found.append(one._replace(samples=one.samples._replace(q=q, v=v)))
    return found


def turned(where: str, samples: Samples, coordinates: Coordinates) -> Samples:
    """Return samples with rotation matrices instead of quaternions.

    Raises:
        ConfigError: If a quaternion does not have the norm 1.
    """
    for i, name in enumerate(coordinates.rotations):
        first = len(coordinates.flat) + 4 * i
        size = np.linalg.norm(samples.q[:, first : first + 4], axis=1)
        worst = int(np.abs(size - 1.0).argmax())
        if not abs(size[worst] - 1.0) <= UNIT:
            raise ConfigError(
                f"{where}: q_{name}_w, q_{name}_x, q_{name}_y, q_{name}_z have the norm "
                f"{size[worst]:.6g} in row {worst + 1}; expected a unit quaternion, to within "
                f"{UNIT:g}"
            )
    if not coordinates.rotations:
        return samples
    return samples._replace(q=coordinates.space.of_quaternions(torch.tensor(samples.q)).numpy())


def refuse_turns(where: str, recordings: Sequence[Recording], coordinates: Coordinates) -> None:
    """Refuse angles that jump.

    Args:
        where: The beginning of the message.
        recordings: All that are used, angles in radians.
        coordinates: Those of the machine.

    Raises:
        ConfigError: If an angle changes by more than half a turn from one step to the next.
    """
    for one in recordings:
        q = one.samples.q
        bends = np.abs(np.diff(q, 2, axis=0)).max(0, initial=0)
        jumps = _angles(coordinates) & (bends > np.pi)
        if not jumps.any():
            continue
        turns = np.where(jumps, np.abs(np.diff(q, axis=0)).max(0), 0.0)
        name = coordinates.names[int(turns.argmax())]
        mend = "data.wrapped=true unwraps them) and must be in radians (data.degrees=true converts"
        if 300 < turns.max() < 400:
            mend = "data.degrees=true data.wrapped=true for degrees that jump by a turn"
        raise ConfigError(
            f"{where}: {titled(one.label)} turns q_{name} by {turns.max():.3g} rad in one step; "
            f"angles must not be wrapped ({mend}); remove rows in which a sensor fails; sample "
            "more often what turns so fast"
        )


def refuse_counts(
    where: str, coordinates: Coordinates, recordings: Sequence[Recording], degrees: bool | None
) -> None:
    """Refuse angles in whole numbers: they are counts of an encoder, or degrees.

    Args:
        where: The beginning of the message.
        coordinates: Those of the machine.
        recordings: All of a table, or those that are used.
        degrees: Whether angles are known to be in degrees.

    Raises:
        ConfigError: If any angle has more than ``FEW_NUMBERS`` values, all of them whole.
    """
    if degrees or not recordings:
        return
    for i, (name, angular) in enumerate(zip(coordinates.flat, coordinates.angular, strict=False)):
        if not angular:
            continue
        columns = [one.samples.q[:, i] for one in recordings]
        if are_counts(columns):
            low, high = min(x.min() for x in columns), max(x.max() for x in columns)
            raise ConfigError(
                f"{where}: q_{name} has whole numbers only, from {low:g} to {high:g}, "
                "and is an angle: convert counts of an encoder to radians in the file (counts "
                "times 2 pi over the counts of a turn), without jumps where counts start anew; "
                "for degrees, give data.degrees=true"
            )


def are_counts(columns: Sequence[np.ndarray]) -> bool:
    """Return whether a coordinate has more than ``FEW_NUMBERS`` values, all of them whole."""
    values = np.unique(np.concatenate(columns))
    return len(values) > FEW_NUMBERS and bool((values % 1 == 0).all())


def _angles(coordinates: Coordinates) -> np.ndarray:
    """Return which columns of configurations with quaternions are angles."""
    flat = len(coordinates.flat)
    return np.array([*coordinates.angular[:flat], *(False,) * (len(coordinates.measured) - flat)])
