"""Studies: measures of a trained model beyond those of every run.

A study is a callable with its settings, whose values are in ``conf/study``. It is called with the
model, the system and the data and returns columns to draw and measures, which are logged beside
those of every run::

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
import torch
from torch import Tensor

from symo_exp.checks import function
from symo_exp.errors import ConfigError


@dataclass(frozen=True)
class Finding:
    """The result of a study; empty where it does not apply to a method or a system.

    Attributes:
        columns: Columns of a table, of equal length.
        measures: Values by name.

    Raises:
        ConfigError: If columns do not form a table, or a measure is no number.
    """

    columns: dict[str, Tensor] = field(default_factory=dict)
    measures: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        columns = {key: torch.as_tensor(x).detach().cpu() for key, x in self.columns.items()}
        shapes = {key: tuple(x.shape) for key, x in columns.items()}
        if len(set(shapes.values())) > 1 or any(len(shape) != 1 for shape in shapes.values()):
            raise ConfigError(f"columns of shapes {shapes}: expected one dimension, equal lengths")
        measures = {key: _number(key, x) for key, x in self.measures.items()}
        vars(self).update(columns=columns, measures=measures)

    def named(self, name: str) -> Finding:
        """Return the same with a prefix of the measures."""
        return Finding(self.columns, {f"{name}_{key}": x for key, x in self.measures.items()})


def check_study(told: str, study: object) -> None:
    """Refuse a study that cannot be called with a model, a system and data.

    Args:
        told: The setting that names it, for the error.
        study: The study, which may be a user's.
    """
    wanted = "a class with the method __call__(self, model, system, data, *, remember=afresh)"
    function(told, study, wanted, None, None, None, remember=afresh)


def _number(name: str, value: object) -> float:
    """Return a measure, also a tensor with one entry, as a float."""
    try:
        return float(value.detach() if isinstance(value, Tensor) else value)  # type: ignore[arg-type]
    except (TypeError, ValueError, RuntimeError) as error:
        raise ConfigError(f"the measure {name}={value!r}: expected a number") from error


Arrays = Mapping[str, np.ndarray]
Make = Callable[[], Arrays]
Remember: TypeAlias = Callable[[str, Mapping[str, Any], Make], Arrays]
"""Maps a name, a recipe (everything that the arrays depend on) and ``make`` to the arrays, made now
or by an earlier run."""


def afresh(name: str, recipe: Mapping[str, Any], make: Make) -> Arrays:
    """Return the arrays made now."""
    return make()
