"""The training problem whose loss is compiled."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

from torch import Tensor

from symo_exp.mechanics.types import Windows
from symo_exp.models.base import DynamicsModel
from symo_exp.models.objectives import Objective, Statistics


class Trainable(Protocol):
    """A model, its objective, and the uncompiled functions that compiled ones replace."""

    model: DynamicsModel
    objective: Objective
    compiled: dict[str, Callable[..., Any]]

    def loss(self, windows: Windows) -> Tensor:
        """Return the loss."""

    def uncompiled_training(self, windows: Windows) -> tuple[Tensor, Statistics]:
        """Return the detached loss and the objective's statistics; leave gradients in place."""
