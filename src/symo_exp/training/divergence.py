"""The end of a training whose loss is not finite."""

from __future__ import annotations

import logging
import math
from typing import Any

import lightning
import torch
from torch.nn.utils import get_total_norm
from typing_extensions import override

from symo_exp.optim.base import EpochOptimizer
from symo_exp.training.checkpoint import Checkpoint

log = logging.getLogger(__name__)


class DivergenceError(RuntimeError):
    """The training loss became NaN or infinite."""


class StopOnDivergence(lightning.Callback):
    """Ends a training whose ``train_loss`` is not finite and keeps the last finite weights.

    Args:
        checkpoint: The callback that writes them.
    """

    def __init__(self, checkpoint: Checkpoint) -> None:
        self._checkpoint = checkpoint
        self._good: dict[str, torch.Tensor] | None = None

    @override
    def on_train_start(self, trainer: lightning.Trainer, pl_module: Any) -> None:
        self._remember(pl_module)

    @override
    def on_train_epoch_end(self, trainer: lightning.Trainer, pl_module: Any) -> None:
        loss = pl_module.epoch_metrics["train_loss"]
        if math.isfinite(loss):
            self._remember(pl_module)
            return
        self._keep(trainer, pl_module)
        optimizer = trainer.optimizers[0]
        rate = optimizer.rate if isinstance(optimizer, EpochOptimizer) else "optimizer.lr"
        smaller = "" if rate is None else f"a smaller {rate}, "
        raise DivergenceError(
            f"the loss of {type(pl_module.model).__name__} is {loss} after epoch "
            f"{trainer.current_epoch + 1} (optimiser step {pl_module.steps}); "
            f"try {smaller}another seed or dtype=float64"
        )

    def _remember(self, model: Any) -> None:
        weights = model.state_dict()
        if bool(get_total_norm(weights.values()).isfinite()):
            self._good = {name: value.clone() for name, value in weights.items()}

    def _keep(self, trainer: lightning.Trainer, model: Any) -> None:
        if self._good is None:
            return
        model.load_state_dict(self._good)
        try:
            self._checkpoint.write(trainer, resumable=False)
        except OSError as error:
            log.warning("the last finite weights are not kept: %s", error)
