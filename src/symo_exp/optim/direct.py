"""The step of a fused Adam without what surrounds its kernel."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch.optim import Adam, Optimizer


def direct_step(optimizer: Optimizer) -> Callable[[], object]:
    """What does the same as ``optimizer.step``, to the bit.

    Collecting parameters and moments and sorting them by device takes PyTorch as long as updating
    these networks. For a fused Adam they are collected here, once, when its first step has made
    the moments; for all else it is ``optimizer.step``. To be asked for again when the state is
    replaced.
    """
    hooked = optimizer._optimizer_step_pre_hooks or optimizer._optimizer_step_post_hooks
    if type(optimizer) is not Adam or len(optimizer.param_groups) != 1 or hooked:
        return optimizer.step
    (group,) = optimizer.param_groups
    unlike = ("amsgrad", "capturable", "differentiable", "decoupled_weight_decay")
    if not group["fused"] or any(group.get(name) for name in unlike):
        return optimizer.step
    parameters = group["params"]
    moments: list[list[torch.Tensor]] = []

    @torch.no_grad()
    def step() -> None:
        gradients = [p.grad for p in parameters]
        if not moments and all(optimizer.state.get(p) for p in parameters):
            names = ("exp_avg", "exp_avg_sq", "step")
            moments.extend([optimizer.state[p][name] for p in parameters] for name in names)
        if not moments or any(gradient is None for gradient in gradients):
            optimizer.step()
            return
        first, second, steps = moments
        torch._foreach_add_(steps, 1)
        beta1, beta2 = group["betas"]
        torch._fused_adam_(
            parameters, gradients, first, second, [], steps,
            lr=group["lr"], beta1=beta1, beta2=beta2, weight_decay=group["weight_decay"],
            eps=group["eps"], amsgrad=False, maximize=group["maximize"],
        )  # fmt: skip

    return step
