"""An epoch that has begun is worth finishing."""

from __future__ import annotations

from contextlib import ExitStack
from typing import Any

import lightning

from symo_exp.process import stopping


class FinishEpochs(lightning.Callback):
    """While epochs are trained a first signal is only noted; ``Checkpoint`` obeys it."""

    def __init__(self) -> None:
        self._patience = ExitStack()

    def on_train_start(self, trainer: lightning.Trainer, pl_module: Any) -> None:
        stopping.install()  # Lightning has put a handler of its own in place
        self._patience.enter_context(stopping.urgent(False))

    def on_train_end(self, trainer: lightning.Trainer, pl_module: Any) -> None:
        self._patience.close()

    def on_exception(self, trainer: lightning.Trainer, pl_module: Any, exception: Any) -> None:
        self._patience.close()
