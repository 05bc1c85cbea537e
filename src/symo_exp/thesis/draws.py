"""The published draws: the initial states and inputs of the thesis at ``seed=0``."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch

from symo_exp.data.draws import Starts, bounds
from symo_exp.systems.base import SamplingBox


@dataclass(frozen=True)
class Published:
    """Draws of the published experiments.

    The states of the training and then of the test trajectories are one sequence of the generator
    of Gym before 0.22, their inputs one of NumPy's ``RandomState``, both with the given seed. The
    states of the rollouts have ``seed + 1``, those of the validation trajectories, which the thesis
    does not have, ``seed + 2``.

    Args:
        interleaved: Whether a state is drawn as ``q₁, v₁, q₂, v₂, …`` or as ``q, v``.
    """

    interleaved: bool = False
    lead = 1

    def __call__(self, box: SamplingBox, counts: Mapping[str, int], seed: int) -> dict[str, Starts]:
        """Return the initial states and inputs of each split."""
        sizes = [counts["train"], counts["test"]]
        fields = (x.split(sizes) for x in self._drawn(box, sum(sizes), seed))
        train, test = zip(*fields, strict=True)
        return {
            "train": Starts(*train),
            "test": Starts(*test),
            "integration": self._drawn(box, counts["integration"], seed + 1),
            "val": self._drawn(box, counts["val"], seed + 2),
        }

    def _drawn(self, box: SamplingBox, count: int, seed: int) -> Starts:
        low, high = bounds(box.q, box.v)
        order = np.arange(len(low))
        if self.interleaved:
            order = order.reshape(2, -1).T.flatten()
        states = gym_generator(seed).uniform(low[order], high[order], size=(count, len(low)))
        q, v = np.split(states[:, np.argsort(order)], 2, axis=1)
        low, high = bounds(box.u)
        u = np.random.RandomState(seed).uniform(low, high, size=(count, len(low)))
        return Starts(*map(torch.from_numpy, (q, v, u)))


def gym_generator(seed: int) -> np.random.RandomState:
    """Return the generator of Gym before 0.22, seeded with 64 bits of a hash of the seed."""
    digest = hashlib.sha512(str(seed).encode()).digest()
    return np.random.RandomState(np.frombuffer(digest[:8], dtype="<u4"))
