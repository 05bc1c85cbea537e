"""L-BFGS on all samples."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import torch
from torch import Tensor
from typing_extensions import override

from symo_exp.checks import whole_number
from symo_exp.mechanics.types import TrainingSamples
from symo_exp.optim.base import EpochOptimizer, Problem, concatenated


class LBFGS(EpochOptimizer):
    """L-BFGS with a strong Wolfe line search on all samples.

    Args:
        params: The parameters.
        iterations: Steps in an epoch.
        history: Number of updates that are kept.
        patience: Number of held-out losses without improvement.
    """

    def __init__(
        self,
        params: Iterable[Tensor],
        *,
        iterations: int = 10,
        history: int = 50,
        patience: int = 20,
    ) -> None:
        super().__init__(params, patience=patience)
        whole_number("optimizer.iterations", iterations)
        whole_number("optimizer.history", history)
        self._inner = torch.optim.LBFGS(
            self.parameters, max_iter=iterations, history_size=history,
            tolerance_grad=0.0, tolerance_change=0.0, line_search_fn="strong_wolfe",
        )  # fmt: skip

    @override
    def epoch(self, model: Problem, batches: Sequence[TrainingSamples]) -> dict[str, Tensor]:
        samples = concatenated(batches)

        def closure() -> Tensor:
            self._inner.zero_grad()
            loss = model.loss(samples)
            loss.backward()
            return loss

        return {"train_loss": self._inner.step(closure).detach()}

    @override
    def state_dict(self) -> dict[str, Any]:
        self.memory["inner"] = self._inner.state_dict()
        return super().state_dict()

    @override
    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        super().load_state_dict(state_dict)
        self._inner.load_state_dict(self.memory["inner"])
