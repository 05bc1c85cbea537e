"""An end to trainings that take much longer than planned."""

from __future__ import annotations

import logging
import math
import time
from typing import Any

import lightning
from typing_extensions import override

log = logging.getLogger(__name__)


class StopOverrun(lightning.Callback):
    """Ends a training at the end of the epoch in which it exceeds ``seconds`` of processor time.

    The time of all starts of a resumed training counts, from one checkpoint to the next. The best
    parameters so far are kept. A training that is ended so depends on the clock; one that is not is
    the same as without a limit.

    Args:
        seconds: Limit of the processor time [s]; ``None``: no limit.
    """

    def __init__(self, seconds: float | None) -> None:
        self._seconds = math.inf if seconds is None else seconds
        self._before = 0.0  # of earlier starts
        self._start = 0.0

    @override
    def on_train_start(self, trainer: lightning.Trainer, pl_module: Any) -> None:
        self._start = time.process_time()

    @override
    def on_train_epoch_end(self, trainer: lightning.Trainer, pl_module: Any) -> None:
        elapsed = self._elapsed()
        if elapsed > self._seconds and not trainer.should_stop:
            epoch = trainer.current_epoch + 1
            log.warning("ended after %.0f s, in epoch %d: time limit exceeded", elapsed, epoch)
            trainer.should_stop = True

    @override
    def state_dict(self) -> dict[str, Any]:
        return {"seconds": self._elapsed()}

    @override
    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        self._before = state_dict["seconds"]

    def _elapsed(self) -> float:
        return self._before + time.process_time() - self._start
