"""What the four methods share: one-step map, rollout, loss and the training epoch."""

from __future__ import annotations

import copy
import logging
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from typing import Any, ClassVar, Literal, NamedTuple, Protocol

import lightning
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.optim import Optimizer
from torch.optim.lr_scheduler import LRScheduler, ReduceLROnPlateau

from symo_exp.mechanics.euler_lagrange import generalised_force
from symo_exp.mechanics.lagrangian import Lagrangian
from symo_exp.mechanics.types import Coordinates, Windows
from symo_exp.models.compiled import Program
from symo_exp.optim.base import EpochOptimizer, minibatches

log = logging.getLogger(__name__)

PROGRAMS = "_program", "_validation_program", "_rollout_program"
"""What is compiled of a model."""


class Compiled(Protocol):
    """A loss, and if it was asked for them its gradients in the order of ``parameters``."""

    parameters: list[Tensor]

    def __call__(self, windows: Windows, /) -> tuple[Any, ...]: ...


Advance = Callable[[Tensor, Tensor, Tensor, Tensor], tuple[Tensor, Tensor, Tensor]]
"""A step of a rollout: what it carries, with the controls at both ends, to what it carries next,
and whether roots were found. Compiled ones want all tensors contiguous, always the same way."""


class Step(NamedTuple):
    """The state one time step later, with the status of the root finding row by row."""

    q: Float[Tensor, "batch n"]
    v: Float[Tensor, "batch n"]
    converged: Bool[Tensor, " batch"]
    iterations: Int[Tensor, " batch"]


class Rollout(NamedTuple):
    """A trajectory from node 0 to node ``steps``; ``converged`` belongs to the steps between."""

    q: Float[Tensor, "batch nodes n"]
    v: Float[Tensor, "batch nodes n"]
    converged: Bool[Tensor, "batch steps"]


class DynamicsModel(lightning.LightningModule, ABC):
    """A learned one-step map ``(q_k, v_k, u_k, u_{k+1}) → (q_{k+1}, v_{k+1})``.

    One Lightning batch is one epoch: a list of mini batches. Optimisation is by hand, so that an
    epoch costs little more than its optimiser steps. What it logs, once an epoch: ``train_loss``,
    ``lr``, ``step_ms``, ``training_seconds``, ``skipped_steps`` and, where roots are found,
    ``newton_iterations`` and ``newton_failed``.
    """

    reads_velocity: ClassVar[bool]
    """Whether the method reads measured velocities; a variational one infers them from poses."""

    input_matrix: Tensor

    def __init__(
        self,
        *,
        coordinates: Coordinates,
        input_matrix: Tensor,
        time_step: float,
        optimizer: Callable[[Iterable[Tensor]], Optimizer] | None = None,
        scheduler: Callable[[Optimizer], LRScheduler] | None = None,
        scheduler_monitor: Literal["train_loss", "val_loss"] = "train_loss",
        gradient_clip: float | None = None,
        evaluation_dtype: Literal["float32", "float64"] = "float64",
    ) -> None:
        super().__init__()
        if gradient_clip is not None and not gradient_clip > 0.0:
            raise ValueError(f"gradient_clip must be positive or null, got {gradient_clip}")
        self.gradient_clip = gradient_clip
        self.automatic_optimization = False
        self.coordinates = coordinates
        self.time_step = float(time_step)
        dtype = torch.get_default_dtype()
        self.register_buffer("input_matrix", input_matrix.to(dtype), persistent=False)
        self._optimizer, self._scheduler = optimizer, scheduler
        self.scheduler_monitor = scheduler_monitor
        self._evaluation_dtype: torch.dtype = getattr(torch, evaluation_dtype)
        self._statistics: dict[str, Tensor] = {}
        self._training_seconds = 0.0
        self._program: Compiled | None = None
        self._validation_program: Compiled | None = None
        self._rollout_program: Advance | None = None

    @property
    def learns(self) -> bool:
        """Whether there is anything to train."""
        return any(True for _ in self.parameters())

    # -- the method ----------------------------------------------------------------------------

    @property
    def lagrangian(self) -> Lagrangian | None:
        """The learned Lagrangian, where the method has one."""
        return None

    @abstractmethod
    def residuals(self, windows: Windows) -> Float[Tensor, "samples residuals"]:
        """The training residuals of each sample; the loss is their mean square."""

    @abstractmethod
    def initial_velocity(self, windows: Windows) -> Float[Tensor, "samples n"]:
        """The velocity at node ``k`` with which the method starts a prediction."""

    @abstractmethod
    def step(
        self,
        q: Float[Tensor, "batch n"],
        v: Float[Tensor, "batch n"],
        u: Float[Tensor, "batch m"] | None = None,
        u_next: Float[Tensor, "batch m"] | None = None,
    ) -> Step:
        """One time step. Without a control it is zero; without ``u_next`` it is held."""

    def predict(self, windows: Windows) -> Step:
        """The one-step prediction of node ``k+1`` that every measure uses."""
        return self.step(windows.q, self.initial_velocity(windows), windows.u, windows.u_next)

    @torch.no_grad()
    def rollout(
        self,
        q0: Float[Tensor, "batch n"],
        v0: Float[Tensor, "batch n"],
        u: Float[Tensor, "batch nodes m"] | None = None,
        *,
        steps: int | None = None,
    ) -> Rollout:
        """``steps`` time steps from ``(q0, v0)``, all trajectories at once.

        ``u`` holds the control at every node, first to last; without it the motion is unforced
        and ``steps`` says how long. A trajectory that diverges ends in non-finite numbers.
        """
        if (u is None) == (steps is None):
            raise ValueError("rollout needs either u, the control at every node, or steps")
        if u is None:
            assert steps is not None
            u = q0.new_zeros(len(q0), steps + 1, self.input_matrix.shape[1])
        x, y = self._encode(q0, v0)
        poses, inner, converged = [x], [y], []
        for k in range(u.shape[1] - 1):
            x, y, ok = self._advance_compiled(x, y, u[:, k], u[:, k + 1])
            poses.append(x)
            inner.append(y)
            converged.append(ok)
        q, y = torch.stack(poses, 1), torch.stack(inner, 1)
        v = self._decode(q.flatten(0, 1), y.flatten(0, 1)).view_as(q)
        status = torch.stack(converged, 1) if converged else q0.new_zeros(len(q0), 0).bool()
        return Rollout(q, v, status)

    def _encode(self, q: Tensor, v: Tensor) -> tuple[Tensor, Tensor]:
        """What a rollout carries from node to node: the velocity, or the momentum instead."""
        return q, v

    def _advance(
        self, q: Tensor, y: Tensor, u: Tensor, u_next: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        step = self.step(q, y, u, u_next)
        return step.q, step.v, step.converged

    def _advance_compiled(
        self, q: Tensor, y: Tensor, u: Tensor, u_next: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """The same, compiled if so wanted and possible."""
        if self._rollout_program is not None:
            try:
                return self._rollout_program(*(x.contiguous() for x in (q, y, u, u_next)))
            except Exception as error:  # of a compiler, which may fail in any way
                self._do_without_compiler(error, "rollout")
        return self._advance(q, y, u, u_next)

    def _decode(self, q: Tensor, y: Tensor) -> Tensor:
        return y

    def __getstate__(self) -> dict[str, Any]:
        """A copy goes without what was compiled for this model, and can be pickled."""
        state: dict[str, Any] = super().__getstate__()
        return state | dict.fromkeys(PROGRAMS)

    def for_evaluation(self) -> DynamicsModel:
        """A copy for measuring: double precision, roots found to convergence."""
        twin = copy.deepcopy(self)
        return twin.to(self._evaluation_dtype).eval().requires_grad_(False)

    def energy(self, q: Tensor, v: Tensor) -> Tensor:
        """Learned total energy [J, up to a constant]."""
        return self._learned().energy(q, v)

    def mass_matrix(self, q: Tensor) -> Tensor:
        """Learned inertia ``H(q)``."""
        return self._learned().mass_matrix(q)

    def potential(self, q: Tensor) -> Tensor:
        """Learned potential energy [J, up to a constant]."""
        return self._learned().potential(q)

    def momentum(self, q: Tensor, v: Tensor) -> Tensor:
        """Learned momentum ``p = H(q) v``."""
        return self._learned().momentum(q, v)

    def _learned(self) -> Lagrangian:
        if self.lagrangian is None:
            raise AttributeError(f"{type(self).__name__} learns no Lagrangian")
        return self.lagrangian

    def _force(self, u: Tensor | None, like: Tensor) -> Tensor:
        """``F = B u``, zero without a control."""
        return torch.zeros_like(like) if u is None else generalised_force(self.input_matrix, u)

    # -- training ------------------------------------------------------------------------------

    def loss(self, windows: Windows) -> Float[Tensor, ""]:
        """Mean square of the residuals."""
        return self.residuals(windows).square().mean()

    def loss_and_gradients(self, windows: Windows) -> Float[Tensor, ""]:
        """The loss as a number; its gradients are left in the parameters."""
        if self._program is not None:
            try:
                loss, gradients = self._program(windows)
            except Exception as error:  # of a compiler, which may fail in any way
                self._do_without_compiler(error)
        if self._program is None:
            self.zero_grad()
            loss = self.loss(windows)
            loss.backward()
            return loss.detach()
        for parameter, gradient in zip(self._program.parameters, gradients.tensors, strict=True):
            parameter.grad = gradient
        return loss

    def validation_loss(self, windows: Windows) -> Float[Tensor, ""]:
        """The loss, without gradients."""
        if self._validation_program is not None:
            try:
                loss: Tensor = self._validation_program(windows)[0]
                return loss
            except Exception as error:
                self._do_without_compiler(error)
        return self.loss(windows)

    @property
    def can_be_compiled(self) -> bool:
        """Whether the loss is a fixed sequence of operations, whatever the numbers."""
        return True

    def compile_training(self, *, validation: bool = False) -> None:
        """Compile ``loss_and_gradients`` at its next call, and ``validation_loss`` if wanted; see
        ``models.compiled``."""
        self._program = self._compiled_loss(gradients=True)
        self._validation_program = self._compiled_loss(gradients=False) if validation else None

    def _compiled_loss(self, *, gradients: bool) -> Compiled:
        return Program(self, self.loss, gradients=gradients)

    @property
    def rollout_can_be_compiled(self) -> bool:
        """Whether a step of a rollout consists of fixed sequences of operations."""
        return self.learns

    def compile_rollout(self) -> None:
        """Compile the steps of ``rollout`` at its next call: for those who need many.

        That takes up to a minute for each new number of trajectories and precision, in later
        processes some seconds; then steps take a fraction of their time. The motion is the same to
        the tolerance of the roots. Where it is not possible a line says so and nothing changes.
        """
        if self.rollout_can_be_compiled:
            self._rollout_program = self._compiled_advance()
        else:
            log.warning("a step of this rollout is no fixed sequence of operations: not compiled")

    def _compiled_advance(self) -> Advance:
        return Program(self, self._advance, gradients=False)

    def _do_without_compiler(self, error: Exception, what: str = "training step") -> None:
        reason = str(error).strip().splitlines() or [type(error).__name__]
        log.warning("the %s is not compiled: %s", what, reason[0])
        vars(self).update(dict.fromkeys(PROGRAMS))

    def configure_optimizers(self) -> Any:
        if self._optimizer is None:
            raise ValueError("this model was built without an optimizer: it can only predict")
        optimizer = self._optimizer(self.parameters())
        if self._scheduler is None:
            return optimizer
        return [optimizer], [{"scheduler": self._scheduler(optimizer)}]

    def training_step(self, batches: list[Windows], _: int) -> None:
        """All optimiser steps of one epoch, then the learning rate schedule."""
        optimizer: Any = self._torch_optimizer()
        start, processor = time.perf_counter(), time.process_time()
        self._statistics = {}
        rate = optimizer.param_groups[0]["lr"]
        if isinstance(optimizer, EpochOptimizer):
            results = optimizer.epoch(self, batches)
            self.trainer.should_stop |= optimizer.finished
        else:
            results = minibatches(optimizer, self, batches)
        self._count_steps(len(batches))
        mean = results["train_loss"]
        if self.scheduler_monitor == "train_loss":
            self._schedule(mean)
        self._training_seconds += time.process_time() - processor
        metrics: dict[str, Any] = {"lr": rate, **results}
        metrics |= {name: value / len(batches) for name, value in self._statistics.items()}
        metrics["training_seconds"] = self._training_seconds
        metrics["step_ms"] = 1e3 * (time.perf_counter() - start) / len(batches)
        # straight to where they go: `log_dict` takes half a millisecond for each name
        self.trainer.callback_metrics["train_loss"] = mean
        for logger in self.loggers:
            told = {name: float(value) for name, value in metrics.items()}
            logger.log_metrics(told | {"epoch": self.current_epoch}, self.global_step)

    def validation_step(self, windows: Windows, _: int) -> None:
        loss = self.validation_loss(windows)
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

    def _count(self, name: str, value: Tensor) -> None:
        """Add to a statistic whose mean over the epoch's steps is logged."""
        if self.training:
            self._statistics[name] = self._statistics.get(name, 0.0) + value.detach()

    def _torch_optimizer(self) -> Any:
        """The optimiser without Lightning's wrapper, which costs 0.2 ms a step."""
        return self.optimizers(use_pl_optimizer=False)

    def _count_steps(self, steps: int) -> None:
        """Tell Lightning, whose ``global_step`` is counted by that wrapper; skipped ones count."""
        total = self.trainer.fit_loop.epoch_loop.manual_optimization.optim_step_progress.total
        total.ready += steps
        total.completed += steps
