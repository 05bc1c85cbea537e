"""Random starts and inputs from the box of a system, and trajectories from these."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from symo_exp.mechanics.types import Trajectories
from symo_exp.systems.base import LagrangianSystem, Range, SamplingBox
from symo_exp.systems.simulation import Solver, simulate


class Starts(NamedTuple):
    """Initial states and constant inputs, float64; rotations by rotation vectors."""

    q: Float[Tensor, "count n"]
    v: Float[Tensor, "count n"]
    u: Float[Tensor, "count m"]


@runtime_checkable
class Draws(Protocol):
    """Starts of every set of trajectories, from the box of a system and a seed.

    ``counts`` maps the name of a set to its size. The starts and ``lead`` are part of the key of
    cached trajectories.
    """

    @property
    def lead(self) -> int:
        """Steps between the drawn state and the first node."""

    def __call__(self, box: SamplingBox, counts: Mapping[str, int], seed: int) -> dict[str, Starts]:
        """Return the starts of each set."""


@dataclass(frozen=True)
class Independent:
    """A random sequence for each set, so that the size of one does not change the others."""

    lead = 0

    def __call__(self, box: SamplingBox, counts: Mapping[str, int], seed: int) -> dict[str, Starts]:
        """Return the starts of each set."""
        return {
            name: uniform(box, count, (seed, stream))
            for stream, (name, count) in enumerate(counts.items())
        }


def uniform(box: SamplingBox, count: int, seed: int | tuple[int, ...]) -> Starts:
    """Return uniform draws from a box; the first are the same for any count."""
    low, high = bounds(box.q, box.v, box.u)
    draws = np.random.default_rng(seed).uniform(low, high, size=(count, len(low)))
    n = len(box.q)
    return Starts(*(torch.from_numpy(part) for part in np.split(draws, [n, 2 * n], axis=1)))


def bounds(*ranges: tuple[Range, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return the lowest and the highest values of ranges, concatenated."""
    low, high = np.array([pair for part in ranges for pair in part]).reshape(-1, 2).T
    return low, high


def generate(
    system: LagrangianSystem,
    starts: Starts,
    *,
    steps: int,
    forced: bool,
    solver: Solver,
    lead: int = 0,
) -> Trajectories:
    """Return trajectories of ``steps + 1`` nodes, the first one ``lead`` steps after the start.

    Unforced trajectories have ``u = 0``.
    """
    u = starts.u if forced else torch.zeros_like(starts.u)
    path = simulate(system, system.space.of_vector(starts.q), starts.v, u, lead + steps, solver)
    return Trajectories(*(field[:, lead:].contiguous() for field in path))
