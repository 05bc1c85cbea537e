"""Studies: what a trained model does beyond the measures of every run.

A measure of one's own is a study: a callable with its settings in one file, its name and values in
``conf/study``. It is handed the model, the system and the data, and gives numbers to draw and
measures, which are logged beside those of every run::

    @dataclass(frozen=True, kw_only=True)
    class Worst:
        name: str

        def __call__(self, model, system, data, *, remember=afresh):
            rollouts = roll_out(model.for_evaluation(), system.lagrangian, data.integration)
            error = (rollouts.q - rollouts.q_true).abs().max().item()
            return Finding(measures={f"{self.name}_error": error})
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
from torch import Tensor

from symo_exp.errors import ConfigError


@dataclass(frozen=True)
class Finding:
    """``columns`` of equal length make a table; ``measures`` are named as the run's others.

    Both are empty where the study has nothing to say of a method or of a system.
    """

    columns: dict[str, Tensor] = field(default_factory=dict)
    measures: dict[str, float] = field(default_factory=dict)


Arrays = Mapping[str, np.ndarray]
Make = Callable[[], Arrays]
Remember: TypeAlias = Callable[[str, Mapping[str, Any], Make], Arrays]
"""Gives the arrays that a name and a recipe (everything that decides what ``make`` gives) stand
for: made now, or when another run asked for them."""


def afresh(name: str, recipe: Mapping[str, Any], make: Make) -> Arrays:
    """Remembers nothing."""
    return make()


def check_size(name: str, steps: int, count: int) -> None:
    """Refuse a study of no motions, or of motions without a step."""
    if steps < 1 or count < 1:
        raise ConfigError(f"study.{name}: steps={steps} and count={count} must be at least 1")
