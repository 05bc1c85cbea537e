"""Optimisers that take whole epochs, and the problem that an optimiser sees."""

from __future__ import annotations

import inspect
import logging
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from typing import Any, ClassVar, Protocol, TypeVar

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.utils import clip_grads_with_norm_, get_total_norm
from torch.optim import Optimizer
from typing_extensions import override

from symo_exp.checks import instance, real, whole_number
from symo_exp.errors import ConfigError
from symo_exp.mechanics.types import TrainingSamples
from symo_exp.nets.affine import Linearised
from symo_exp.optim.direct import direct_step
from symo_exp.optim.free_memory import available_bytes

Sample = TypeVar("Sample", bound=TrainingSamples)
log = logging.getLogger(__name__)

MANY = 5000
"""Number of parameters above which steps that solve normal equations take minutes."""


class Equations(Protocol):
    """Residuals of samples."""

    def residuals(self, windows: TrainingSamples) -> Float[Tensor, "samples residuals"]:
        """Return the residuals of each sample, differentiable in the parameters."""
        ...

    def linearised(self, windows: TrainingSamples, parameters: Sequence[Tensor]) -> Linearised:
        """Return the residuals of each sample with their derivatives in the parameters."""
        ...


class Problem(Equations, Protocol):
    """A model with its objective, as an optimiser sees it."""

    gradient_clip: float | None
    """Bound on the norm of the gradient in ``minibatches``."""

    @property
    def reads_velocity(self) -> bool:
        """True if residuals depend on measured velocities."""
        ...

    @property
    def sizes(self) -> Float[Tensor, " n"]:
        """Unit of each coordinate, to which its noise is relative [m]; 1 of those that turn."""
        ...

    def parameters(self) -> Iterable[Tensor]:
        """Return the parameters."""
        ...

    def as_forces(self, windows: TrainingSamples) -> Equations | None:
        """Return the same equations as forces, ``None`` if these are not suitable."""
        ...

    def loss(self, windows: TrainingSamples) -> Float[Tensor, ""]:
        """Return the mean square of the residuals, differentiable in the parameters."""
        ...

    def loss_and_gradients(self, windows: TrainingSamples) -> Float[Tensor, ""]:
        """Return the loss without a graph; its gradients are left in the parameters."""
        ...


class EpochOptimizer(Optimizer, ABC):
    """An optimiser that takes all samples of an epoch at once.

    It computes its own gradients and line searches. Everything that resuming needs is in
    ``memory``, which is part of ``state_dict``.

    Losses on held-out samples arrive through ``validated``: the best parameters are kept. After
    ``patience`` losses in a row that do not improve by a hundredth the training is ``finished``;
    losses do not count while the training loss ``falls``.

    Args:
        params: The parameters.
        patience: Number of held-out losses without improvement.
        tolerance: Later parameters are kept although their loss is larger than the best one by up
            to this share.
    """

    reads_trajectories: ClassVar[bool] = False
    """True if ``epoch`` is given whole trajectories instead of mini batches."""
    processor_only: ClassVar[bool] = False
    """True if it cannot work on a GPU."""
    rate: ClassVar[str | None] = None
    """The setting of its learning rate, ``None`` if it has none."""

    def __init__(self, params: Iterable[Tensor], *, patience: int, tolerance: float = 0.0) -> None:
        whole_number("optimizer.patience", patience)
        real("optimizer.tolerance", tolerance, low=0)
        super().__init__(params, {"lr": 1.0})
        self.parameters: list[Tensor] = [p for g in self.param_groups for p in g["params"]]
        self.patience, self.tolerance = patience, tolerance
        self.finished = False
        self._most_bytes = 0
        self.memory: dict[str, Any] = {"best": math.inf, "waited": 0, "weights": None}

    def require_normal_equations(self) -> None:
        """Refuse parameters in single precision, and warn of so many that steps take minutes.

        Raises:
            ConfigError: If there are some in single precision.
        """
        if any(p.dtype != torch.float64 for p in self.parameters):
            raise ConfigError(
                f"{type(self).__name__} squares the condition number: it needs dtype=float64"
            )
        count = sum(p.numel() for p in self.parameters)
        if count > MANY:
            log.warning(
                "%s: a step solves equations of %d parameters, which takes minutes and %.2g GB "
                "or more; give a smaller network, such as net.width=16, or optimizer=adam",
                type(self).__name__, count, 8e-9 * count**2,
            )  # fmt: skip

    def require_memory(self, equations: int, *, copies: int) -> None:
        """Refuse systems that do not fit into memory.

        Memory of the largest one so far may still belong to the process, which uses it again.

        Args:
            equations: Number of residuals.
            copies: Number of matrices of their derivatives that there are at once.

        Raises:
            ConfigError: If there is less free memory.
        """
        if self.parameters[0].device.type != "cpu":
            return
        size = sum(p.numel() for p in self.parameters)
        needed = 8 * (copies * equations * size + 3 * min(size, equations) ** 2)
        free = available_bytes()
        if free is not None and needed - self._most_bytes > free:
            raise ConfigError(
                f"{type(self).__name__} needs about {needed / 1e9:.1f} GB for {size} parameters "
                f"and {equations} residuals, and {free / 1e9:.1f} GB are free; use a smaller "
                "net.width, fewer trajectories (data.n_traj), or optimizer=adam or lbfgs"
            )
        self._most_bytes = max(self._most_bytes, needed)

    @abstractmethod
    def epoch(self, model: Problem, batches: Sequence[Any]) -> dict[str, Tensor]:
        """Run one epoch; return metrics with at least ``train_loss``, the loss at its start."""

    def validated(self, loss: Tensor) -> None:
        """Record a loss on held-out samples."""
        value, best = float(loss.detach()), self.memory["best"]
        if value < best * (1.0 + self.tolerance):
            self.memory |= {"best": min(value, best), "weights": self.flat()}
        falls = self.falls()
        if value < 0.99 * best:
            self.memory["waited"] = 0
        elif not falls:
            self.memory["waited"] += 1
        self.finished = self.finished or self.memory["waited"] >= self.patience

    def falls(self) -> bool:
        """Return whether the training loss still falls.

        It falls if it has decreased so far since the last call that held-out losses may follow.
        """
        return False

    def estimate(self) -> dict[str, Any] | None:
        """Return how parameters were estimated: arguments of ``optim.posterior.posterior``.

        ``None`` where they are no least-squares estimate along trajectories.
        """
        return None

    def ended(self) -> None:
        """Put the best parameters in place after the last epoch."""
        if self.memory["weights"] is not None:
            self.place(self.memory["weights"])

    def flat(self) -> Tensor:
        """Return all parameters as one vector."""
        return torch.cat([p.detach().flatten() for p in self.parameters])

    @torch.no_grad()
    def place(self, flat: Tensor) -> None:
        """Put a vector of all parameters in place."""
        sizes = [p.numel() for p in self.parameters]
        for p, part in zip(self.parameters, flat.split(sizes), strict=True):
            p.copy_(part.view_as(p))

    @override
    def step(self, closure: Any = None) -> None:  # type: ignore[override]
        raise TypeError(f"{type(self).__name__} is driven by epochs, not by steps")

    @override
    def state_dict(self) -> dict[str, Any]:
        return {**super().state_dict(), "memory": dict(self.memory)}

    @override
    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        state = dict(state_dict)
        self.memory |= state.pop("memory")
        self.finished = self.memory["waited"] >= self.patience
        super().load_state_dict(state)


def check_steps(key: str, optimizer: Any) -> None:
    """Refuse what is no optimiser for ``minibatches``.

    Args:
        key: The setting that gives it.
        optimizer: The given object.

    Raises:
        ConfigError: If it is no optimiser of torch, or one that evaluates the loss itself.
    """
    instance(key, optimizer, Optimizer)
    closure = inspect.signature(type(optimizer).step).parameters.get("closure")
    if isinstance(optimizer, EpochOptimizer) or (closure and closure.default is closure.empty):
        raise ConfigError(
            f"{key} is {type(optimizer).__name__}, which evaluates the loss several times in a "
            "step: expected an optimizer of mini batches, such as torch.optim.Adam; L-BFGS on all "
            "samples is optimizer=lbfgs"
        )


def minibatches(
    optimizer: Optimizer, model: Problem, batches: Sequence[TrainingSamples]
) -> dict[str, Tensor]:
    """Take one step of a torch optimiser for each mini batch.

    With ``model.gradient_clip`` the norm of the gradient is bounded by it. A batch whose gradient
    is not finite is then skipped, left out of the mean loss, and counted: untrained Lagrangians
    have rows with a nearly singular inertia, from which explicit steps diverge.
    """
    losses, finite = [], []
    parameters, step = list(model.parameters()), direct_step(optimizer)
    for windows in batches:
        losses.append(model.loss_and_gradients(windows))
        if model.gradient_clip is None:
            step()
            continue
        norm = get_total_norm([p.grad for p in parameters if p.grad is not None])
        finite.append(norm.isfinite())
        wait = norm.device.type == "cpu"
        step_bounded(optimizer, step, parameters, norm, model.gradient_clip, wait=wait)
    loss = torch.stack(losses)
    if not finite:
        return {"train_loss": loss.mean()}
    taken = torch.stack(finite)
    return {"train_loss": loss[taken].mean(), "skipped_steps": (~taken).sum().float()}


def step_bounded(
    optimizer: Optimizer,
    step: Callable[[], object],
    parameters: Sequence[Tensor],
    norm: Tensor,
    largest: float,
    *,
    wait: bool,
) -> None:
    """Take a ``step`` with a bounded gradient, or none if the gradient is not finite.

    Args:
        optimizer: The optimiser.
        step: Its step.
        parameters: Its parameters.
        norm: Norm of the gradient.
        largest: Bound on the norm.
        wait: Whether to read the norm, which synchronises with a GPU. Otherwise an optimiser that
            can skip steps by itself, as for scaled gradients, is told when to do so.
    """
    if not wait and getattr(optimizer, "_step_supports_amp_scaling", False):
        clip_grads_with_norm_(parameters, largest, norm)
        optimizer.found_inf = (~norm.isfinite()).float()  # type: ignore[attr-defined]
        optimizer.step()
        return
    read = float(norm)
    if read > largest:
        clip_grads_with_norm_(parameters, largest, norm)
    if math.isfinite(read):
        step()


def concatenated(batches: Sequence[Sample]) -> Sample:
    """Return the mini batches of an epoch as one batch."""
    return type(batches[0])(*(torch.cat(fields) for fields in zip(*batches, strict=True)))
