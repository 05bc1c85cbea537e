"""Where trajectories start and how they are driven: draws from the box of a system."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import NamedTuple, Protocol

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


class Draws(Protocol):
    """The starts of every set of trajectories, from the box of a system and a seed.

    ``counts`` says how many each set has. ``interleaved`` is the order in which a published state
    was drawn: ``q₁, v₁, q₂, v₂, …`` instead of ``q, v``.
    """

    lead: int
    """Steps from the state that is drawn to the first node."""

    def __call__(
        self, box: SamplingBox, counts: Mapping[str, int], seed: int, *, interleaved: bool
    ) -> dict[str, Starts]: ...


class Independent:
    """A sequence of draws for each set, so that changing one size leaves the others."""

    lead = 0

    def __call__(
        self, box: SamplingBox, counts: Mapping[str, int], seed: int, *, interleaved: bool
    ) -> dict[str, Starts]:
        return {
            name: uniform(box, count, (seed, stream))
            for stream, (name, count) in enumerate(counts.items())
        }


class Published:
    """The draws of the thesis' published experiments, which are those of ``seed=0``.

    The states of the training trajectories and, after them, of the test trajectories are one
    sequence of Gym's generator of that time, and their inputs one of NumPy's ``RandomState``, both
    of this seed; the states of the rollouts belong to ``seed + 1``. Those of the validation
    trajectories, of which the thesis has none, belong to ``seed + 2``.
    """

    lead = 1

    def __call__(
        self, box: SamplingBox, counts: Mapping[str, int], seed: int, *, interleaved: bool
    ) -> dict[str, Starts]:
        sizes = [counts["train"], counts["test"]]
        fields = (x.split(sizes) for x in _published(box, sum(sizes), seed, interleaved))
        train, test = zip(*fields, strict=True)
        return {
            "train": Starts(*train),
            "test": Starts(*test),
            "integration": _published(box, counts["integration"], seed + 1, interleaved),
            "val": _published(box, counts["val"], seed + 2, interleaved),
        }


DRAWS: Mapping[str, Draws] = {"independent": Independent(), "published": Published()}


def uniform(box: SamplingBox, count: int, seed: int | tuple[int, ...]) -> Starts:
    """Uniform draws of the box; the first are always the same."""
    low, high = _bounds(box.q, box.v, box.u)
    draws = np.random.default_rng(seed).uniform(low, high, size=(count, len(low)))
    n = len(box.q)
    return Starts(*(torch.from_numpy(part) for part in np.split(draws, [n, 2 * n], axis=1)))


def _published(box: SamplingBox, count: int, seed: int, interleaved: bool) -> Starts:
    low, high = _bounds(box.q, box.v)
    order = np.arange(len(low))
    if interleaved:
        order = order.reshape(2, -1).T.flatten()
    states = gym_generator(seed).uniform(low[order], high[order], size=(count, len(low)))
    q, v = np.split(states[:, np.argsort(order)], 2, axis=1)
    low, high = _bounds(box.u)
    u = np.random.RandomState(seed).uniform(low, high, size=(count, len(low)))
    return Starts(*map(torch.from_numpy, (q, v, u)))


def gym_generator(seed: int) -> np.random.RandomState:
    """The generator of Gym before 0.22: seeded with 64 bits of a hash of the seed's digits."""
    digest = hashlib.sha512(str(seed).encode()).digest()
    return np.random.RandomState(np.frombuffer(digest[:8], dtype="<u4"))


def _bounds(*ranges: tuple[Range, ...]) -> tuple[np.ndarray, np.ndarray]:
    low, high = np.array([pair for part in ranges for pair in part]).reshape(-1, 2).T
    return low, high
