"""The state of a training, on disk every now and then."""

from __future__ import annotations

import os
import random
import time
from pathlib import Path
from typing import Any

import lightning
import numpy as np
import torch


class Checkpoint(lightning.Callback):
    """Write ``last.ckpt`` at the end of an epoch when ``seconds`` have passed, and of the training.

    The file appears whole or not at all, and the one before stays as ``previous.ckpt``. It also
    holds the state of the random generators, which Lightning leaves out: without it a resumed run
    would draw other numbers.
    """

    def __init__(self, folder: Path, seconds: float) -> None:
        self.last, self.previous = folder / "last.ckpt", folder / "previous.ckpt"
        self.seconds = seconds
        self._written = 0.0
        self._random: dict[str, Any] | None = None

    def on_train_start(self, trainer: lightning.Trainer, pl_module: Any) -> None:
        self._written = time.monotonic()
        if self._random is not None:
            torch.set_rng_state(self._random["torch"])
            random.setstate(_tuples(self._random["python"]))
            np.random.set_state(_tuples(self._random["numpy"]))
            self._random = None

    def on_train_epoch_end(self, trainer: lightning.Trainer, pl_module: Any) -> None:
        if time.monotonic() - self._written >= self.seconds:
            self.write(trainer)

    def on_fit_end(self, trainer: lightning.Trainer, pl_module: Any) -> None:
        # After ``on_train_end``, where an optimiser may put the best weights in place.
        self.write(trainer)

    def write(self, trainer: lightning.Trainer) -> None:
        new = self.last.with_suffix(".new")
        trainer.save_checkpoint(new)
        if self.last.exists():
            os.replace(self.last, self.previous)
        os.replace(new, self.last)
        self._written = time.monotonic()

    def on_save_checkpoint(
        self, trainer: lightning.Trainer, pl_module: Any, checkpoint: dict[str, Any]
    ) -> None:
        # plain lists: a numpy array would need unpickling
        numpy = [x.tolist() if isinstance(x, np.ndarray) else x for x in np.random.get_state()]
        checkpoint["random"] = {
            "torch": torch.get_rng_state(),
            "python": random.getstate(),
            "numpy": numpy,
        }

    def on_load_checkpoint(
        self, trainer: lightning.Trainer, pl_module: Any, checkpoint: dict[str, Any]
    ) -> None:
        self._random = checkpoint.get("random")


def _tuples(value: Any) -> Any:
    return tuple(map(_tuples, value)) if isinstance(value, list | tuple) else value
