"""The step of a fused Adam without what surrounds its kernel."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch.optim import Adam, Optimizer


def direct_step(optimizer: Optimizer) -> Callable[[], object]:
    """What does the same as ``optimizer.step``, to the bit.

    Collecting parameters and moments and sorting them by device takes PyTorch as long as updating
    these networks. For a fused Adam that has taken a step before they are collected here, once;
    for all else it is ``optimizer.step``. To be asked for again when the state is replaced.
    """
    if type(optimizer) is not Adam or len(optimizer.param_groups) != 1 or _hooked(optimizer):
        return optimizer.step
    (group,) = optimizer.param_groups
    unlike = ("amsgrad", "capturable", "differentiable", "decoupled_weight_decay")
    parameters = group["params"]
    begun = all(optimizer.state.get(p) for p in parameters)
    if not group["fused"] or any(group.get(name) for name in unlike) or not begun:
        return optimizer.step
    names = ("exp_avg", "exp_avg_sq", "step")
    first, second, steps = ([optimizer.state[p][name] for p in parameters] for name in names)

    @torch.no_grad()
    def step() -> None:
        gradients = [p.grad for p in parameters]
        if any(gradient is None for gradient in gradients):
            optimizer.step()
            return
        torch._foreach_add_(steps, 1)
        beta1, beta2 = group["betas"]
        torch._fused_adam_(
            parameters, gradients, first, second, [], steps,
            lr=group["lr"], beta1=beta1, beta2=beta2, weight_decay=group["weight_decay"],
            eps=group["eps"], amsgrad=False, maximize=group["maximize"],
        )  # fmt: skip

    return step


def _hooked(optimizer: Optimizer) -> bool:
    return bool(optimizer._optimizer_step_pre_hooks or optimizer._optimizer_step_post_hooks)
