"""What an optimiser needs that takes more than one step a mini batch."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from typing import Any, ClassVar, Protocol

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.utils import clip_grads_with_norm_, get_total_norm
from torch.optim import Optimizer

from symo_exp.errors import ConfigError
from symo_exp.mechanics.types import Windows
from symo_exp.optim.direct import direct_step


class Problem(Protocol):
    """What is minimised, as an optimiser sees it: a model and its objective."""

    gradient_clip: float | None

    @property
    def reads_velocity(self) -> bool: ...

    def parameters(self) -> Iterable[Tensor]: ...

    def residuals(self, windows: Windows) -> Float[Tensor, "samples residuals"]: ...

    def loss(self, windows: Windows) -> Tensor: ...

    def loss_and_gradients(self, windows: Windows) -> Tensor: ...


class EpochOptimizer(Optimizer, ABC):
    """An optimiser that is given all samples of an epoch and does with them what it wants.

    Everything else, gradients and line searches included, is its own business. What it must
    remember to be resumed goes into ``memory``, which ``state_dict`` carries.

    Losses on held-out samples arrive through ``validated``: the best parameters are kept, later
    ones also where they are worse by less than ``tolerance``, relatively. After ``patience`` losses
    in a row that do not improve by a hundredth the training is ``finished``; those do not count
    during which the training loss ``falls``.
    """

    reads_trajectories: ClassVar[bool] = False
    """Whether ``epoch`` is given whole trajectories instead of mini batches."""

    def __init__(self, params: Iterable[Tensor], *, patience: int, tolerance: float = 0.0) -> None:
        if patience < 1:
            raise ConfigError(f"optimizer.patience={patience}: expected at least 1")
        if not 0 <= tolerance < math.inf:
            raise ConfigError(f"optimizer.tolerance={tolerance}: expected 0 or more")
        super().__init__(params, {"lr": 1.0})
        self.parameters: list[Tensor] = [p for g in self.param_groups for p in g["params"]]
        self.patience, self.tolerance = patience, tolerance
        self.finished = False
        self.memory: dict[str, Any] = {"best": math.inf, "waited": 0, "weights": None}

    @abstractmethod
    def epoch(self, model: Problem, batches: Sequence[Any]) -> dict[str, Tensor]:
        """One epoch; returns at least ``train_loss``, here the loss that it began with."""

    def validated(self, loss: Tensor) -> None:
        """Take note of a loss on held-out samples."""
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
        """Whether the training loss falls so fast, since this was asked last, that held-out losses
        may well follow."""
        return False

    def ended(self) -> None:
        """The last epoch is over: leave the best parameters in place."""
        if self.memory["weights"] is not None:
            self.place(self.memory["weights"])

    def flat(self) -> Tensor:
        """All parameters as one vector."""
        return torch.cat([p.detach().flatten() for p in self.parameters])

    @torch.no_grad()
    def place(self, flat: Tensor) -> None:
        """Put such a vector in place."""
        sizes = [p.numel() for p in self.parameters]
        for p, part in zip(self.parameters, flat.split(sizes), strict=True):
            p.copy_(part.view_as(p))

    def step(self, closure: Any = None) -> None:  # type: ignore[override]
        raise TypeError(f"{type(self).__name__} is driven by epochs, not by steps")

    def state_dict(self) -> dict[str, Any]:
        return {**super().state_dict(), "memory": dict(self.memory)}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        state = dict(state_dict)
        self.memory |= state.pop("memory")
        self.finished = self.memory["waited"] >= self.patience
        super().load_state_dict(state)


def minibatches(
    optimizer: Optimizer, model: Problem, batches: Sequence[Windows]
) -> dict[str, Tensor]:
    """One step of a torch optimiser for each mini batch.

    With ``model.gradient_clip`` the norm of the gradient is bounded by it, and a batch whose
    gradient is not finite is skipped, out of the mean loss too, and counted: a Lagrangian without
    training has rows with a nearly singular inertia, from which explicit steps fly off.
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
    """A ``step`` with the ``norm`` of the gradient bounded; none where it is not finite.

    Reading the norm makes the host wait for all that a GPU has been told to do. Unless it is to
    ``wait``, an optimiser that can skip steps by itself, as for scaled gradients, is told when.
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


def concatenated(batches: Sequence[Windows]) -> Windows:
    """The mini batches of an epoch as one."""
    return Windows(*(torch.cat(fields) for fields in zip(*batches, strict=True)))
