"""The LightningModule that trains every method."""

from __future__ import annotations

import resource
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Literal

import lightning
import torch
from jaxtyping import Float
from torch import Tensor
from torch.optim import Optimizer
from torch.optim.lr_scheduler import LRScheduler, ReduceLROnPlateau
from typing_extensions import override

from symo_exp.errors import ConfigError, shortened
from symo_exp.mechanics.types import TrainingSamples, Trajectory
from symo_exp.models.base import DynamicsModel
from symo_exp.models.objectives import Objective, Statistics
from symo_exp.nets.affine import Linearised
from symo_exp.optim.base import EpochOptimizer, Equations, check_steps, minibatches

SCHEDULE = "scheduler", "scheduler_monitor"
"""Settings that have no effect on an ``EpochOptimizer``, which has no rate."""


class Learner(lightning.LightningModule):
    """Minimises the mean square of an objective's residuals over the parameters of a model.

    One Lightning batch is one epoch: a list of mini batches. Optimisation is manual, so that an
    epoch costs little more than its optimiser steps. To an optimiser the learner is a
    :class:`symo_exp.optim.base.Problem`.

    After each epoch ``epoch_metrics`` holds ``train_loss``, ``lr``, ``step_ms``,
    ``training_seconds`` (processor time), ``peak_memory`` [MiB] of the process, ``skipped_steps``
    and the means over steps of the objective's statistics. ``val_loss`` is logged.

    Args:
        model: The model to be trained.
        objective: Residuals to be minimised; those of the method if left out.
        optimizer: Factory of the optimiser; a learner without one only evaluates losses.
        scheduler: Factory of the schedule of the learning rate.
        scheduler_monitor: Loss that the schedule watches, if it watches one.
        gradient_clip: Bound on the norm of the gradient; ``None``: no bound.
        validation: Measure of the model on held-out trajectories, which becomes ``val_loss``
            instead of the loss on held-out samples.
    """

    def __init__(
        self,
        model: DynamicsModel,
        *,
        objective: Objective | None = None,
        optimizer: Callable[[Iterable[Tensor]], Optimizer] | None = None,
        scheduler: Callable[[Optimizer], LRScheduler] | None = None,
        scheduler_monitor: Literal["train_loss", "val_loss"] = "train_loss",
        gradient_clip: float | None = None,
        validation: Callable[[DynamicsModel, Sequence[Trajectory]], float] | None = None,
    ) -> None:
        super().__init__()
        if gradient_clip is not None and not gradient_clip > 0.0:
            raise ValueError(f"gradient_clip must be positive or null, got {gradient_clip}")
        chosen = objective or model.objective
        if chosen is None:
            raise ValueError(f"{type(model).__name__} has no objective to be trained on")
        self.model, self.objective = model, chosen
        self.gradient_clip, self.scheduler_monitor = gradient_clip, scheduler_monitor
        self.automatic_optimization = False
        self.compiled: dict[str, Callable[..., Any]] = {}
        """Functions that replace uncompiled ones: "training step" replaces
        ``uncompiled_training``, "validation" replaces ``loss``."""
        self.epoch_metrics: dict[str, float] = {}
        """The numbers of the last training epoch."""
        self.steps = 0
        """Optimiser steps so far, skipped ones included."""
        self._optimizer, self._scheduler, self._validation = optimizer, scheduler, validation
        self._last: tuple[Tensor, Tensor] | None = None
        self._statistics: dict[str, list[Tensor]] = {}
        self._training_seconds = 0.0

    # -- the problem that an optimiser sees ----------------------------------------------------

    @property
    def reads_velocity(self) -> bool:
        """True if the objective depends on measured velocities."""
        return self.model.reads_velocity

    @property
    def sizes(self) -> Float[Tensor, " n"]:
        """Unit of each coordinate [m], 1 of those that turn."""
        return self.model.coordinates.sizes

    def residuals(self, windows: TrainingSamples) -> Float[Tensor, "samples residuals"]:
        """Return the residuals of each sample."""
        return self._note(*self.objective(self.model.flow, windows))

    def linearised(self, windows: TrainingSamples, parameters: Sequence[Tensor]) -> Linearised:
        """Return the residuals of each sample with their derivatives in the parameters."""
        return self.objective.linearised(self.model.flow, windows, parameters)

    def as_forces(self, windows: TrainingSamples) -> Equations | None:
        """Return the same equations as forces, ``None`` if these are not suitable."""
        objective = self.objective.as_forces(self.model.flow, windows)
        return None if objective is None else Learner(self.model, objective=objective)

    def loss(self, windows: TrainingSamples) -> Float[Tensor, ""]:
        """Return the mean square of the residuals."""
        return self.residuals(windows).square().mean()

    def loss_and_gradients(self, windows: TrainingSamples) -> Float[Tensor, ""]:
        """Return the detached loss and leave its gradients in the parameters."""
        train = self.compiled.get("training step", self.uncompiled_training)
        return self._note(*train(windows))

    def uncompiled_training(self, windows: TrainingSamples) -> tuple[Tensor, Statistics]:
        """Return the detached loss and the objective's statistics; leave gradients in place."""
        self.zero_grad()
        residuals = self.objective(self.model.flow, windows)
        loss = residuals.loss
        loss.backward()
        return loss.detach(), residuals.statistics

    def validation_loss(self, windows: TrainingSamples) -> Float[Tensor, ""]:
        """Return the loss, without gradients where it is compiled."""
        return self.compiled.get("validation", self.loss)(windows)

    def _note(self, found: Tensor, statistics: Statistics) -> Tensor:
        if self.training:
            for name, value in statistics.items():
                self._statistics.setdefault(name, []).append(value)
        return found

    # -- the hooks of Lightning ----------------------------------------------------------------

    @override
    def configure_optimizers(self) -> Any:
        if self._optimizer is None:
            raise ValueError("this learner was built without an optimizer: it cannot train")
        optimizer = self._optimizer(self.parameters())
        if not isinstance(optimizer, EpochOptimizer):
            check_steps("optimizer", optimizer)
        self.objective.require(list(self.parameters()), optimizer)
        return [optimizer], [self._scheduler(optimizer)] if self._scheduler else []

    @override
    def setup(self, stage: str) -> None:
        if not self.objective.consecutive:
            self._data.cut = self.objective.cut

    @override
    def training_step(self, batches: list[TrainingSamples], _: int) -> None:
        """Take all optimiser steps of an epoch, then one step of the learning rate schedule."""
        optimizer: Any = self._torch_optimizer()
        start, processor = time.perf_counter(), time.process_time()
        self._statistics = {}
        rate = optimizer.param_groups[0]["lr"]
        flow, epoch = self.model.flow, self.current_epoch
        batches = list(self.objective.prepare(flow, batches, epoch))
        if isinstance(optimizer, EpochOptimizer):
            whole = optimizer.reads_trajectories
            given = self._data.trajectories("train") if whole else batches
            results = optimizer.epoch(self, given)
            if not isinstance(results, Mapping) or "train_loss" not in results:
                kind = type(optimizer).__name__
                raise ConfigError(
                    f"{kind}.epoch returns {shortened(results, 60)}: expected a dictionary with "
                    "train_loss, the loss at the start of the epoch"
                )
            self.trainer.should_stop |= optimizer.finished
        else:
            results = minibatches(optimizer, self, batches)
        self.steps += len(batches)
        if self.scheduler_monitor == "train_loss":
            self._schedule(results["train_loss"])
        self._training_seconds += time.process_time() - processor
        means = {name: torch.stack(values).mean() for name, values in self._statistics.items()}
        metrics: dict[str, Any] = {"lr": rate, **results, **means}
        metrics["training_seconds"] = self._training_seconds
        # in bytes on macOS, in KiB elsewhere
        most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        metrics["peak_memory"] = most / (2**20 if sys.platform == "darwin" else 2**10)
        metrics["step_ms"] = 1e3 * (time.perf_counter() - start) / len(batches)
        # kept here, since `log` takes half a millisecond for each name
        self.epoch_metrics = {name: float(value) for name, value in metrics.items()}

    @override
    def validation_step(self, windows: TrainingSamples, _: int) -> None:
        loss = self.validation_loss(windows) if self._validation is None else self._measured()
        self.log("val_loss", loss, batch_size=1)
        if self.trainer.sanity_checking:
            return
        if self.scheduler_monitor == "val_loss":
            self._schedule(loss)
        method = self._torch_optimizer() if self.trainer.optimizers else None
        if isinstance(method, EpochOptimizer):
            method.validated(loss)
            self.trainer.should_stop |= method.finished

    def _measured(self) -> Tensor:
        """Return the measure of the model, the last one if its parameters are the same."""
        parameters = torch.cat([p.detach().flatten() for p in self.model.parameters()])
        if self._last is None or not torch.equal(self._last[0], parameters):
            assert self._validation is not None
            held_out = self._data.trajectories(self._data.monitor)
            self._last = parameters, torch.tensor(self._validation(self.model, held_out))
        return self._last[1]

    @override
    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        checkpoint["training_seconds"], checkpoint["steps"] = self._training_seconds, self.steps

    @override
    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        self._training_seconds, self.steps = checkpoint["training_seconds"], checkpoint["steps"]

    @override
    def on_train_end(self) -> None:
        method = self._torch_optimizer()
        if isinstance(method, EpochOptimizer):
            method.ended()

    @property
    def _data(self) -> Any:
        trainer: Any = self.trainer
        return trainer.datamodule

    def _schedule(self, monitored: Tensor) -> None:
        if isinstance(self._torch_optimizer(), EpochOptimizer):
            return
        scheduler = self.lr_schedulers()
        if isinstance(scheduler, ReduceLROnPlateau):
            scheduler.step(monitored)
        elif isinstance(scheduler, LRScheduler):
            scheduler.step()

    def _torch_optimizer(self) -> Any:
        """Return the optimiser without Lightning's wrapper, which costs 0.2 ms a step."""
        return self.optimizers(use_pl_optimizer=False)
