"""Whether a training is compiled."""

from __future__ import annotations

import logging
import shutil
from typing import Any

import lightning

log = logging.getLogger(__name__)

WORTHWHILE = 4000
"""Optimiser steps from which ``auto`` compiles: it costs about a minute once, then seconds a run,
and saves some milliseconds a step."""


class CompileTraining(lightning.Callback):
    """``True``, ``False`` or ``"auto"``: compile the training step of a run on a CPU.

    ``auto`` decides by the length of the whole run and by whether a C++ compiler is there, never
    by a clock: a resumed run must take the same way to the same bits.
    """

    def __init__(self, mode: bool | str) -> None:
        self.mode = mode

    def on_fit_start(self, trainer: lightning.Trainer, pl_module: Any) -> None:
        if not self.wanted(trainer, pl_module):
            if self.mode is True:
                log.warning("this training is no fixed sequence of operations: not compiled")
            return
        if not compiler_available():
            log.warning("no C++ compiler here: the training step is not compiled")
            return
        pl_module.compile_training(validation=watches_much(trainer))

    def wanted(self, trainer: lightning.Trainer, pl_module: Any) -> bool:
        if not pl_module.can_be_compiled:
            return False
        if self.mode != "auto":
            return bool(self.mode)
        datamodule: Any = getattr(trainer, "datamodule", None)
        if pl_module.device.type != "cpu" or datamodule is None or trainer.max_epochs is None:
            return False
        steps = trainer.max_epochs * len(datamodule.batches(0))
        return steps >= WORTHWHILE and compiler_available()


def watches_much(trainer: lightning.Trainer) -> bool:
    """Whether validation sees as many samples as training does, as in the thesis' protocol."""
    datamodule: Any = getattr(trainer, "datamodule", None)
    if datamodule is None:
        return False
    watched = sum(len(windows.q) for windows in datamodule.val_dataloader())
    trained = sum(len(windows.q) for windows in datamodule.batches(0))
    return watched >= trained * (trainer.check_val_every_n_epoch or 1)


def compiler_available() -> bool:
    """Whether the machine has the C++ compiler that the generated kernels need."""
    return any(shutil.which(name) for name in ("c++", "g++", "clang++"))
