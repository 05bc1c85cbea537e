"""Periodic checkpoints of a training."""

from __future__ import annotations

import logging
import os
import random
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import lightning
import numpy as np
import torch
from lightning.pytorch import callbacks
from lightning.pytorch.plugins.io import TorchCheckpointIO
from typing_extensions import override

from symo_exp.files import write_state
from symo_exp.process import stopping
from symo_exp.runs.folder import LAST, PREVIOUS

log = logging.getLogger(__name__)


class WholeFiles(TorchCheckpointIO):
    """Writes checkpoints atomically and keeps the previous one."""

    @override
    def save_checkpoint(
        self, checkpoint: dict[str, Any], path: str | os.PathLike[str], storage_options: Any = None
    ) -> None:
        last = Path(path)
        write_state(last, checkpoint, keep=last.parent / PREVIOUS)

    def load_checkpoint(
        self, path: str | os.PathLike[str], *args: Any, **kwargs: Any
    ) -> dict[str, Any]:
        """Load tensors and plain values only: a checkpoint must not execute code."""
        state: dict[str, Any] = torch.load(path, map_location="cpu", weights_only=True)
        return state


class Checkpoint(callbacks.Checkpoint):
    """Writes ``last.ckpt`` at the end of epochs when ``seconds`` have passed, and after training.

    As a checkpoint callback of Lightning it is called after all others, so that everything about
    the epoch has been logged. The file also contains the state of the random generators, which
    Lightning leaves out, the ``run`` it belongs to and whether the training is ``complete``.

    A first signal during an epoch waits for its end; a requested stop takes effect here, after
    writing.

    Args:
        folder: Folder of the checkpoints.
        seconds: Least time between two of them [s].
        run: Digest of the run they belong to.
    """

    def __init__(self, folder: Path, seconds: float, run: str = "") -> None:
        self.last = folder / LAST
        self.seconds = seconds
        self.run = run
        self._complete, self._resumable = False, True
        self._written = 0.0
        self._random: dict[str, Any] | None = None
        self._patience = ExitStack()

    @override
    def on_train_start(self, trainer: lightning.Trainer, pl_module: Any) -> None:
        stopping.install()  # Lightning has installed a handler of its own
        self._patience.enter_context(stopping.urgent(False))
        self._written = time.monotonic()
        if self._random is not None:
            torch.set_rng_state(self._random["torch"])
            random.setstate(_tuples(self._random["python"]))
            np.random.set_state(_tuples(self._random["numpy"]))
            self._random = None
        stopping.raise_if_requested()

    @override
    def on_train_epoch_end(self, trainer: lightning.Trainer, pl_module: Any) -> None:
        if trainer.should_stop or trainer.current_epoch + 1 == trainer.max_epochs:
            return  # the training is over: ``on_fit_end`` follows
        signum = stopping.requested()
        due = time.monotonic() - self._written >= self.seconds
        if signum is not None or due:
            try:
                self.write(trainer)
            except OSError as error:  # a full disk, for example; the previous one remains
                log.warning("no checkpoint: %s", error)
            self._written = time.monotonic()
        if signum is not None:
            raise stopping.Interrupted(signum)

    @override
    def on_exception(self, trainer: lightning.Trainer, pl_module: Any, exception: Any) -> None:
        self._patience.close()

    @override
    def on_fit_end(self, trainer: lightning.Trainer, pl_module: Any) -> None:
        # after ``on_train_end``, where an optimiser may restore the best weights
        self._complete = True
        self.write(trainer)
        self._patience.close()

    def write(self, trainer: lightning.Trainer, *, resumable: bool = True) -> None:
        """Write the file now; one with weights alone cannot be resumed and is marked so."""
        self._resumable = resumable
        trainer.save_checkpoint(self.last)

    @override
    def on_save_checkpoint(
        self, trainer: lightning.Trainer, pl_module: Any, checkpoint: dict[str, Any]
    ) -> None:
        # plain lists, since loading a NumPy array would need pickle
        numpy = [x.tolist() if isinstance(x, np.ndarray) else x for x in np.random.get_state()]
        checkpoint["random"] = {
            "torch": torch.get_rng_state(),
            "python": random.getstate(),
            "numpy": numpy,
        }
        checkpoint["run"] = self.run
        checkpoint["complete"], checkpoint["resumable"] = self._complete, self._resumable

    @override
    def on_load_checkpoint(
        self, trainer: lightning.Trainer, pl_module: Any, checkpoint: dict[str, Any]
    ) -> None:
        self._random = checkpoint.get("random")


def _tuples(value: Any) -> Any:
    return tuple(map(_tuples, value)) if isinstance(value, list | tuple) else value
