"""Ranges of initial states and inputs."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from symo_exp.checks import dictionary
from symo_exp.errors import ConfigError
from symo_exp.words import counted

Range = tuple[float, float]


class SamplingBox(NamedTuple):
    """Ranges ``(low, high)`` of uniform initial states and constant inputs.

    Attributes:
        q: Range of each coordinate [m or rad]; of a rotation, of its rotation vector.
        v: Range of each velocity [m/s or rad/s].
        u: Range of each input [N or N m].
    """

    q: tuple[Range, ...]
    v: tuple[Range, ...]
    u: tuple[Range, ...]

    def points(self, count: int, seed: int) -> tuple[Tensor, Tensor, Tensor]:
        """Return ``count`` draws of ``(q, v, u)`` in float64, the same for the same seed."""
        generator = torch.Generator().manual_seed(seed)
        points = []
        for ranges in self:
            low, high = torch.tensor(ranges, dtype=torch.float64).reshape(-1, 2).T
            share = torch.rand(count, len(ranges), dtype=torch.float64, generator=generator)
            points.append(low + share * (high - low))
        return points[0], points[1], points[2]


def completed(given: Any, own: SamplingBox) -> dict[str, Any]:
    """Return the parts of a box, those that ``given`` lacks from ``own``."""
    parts = given._asdict() if isinstance(given, SamplingBox) else given
    parts = dictionary("system.box", {} if parts is None else parts, SamplingBox._fields)
    return own._asdict() | {name: part for name, part in parts.items() if part is not None}


def checked(given: SamplingBox | Mapping[str, Sequence[Range]], n: int, m: int) -> SamplingBox:
    """Return a box of plain numbers for ``n`` coordinates and ``m`` inputs.

    Raises:
        ConfigError: If a range is missing or not ordered.
    """
    parts = given._asdict() if isinstance(given, SamplingBox) else given
    if not isinstance(parts, Mapping) or set(parts) != set(SamplingBox._fields):
        raise ConfigError(f"system.box={parts}: expected ranges of q, v and u")
    counts = {"q": n, "v": n, "u": m}
    return SamplingBox(**{name: _ranges(name, parts[name], counts[name]) for name in counts})


def _ranges(name: str, ranges: Sequence[Range], count: int) -> tuple[Range, ...]:
    try:
        pairs = tuple((float(low), float(high)) for low, high in ranges)
    except (TypeError, ValueError):
        pairs = ()
    ordered = all(math.isfinite(low) and low <= high < math.inf for low, high in pairs)
    if len(pairs) != count or not ordered:
        raise ConfigError(
            f"system.box.{name}={ranges}: expected a list of {counted(count, 'pair')} [low, high] "
            "with low <= high"
        )
    return pairs
