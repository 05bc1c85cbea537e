"""A loss that is no number ends the run at once, with a sentence."""

from __future__ import annotations

from typing import Any

import lightning
import torch


class DivergenceError(RuntimeError):
    """The training loss became NaN or infinite."""


class StopOnDivergence(lightning.Callback):
    """Looks at ``train_loss`` after every epoch."""

    def on_train_epoch_end(self, trainer: lightning.Trainer, pl_module: Any) -> None:
        loss = trainer.callback_metrics.get("train_loss")
        if loss is not None and not torch.isfinite(loss):
            raise DivergenceError(
                f"the loss of {type(pl_module).__name__} is {float(loss)} after epoch "
                f"{trainer.current_epoch + 1} (optimiser step {trainer.global_step}); "
                "try a smaller optimizer.lr, another seed or dtype=float64"
            )
