"""What an optimiser needs that takes more than one step a mini batch."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, Protocol

import torch
from jaxtyping import Float
from torch import Tensor
from torch.optim import Optimizer

from symo_exp.mechanics.types import Windows


class Learner(Protocol):
    """A model as an optimiser sees it."""

    def residuals(self, windows: Windows) -> Float[Tensor, "samples residuals"]: ...

    def loss(self, windows: Windows) -> Tensor: ...


class EpochOptimizer(Optimizer, ABC):
    """An optimiser that is given all samples of an epoch and does with them what it wants.

    Everything else, gradients and line searches included, is its own business. What it must
    remember to be resumed goes into ``memory``, which ``state_dict`` carries.
    """

    memory: dict[str, Any]
    finished: bool = False
    """Whether further epochs are of no use."""

    @abstractmethod
    def epoch(self, model: Learner, batches: Sequence[Windows]) -> dict[str, Tensor]:
        """One epoch; returns at least ``train_loss``, the loss before the last step."""

    def validated(self, loss: Tensor) -> None:
        """Take note of a loss on held-out samples."""

    def ended(self) -> None:
        """The last epoch is over: leave the best parameters in place."""

    def step(self, closure: Any = None) -> None:  # type: ignore[override]
        raise TypeError(f"{type(self).__name__} is driven by epochs, not by steps")

    def state_dict(self) -> dict[str, Any]:
        return {**super().state_dict(), "memory": dict(self.memory)}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        state = dict(state_dict)
        self.memory = dict(state.pop("memory"))
        super().load_state_dict(state)


def minibatches(
    optimizer: Optimizer, model: Learner, batches: Sequence[Windows]
) -> dict[str, Tensor]:
    """One step of a torch optimiser for each mini batch."""
    total: Tensor | None = None
    for windows in batches:
        loss = model.loss(windows)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        total = loss.detach() if total is None else total + loss.detach()
    assert total is not None
    return {"train_loss": total / len(batches)}


def whole(batches: Sequence[Windows]) -> Windows:
    """The mini batches of an epoch as one."""
    return Windows(*(torch.cat(fields) for fields in zip(*batches, strict=True)))
