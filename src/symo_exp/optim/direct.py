"""The step of a fused Adam without the overhead around its kernel."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch.optim import Adam, Optimizer


def direct_step(optimizer: Optimizer) -> Callable[[], object]:
    """Return a function with the effect of ``optimizer.step``, to the bit.

    PyTorch collects parameters and moments and sorts them by device in each step, which takes as
    long as updating these networks. For a fused Adam they are collected once, after its first step;
    for every other optimiser the function is ``optimizer.step``. It is not valid any more when the
    optimiser's state is replaced.
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
