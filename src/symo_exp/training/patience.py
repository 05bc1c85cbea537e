"""Signals during an epoch."""

from __future__ import annotations

from contextlib import ExitStack
from typing import Any

import lightning
from typing_extensions import override

from symo_exp.process import stopping


class FinishEpochs(lightning.Callback):
    """Defers a first signal to the end of the epoch, where ``Checkpoint`` acts on it."""

    def __init__(self) -> None:
        self._patience = ExitStack()

    @override
    def on_train_start(self, trainer: lightning.Trainer, pl_module: Any) -> None:
        stopping.install()  # Lightning has installed a handler of its own
        self._patience.enter_context(stopping.urgent(False))

    @override
    def on_train_end(self, trainer: lightning.Trainer, pl_module: Any) -> None:
        self._patience.close()

    @override
    def on_exception(self, trainer: lightning.Trainer, pl_module: Any, exception: Any) -> None:
        self._patience.close()
