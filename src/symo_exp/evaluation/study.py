"""Studies: what a trained model does beyond the measures of every run.

A study is a callable with its settings; it is handed the model and the true system, and gives
numbers to draw and a few to compare by.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
import torch
from torch import Tensor

from symo_exp.errors import ConfigError
from symo_exp.evaluation.protocols import Model
from symo_exp.systems.base import System


@dataclass(frozen=True)
class Finding:
    """``columns`` of equal length make a table; ``measures`` are named as the run's others.

    Both are empty where the study has nothing to say of a method.
    """

    columns: dict[str, Tensor] = field(default_factory=dict)
    measures: dict[str, float] = field(default_factory=dict)


Arrays = Mapping[str, np.ndarray]


class Remember(Protocol):
    """Gives the arrays that a recipe stands for: made now, or when another run asked for them."""

    def __call__(self, name: str, recipe: Mapping[str, Any], make: Callable[[], Arrays]) -> Arrays:
        """``recipe`` has everything that decides what ``make`` gives."""


def afresh(name: str, recipe: Mapping[str, Any], make: Callable[[], Arrays]) -> Arrays:
    """Remembers nothing."""
    return make()


class Study(Protocol):
    """What a file of ``conf/study`` names."""

    def __call__(self, model: Model, system: System, remember: Remember = afresh) -> Finding:
        """Study a model, given as it was trained."""


def check_size(name: str, steps: int, count: int) -> None:
    """Refuse a study of no motions, or of motions without a step."""
    if steps < 1 or count < 1:
        raise ConfigError(f"study.{name}: steps={steps} and count={count} must be at least 1")


def starts(system: System, count: int, seed: int) -> tuple[Tensor, Tensor]:
    """Poses and velocities, uniform in the box of the system: the same for every model."""
    generator = torch.Generator().manual_seed(seed)
    q, v = (
        low + torch.rand(count, len(low), dtype=torch.float64, generator=generator) * (high - low)
        for low, high in (
            torch.tensor(ranges, dtype=torch.float64).T
            for ranges in (system.sampling_box.q, system.sampling_box.v)
        )
    )
    return q, v
