"""Where trajectories start and how they are driven."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from symo_exp.errors import ConfigError

Range = tuple[float, float]


class SamplingBox(NamedTuple):
    """Where trajectories start and how they are driven: ``(low, high)`` of uniform draws.

    One range for each coordinate of ``q`` [m or rad], of ``v`` [m/s or rad/s] and for each
    control of ``u`` [N or N m], which is constant along a trajectory.
    """

    q: tuple[Range, ...]
    v: tuple[Range, ...]
    u: tuple[Range, ...]

    def points(self, count: int, seed: int) -> tuple[Tensor, Tensor, Tensor]:
        """``count`` draws of ``(q, v, u)`` in float64, always the same for a seed."""
        generator = torch.Generator().manual_seed(seed)
        points = []
        for ranges in self:
            low, high = torch.tensor(ranges, dtype=torch.float64).reshape(-1, 2).T
            share = torch.rand(count, len(ranges), dtype=torch.float64, generator=generator)
            points.append(low + share * (high - low))
        return points[0], points[1], points[2]


def completed(given: Any, own: SamplingBox) -> dict[str, Any]:
    """``given``, a box, parts of one or nothing, with what it leaves out from ``own``."""
    parts = given._asdict() if isinstance(given, SamplingBox) else dict(given or {})
    return own._asdict() | {name: part for name, part in parts.items() if part is not None}


def checked(given: SamplingBox | Mapping[str, Sequence[Range]], n: int, m: int) -> SamplingBox:
    """Ranges of plain numbers, one for each of ``n`` coordinates and ``m`` controls."""
    parts = given._asdict() if isinstance(given, SamplingBox) else dict(given)
    if set(parts) != set(SamplingBox._fields):
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
            f"system.box.{name}={ranges}: expected a list of {count} pair(s) [low, high] "
            "with low <= high"
        )
    return pairs
