"""The series of a run, written during training and published periodically."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import Any

import lightning
from typing_extensions import override

from symo_exp.errors import first_line
from symo_exp.runs.series import Series

log = logging.getLogger(__name__)

RETRY_SECONDS = 60.0


class SeriesRecorder(lightning.Callback):
    """Appends a row to the series at the end of each epoch and publishes it periodically.

    Neither a full disk nor an unreachable store stops a training: rows wait for the next epoch.

    Args:
        series: Series of the run.
        publish: Function that updates the tracking store.
        seconds: Least time between two calls of it [s].
    """

    def __init__(self, series: Series, publish: Callable[[], object], seconds: float) -> None:
        self.series, self.publish, self.seconds = series, publish, seconds
        self._due, self._full, self._validated = 0.0, False, False

    @override
    def on_train_start(self, trainer: lightning.Trainer, pl_module: Any) -> None:
        self.series.cut(trainer.current_epoch)  # later epochs are repeated
        self._due = time.monotonic() + self.seconds

    @override
    def on_validation_epoch_end(self, trainer: lightning.Trainer, pl_module: Any) -> None:
        self._validated = True

    @override
    def on_train_epoch_end(self, trainer: lightning.Trainer, pl_module: Any) -> None:
        values = dict(pl_module.epoch_metrics)
        if self._validated:
            values["val_loss"] = float(trainer.callback_metrics["val_loss"])
            self._validated = False
        try:
            self.series.append(trainer.current_epoch, values)
        except OSError as error:
            if not self._full:
                log.warning("the series cannot be written now: %s", error)
            self._full = True
        if time.monotonic() >= self._due:
            self._publish()

    @override
    def on_save_checkpoint(
        self, trainer: lightning.Trainer, pl_module: Any, checkpoint: dict[str, Any]
    ) -> None:
        self.series.flush(settle=True)  # rows missing beside a checkpoint would be lost

    def _publish(self) -> None:
        try:
            self.publish()
            self._due = time.monotonic() + self.seconds
        except Exception as error:
            self._due = time.monotonic() + RETRY_SECONDS
            log.warning("the store is updated later: %s", first_line(error))
