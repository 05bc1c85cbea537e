"""One optimiser after another."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import torch
from torch import Tensor
from torch.optim import Optimizer
from typing_extensions import override

from symo_exp.checks import instance, whole_number
from symo_exp.errors import ConfigError
from symo_exp.mechanics.types import TrainingSamples
from symo_exp.optim.base import EpochOptimizer, Problem, check_steps, minibatches


class Chained(EpochOptimizer):
    """One optimiser on mini batches, then another one on whole epochs.

    The rate of the first follows a half cosine. The second receives the held-out losses.

    Args:
        params: The parameters.
        first: Makes the first optimiser, one of torch.
        epochs: Epochs of the first.
        then: Makes the second optimiser, which takes the samples of an epoch at once.

    Raises:
        ConfigError: If one of them is of another kind.
    """

    rate = "optimizer.first.lr"

    def __init__(
        self,
        params: Iterable[Tensor],
        *,
        first: Callable[[Iterable[Tensor]], Optimizer],
        epochs: int,
        then: Callable[[Iterable[Tensor]], EpochOptimizer],
    ) -> None:
        whole_number("optimizer.epochs", epochs, low=0)
        super().__init__(params, patience=1)
        self.epochs = epochs
        self._first, self._then = first(self.parameters), then(self.parameters)
        check_steps("optimizer.first", self._first)
        instance("optimizer.then", self._then, EpochOptimizer)
        if self._then.reads_trajectories:
            raise ConfigError(
                f"optimizer.then is {type(self._then).__name__}, which takes trajectories: "
                "expected an optimizer of samples, such as LevenbergMarquardt; "
                "optimizer=total_least_squares begins with steps of Adam, too"
            )
        self._schedule = torch.optim.lr_scheduler.CosineAnnealingLR(self._first, max(epochs, 1))
        self.memory["epoch"] = 0

    @override
    def epoch(self, model: Problem, batches: Sequence[TrainingSamples]) -> dict[str, Tensor]:
        starting = self.memory["epoch"] < self.epochs
        self.memory["epoch"] += 1
        if not starting:
            metrics = self._then.epoch(model, batches)
            self.finished = self._then.finished
            return metrics
        rate = self._first.param_groups[0]["lr"]
        metrics = minibatches(self._first, model, batches)
        self._schedule.step()
        return {**metrics, "lr": torch.tensor(rate)}

    @override
    def validated(self, loss: Tensor) -> None:
        if self.memory["epoch"] > self.epochs:
            self._then.validated(loss)
            self.finished = self._then.finished

    @override
    def estimate(self) -> dict[str, Any] | None:
        return self._then.estimate()

    @override
    def ended(self) -> None:
        self._then.ended()

    @override
    def state_dict(self) -> dict[str, Any]:
        self.memory |= {
            "first": self._first.state_dict(),
            "then": self._then.state_dict(),
            "schedule": self._schedule.state_dict(),
        }
        return super().state_dict()

    @override
    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        super().load_state_dict(state_dict)
        self._first.load_state_dict(self.memory["first"])
        self._then.load_state_dict(self.memory["then"])
        self._schedule.load_state_dict(self.memory["schedule"])
        self.finished = self._then.finished
