"""An end to trainings that take much longer than planned."""

from __future__ import annotations

import logging
import time
from typing import Any

import lightning
from typing_extensions import override

log = logging.getLogger(__name__)


class StopOverrun(lightning.Callback):
    """Ends a training at the end of the epoch in which it exceeds ``seconds`` of processor time.

    The best parameters so far are kept. A training that is ended so depends on the clock; one
    that is not is the same as without a limit.
    """

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds
        self._start = 0.0

    @override
    def on_train_start(self, trainer: lightning.Trainer, pl_module: Any) -> None:
        self._start = time.process_time()

    @override
    def on_train_epoch_end(self, trainer: lightning.Trainer, pl_module: Any) -> None:
        elapsed = time.process_time() - self._start
        if elapsed > self._seconds and not trainer.should_stop:
            epoch = trainer.current_epoch + 1
            log.warning("ended after %.0f s, in epoch %d: time limit exceeded", elapsed, epoch)
            trainer.should_stop = True
