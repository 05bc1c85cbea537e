"""Where trajectories start and how they are driven: draws from the box of a system."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from symo_exp.systems.base import Range, SamplingBox


class Starts(NamedTuple):
    """Initial states and constant inputs, float64."""

    q: Float[Tensor, "count n"]
    v: Float[Tensor, "count n"]
    u: Float[Tensor, "count m"]


@runtime_checkable
class Draws(Protocol):
    """The starts of every set of trajectories, from the box of a system and a seed.

    ``counts`` says how many each set has. The fields of an instance and its class decide the
    starts: they are part of the key under which trajectories are kept.
    """

    @property
    def lead(self) -> int:
        """Steps from the state that is drawn to the first node."""

    def __call__(
        self, box: SamplingBox, counts: Mapping[str, int], seed: int
    ) -> dict[str, Starts]: ...


@dataclass(frozen=True)
class Independent:
    """A sequence of draws for each set, so that changing one size leaves the others."""

    lead = 0

    def __call__(self, box: SamplingBox, counts: Mapping[str, int], seed: int) -> dict[str, Starts]:
        return {
            name: uniform(box, count, (seed, stream))
            for stream, (name, count) in enumerate(counts.items())
        }


def uniform(box: SamplingBox, count: int, seed: int | tuple[int, ...]) -> Starts:
    """Uniform draws of the box; the first are always the same."""
    low, high = bounds(box.q, box.v, box.u)
    draws = np.random.default_rng(seed).uniform(low, high, size=(count, len(low)))
    n = len(box.q)
    return Starts(*(torch.from_numpy(part) for part in np.split(draws, [n, 2 * n], axis=1)))


def bounds(*ranges: tuple[Range, ...]) -> tuple[np.ndarray, np.ndarray]:
    """The lowest and the highest values of ranges, one after another."""
    low, high = np.array([pair for part in ranges for pair in part]).reshape(-1, 2).T
    return low, high
