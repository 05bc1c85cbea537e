"""The decision whether a training is compiled."""

from __future__ import annotations

import logging
from contextlib import suppress
from pathlib import Path
from typing import Any

import lightning
import torch
from typing_extensions import override

from symo_exp.compile import compile_training, trains_compiled
from symo_exp.compile.inductor import compiler_available, kernel_cache
from symo_exp.process import phases

log = logging.getLogger(__name__)

COLD, WARM = 7000, 700
"""Optimiser steps from which compiling saves time, without and with kernels in the cache.

Compiling takes up to a minute without them and some seconds with them, and saves some milliseconds
a step."""


class CompileTraining(lightning.Callback):
    """Compiles the training step of a run on a CPU.

    A resumed run keeps the decision of its start, and so gives the same bits.

    Args:
        mode: ``True``, ``False`` or ``"auto"``, which depends on the presence of a C++ compiler,
            the length of the whole run, and whether an earlier run has left the kernels in the
            cache; never on a clock.
        settings: Digest of the settings that the kernels depend on.
    """

    def __init__(self, mode: bool | str, settings: str = "") -> None:
        self.mode, self._settings = mode, settings
        self._compiled: bool | None = None
        self._kernels: Path | None = None
        """The file that marks the kernels of this training as present, until it is made."""

    @override
    def on_fit_start(self, trainer: lightning.Trainer, pl_module: Any) -> None:
        possible, available = trains_compiled(pl_module), compiler_available()
        if self.mode is True and not (possible and available):
            reason = "no C++ compiler here" if possible else "no fixed sequence of operations"
            log.warning("this training is not compiled: %s", reason)
        if not (self.mode and possible and available):
            return
        self._kernels = kernel_cache() / "made" / f"{self._settings}-{torch.__version__}"
        if self._compiled is None:
            self._compiled = self.mode is True or self._worthwhile(trainer, pl_module)
        if self._compiled:
            compile_training(pl_module, validation=watches_much(trainer))

    @override
    def on_train_start(self, trainer: lightning.Trainer, pl_module: Any) -> None:
        if self._compiled:  # it happens in the first epoch
            phases.say("compiling the training step: once for a system and network, up to a minute")

    @override
    def on_train_epoch_end(self, trainer: lightning.Trainer, pl_module: Any) -> None:
        if self._compiled and self._kernels is not None:
            with suppress(OSError):  # a cache that cannot be written to stays empty
                self._kernels.parent.mkdir(parents=True, exist_ok=True)
                self._kernels.touch()
        self._kernels = None  # marked once

    @override
    def state_dict(self) -> dict[str, Any]:
        return {"compiled": self._compiled}

    @override
    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        self._compiled = state_dict["compiled"]

    def _worthwhile(self, trainer: lightning.Trainer, pl_module: Any) -> bool:
        assert self._kernels is not None
        datamodule: Any = trainer.datamodule  # type: ignore[attr-defined]
        steps = (trainer.max_epochs or 0) * len(datamodule.batches(0))
        enough = WARM if self._kernels.exists() else COLD
        return pl_module.device.type == "cpu" and steps >= enough


def watches_much(trainer: lightning.Trainer) -> bool:
    """Return whether validation evaluates as many samples as training, as in the thesis."""
    datamodule: Any = trainer.datamodule  # type: ignore[attr-defined]
    watched = sum(len(windows.q) for windows in datamodule.val_dataloader())
    trained = sum(len(windows.q) for windows in datamodule.batches(0))
    return watched >= trained * (trainer.check_val_every_n_epoch or 1)
