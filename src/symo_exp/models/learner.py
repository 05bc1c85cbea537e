"""Training: a flow is made to meet an objective, by one loop for every method."""

from __future__ import annotations

import resource
import sys
import time
from collections.abc import Callable, Iterable
from typing import Any, Literal

import torch
from jaxtyping import Float
from torch import Tensor
from torch.optim import Optimizer
from torch.optim.lr_scheduler import LRScheduler, ReduceLROnPlateau

from symo_exp.mechanics.types import Windows
from symo_exp.models.base import DynamicsModel
from symo_exp.models.flows import Flow
from symo_exp.models.objectives import Objective, Statistics
from symo_exp.optim.base import EpochOptimizer, minibatches


class Learner(DynamicsModel):
    """Trains the parameters of a flow; the loss is the mean square of an objective's residuals.

    One Lightning batch is one epoch: a list of mini batches. Optimisation is by hand, so that an
    epoch costs little more than its optimiser steps. What it leaves in
    ``epoch_metrics``: ``train_loss``, ``lr``, ``step_ms``, ``training_seconds``, ``peak_memory``
    [MiB] of the process, ``skipped_steps`` and the statistics of the objective
    (``newton_iterations`` and ``newton_failed``, means over rows and steps, where roots are found).
    In ``compiled``, "training step" takes the place of ``uncompiled_training``, "validation" that
    of ``loss``.

    ``val_loss`` is the loss on held-out samples, or what ``validation`` makes of the model and of
    the held-out trajectories.
    """

    def __init__(
        self,
        flow: Flow,
        objective: Objective,
        /,
        *,
        optimizer: Callable[[Iterable[Tensor]], Optimizer] | None = None,
        scheduler: Callable[[Optimizer], LRScheduler] | None = None,
        scheduler_monitor: Literal["train_loss", "val_loss"] = "train_loss",
        gradient_clip: float | None = None,
        validation: Callable[[DynamicsModel, Any], float] | None = None,
        **base: Any,
    ) -> None:
        super().__init__(flow, **base)
        if gradient_clip is not None and not gradient_clip > 0.0:
            raise ValueError(f"gradient_clip must be positive or null, got {gradient_clip}")
        self._validation = validation
        self.objective, self.gradient_clip = objective, gradient_clip
        self.automatic_optimization = False
        self._optimizer, self._scheduler = optimizer, scheduler
        self.scheduler_monitor = scheduler_monitor
        self.epoch_metrics: dict[str, float] = {}
        """The numbers of the last epoch of training."""
        self._statistics: dict[str, list[Tensor]] = {}
        self._training_seconds = 0.0

    # -- as an optimiser sees it ---------------------------------------------------------------

    def residuals(self, windows: Windows) -> Float[Tensor, "samples residuals"]:
        """The residuals of each sample."""
        return self._note(*self.objective(self.flow, windows))

    def loss(self, windows: Windows) -> Float[Tensor, ""]:
        """Mean square of the residuals."""
        return self.residuals(windows).square().mean()

    def loss_and_gradients(self, windows: Windows) -> Float[Tensor, ""]:
        """The loss as a number; its gradients are left in the parameters."""
        train = self.compiled.get("training step", self.uncompiled_training)
        return self._note(*train(windows))

    def uncompiled_training(self, windows: Windows) -> tuple[Tensor, Statistics]:
        """The loss as a number, with the objective's statistics; gradients go to the parameters."""
        self.zero_grad()
        residuals = self.objective(self.flow, windows)
        loss = residuals.loss
        loss.backward()
        return loss.detach(), residuals.statistics

    def validation_loss(self, windows: Windows) -> Float[Tensor, ""]:
        """The loss, without gradients."""
        return self.compiled.get("validation", self.loss)(windows)

    def _note(self, found: Tensor, statistics: Statistics) -> Tensor:
        if self.training:
            for name, value in statistics.items():
                self._statistics.setdefault(name, []).append(value)
        return found

    # -- as Lightning sees it ------------------------------------------------------------------

    def configure_optimizers(self) -> Any:
        if self._optimizer is None:
            raise ValueError("this model was built without an optimizer: it can only predict")
        optimizer = self._optimizer(self.parameters())
        return [optimizer], [self._scheduler(optimizer)] if self._scheduler else []

    def training_step(self, batches: list[Windows], _: int) -> None:
        """All optimiser steps of one epoch, then the learning rate schedule."""
        optimizer: Any = self._torch_optimizer()
        start, processor = time.perf_counter(), time.process_time()
        self._statistics = {}
        rate = optimizer.param_groups[0]["lr"]
        if isinstance(optimizer, EpochOptimizer):
            whole = optimizer.reads_trajectories
            data: Any = self.trainer
            given = data.datamodule.trajectories("train") if whole else batches
            results = optimizer.epoch(self, given)
            self.trainer.should_stop |= optimizer.finished
        else:
            results = minibatches(optimizer, self, batches)
        # Lightning counts steps in its wrapper of the optimiser; skipped ones count
        count = self.trainer.fit_loop.epoch_loop.manual_optimization.optim_step_progress.total
        count.ready, count.completed = count.ready + len(batches), count.completed + len(batches)
        mean = results["train_loss"]
        if self.scheduler_monitor == "train_loss":
            self._schedule(mean)
        self._training_seconds += time.process_time() - processor
        means = {name: torch.stack(values).mean() for name, values in self._statistics.items()}
        metrics: dict[str, Any] = {"lr": rate, **results, **means}
        metrics["training_seconds"] = self._training_seconds
        # in bytes on macOS, in KiB elsewhere
        most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        metrics["peak_memory"] = most / (2**20 if sys.platform == "darwin" else 2**10)
        metrics["step_ms"] = 1e3 * (time.perf_counter() - start) / len(batches)
        self.epoch_metrics = {name: float(value) for name, value in metrics.items()}
        # straight to where it is read: `log` takes half a millisecond for each name
        self.trainer.callback_metrics["train_loss"] = mean

    def validation_step(self, windows: Windows, _: int) -> None:
        if self._validation is None:
            loss = self.validation_loss(windows)
        else:
            data = self.trainer.datamodule  # type: ignore[attr-defined]
            loss = torch.tensor(self._validation(self, data.trajectories(data.monitor)))
        self.log("val_loss", loss, batch_size=1)
        if self.trainer.sanity_checking:
            return
        if self.scheduler_monitor == "val_loss":
            self._schedule(loss)
        method = self._torch_optimizer() if self.trainer.optimizers else None
        if isinstance(method, EpochOptimizer):
            method.validated(loss)
            self.trainer.should_stop |= method.finished

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        checkpoint["training_seconds"] = self._training_seconds

    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        self._training_seconds = checkpoint.get("training_seconds", 0.0)

    def on_train_end(self) -> None:
        method = self._torch_optimizer()
        if isinstance(method, EpochOptimizer):
            method.ended()

    def _schedule(self, monitored: Tensor) -> None:
        if isinstance(self._torch_optimizer(), EpochOptimizer):
            return  # it has no rate
        scheduler = self.lr_schedulers()
        if isinstance(scheduler, ReduceLROnPlateau):
            scheduler.step(monitored)
        elif isinstance(scheduler, LRScheduler):
            scheduler.step()

    def _torch_optimizer(self) -> Any:
        """The optimiser without Lightning's wrapper, which costs 0.2 ms a step."""
        return self.optimizers(use_pl_optimizer=False)
