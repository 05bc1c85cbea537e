"""A progress bar with epoch, losses and remaining time."""

from __future__ import annotations

import time
from typing import Any

import lightning
from tqdm import tqdm
from typing_extensions import override

from symo_exp.process import phases

_REFRESH = 0.2  # seconds; reading a loss from a GPU waits for it


class ProgressBar(lightning.Callback):
    """A line that is redrawn on a terminal or in a notebook.

    Nothing is written to files, to pipes, or by one of several processes of a sweep.
    """

    def __init__(self) -> None:
        self.shown = phases.visible(notebook=True)
        self._bar: Any = None
        self._start, self._drawn = 0, 0.0

    @override
    def on_train_start(self, trainer: lightning.Trainer, pl_module: Any) -> None:
        self._start = trainer.current_epoch
        phases.say("training the first epoch")

    @override
    def on_train_epoch_end(self, trainer: lightning.Trainer, pl_module: Any) -> None:
        if self.shown and self._bar is None:
            phases.clear()
            self._bar = tqdm(
                total=trainer.max_epochs,
                initial=self._start,
                desc=type(pl_module.model).__name__,
                unit="epoch",
                leave=False,
                dynamic_ncols=True,
                bar_format="{desc} {n_fmt}/{total_fmt} |{bar}| {remaining} left{postfix}",
            )
        if self._bar is None or time.monotonic() - self._drawn < _REFRESH:
            return
        self._drawn = time.monotonic()
        losses = {"train_loss": pl_module.epoch_metrics["train_loss"]}
        if "val_loss" in trainer.callback_metrics:
            losses["val_loss"] = float(trainer.callback_metrics["val_loss"])
        told = {name: f"{loss:.2e}" for name, loss in losses.items()}
        self._bar.set_postfix(told, refresh=False)
        self._bar.n = trainer.current_epoch + 1
        self._bar.refresh()

    @override
    def on_train_end(self, trainer: lightning.Trainer, pl_module: Any) -> None:
        self._close()

    @override
    def on_exception(self, trainer: lightning.Trainer, pl_module: Any, exception: Any) -> None:
        self._close()

    def _close(self) -> None:
        if self._bar is not None:
            self._bar.close()
            self._bar = None
