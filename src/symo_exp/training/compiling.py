"""Whether a training is compiled."""

from __future__ import annotations

import logging
from typing import Any

import lightning

from symo_exp.compile import compile_training, compiler_available, trains_compiled
from symo_exp.training import phases

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
        possible, available = trains_compiled(pl_module), compiler_available()
        if self.mode is True and not (possible and available):
            reason = "no C++ compiler here" if possible else "no fixed sequence of operations"
            log.warning("this training is not compiled: %s", reason)
        elif possible and available and (self.mode is True or self._worthwhile(trainer, pl_module)):
            phases.say("compiling the training step, up to a minute")
            compile_training(pl_module, validation=watches_much(trainer))

    def _worthwhile(self, trainer: lightning.Trainer, pl_module: Any) -> bool:
        datamodule: Any = getattr(trainer, "datamodule", None)
        if not self.mode or datamodule is None or trainer.max_epochs is None:
            return False
        steps = trainer.max_epochs * len(datamodule.batches(0))
        return pl_module.device.type == "cpu" and steps >= WORTHWHILE


def watches_much(trainer: lightning.Trainer) -> bool:
    """Whether validation sees as many samples as training does, as in the thesis' protocol."""
    datamodule: Any = getattr(trainer, "datamodule", None)
    if datamodule is None:
        return False
    watched = sum(len(windows.q) for windows in datamodule.val_dataloader())
    trained = sum(len(windows.q) for windows in datamodule.batches(0))
    return watched >= trained * (trainer.check_val_every_n_epoch or 1)
