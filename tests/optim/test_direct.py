"""Direct steps equal those of PyTorch's optimisers bit for bit."""

import copy

import pytest
import torch

from symo_exp.optim.direct import direct_step

SHAPES = [(7, 3), (7,), (1, 7)]
OPTIMIZERS = {
    "adam": lambda p: torch.optim.Adam(p, lr=1e-2, fused=True),
    "with decay": lambda p: torch.optim.Adam(p, betas=(0.8, 0.9), weight_decay=0.1, fused=True),
    "uphill": lambda p: torch.optim.Adam(p, maximize=True, eps=1e-3, fused=True),
    "not fused": lambda p: torch.optim.Adam(p, lr=1e-2),
    "amsgrad": lambda p: torch.optim.Adam(p, amsgrad=True, fused=True),
    "adamw": lambda p: torch.optim.AdamW(p, fused=True),
    "sgd": lambda p: torch.optim.SGD(p, lr=1e-2, momentum=0.9),
    "in groups": lambda p: torch.optim.Adam([{"params": p[:1]}, {"params": p[1:]}], fused=True),
}
DIRECT = {"adam", "with decay", "uphill"}


def weights():
    generator = torch.Generator().manual_seed(0)
    return [torch.randn(shape, generator=generator).requires_grad_() for shape in SHAPES]


def give_gradients(parameters, k):
    generator = torch.Generator().manual_seed(k)
    for p in parameters:
        p.grad = torch.randn(p.shape, generator=generator)


@pytest.mark.parametrize("kind", OPTIMIZERS)
def test_direct_steps_equal_those_of_the_optimizer(kind):
    theirs, mine = weights(), weights()
    reference, optimizer = OPTIMIZERS[kind](theirs), OPTIMIZERS[kind](mine)
    for epoch in range(4):
        for group in (*reference.param_groups, *optimizer.param_groups):
            group["lr"] = 1e-2 / (1 + epoch)
        if epoch == 2:  # resumed: the moments are others from here on
            optimizer.load_state_dict(copy.deepcopy(optimizer.state_dict()))
        step = direct_step(optimizer)
        assert (step != optimizer.step) == (kind in DIRECT)
        for k in range(3):
            give_gradients(theirs, 10 * epoch + k)
            give_gradients(mine, 10 * epoch + k)
            if (epoch, k) == (3, 1):  # a parameter that the loss does not depend on
                theirs[1].grad = mine[1].grad = None
            reference.step()
            step()
    for one, other in zip(theirs, mine, strict=True):
        assert torch.equal(one, other)
    states = reference.state_dict()["state"], optimizer.state_dict()["state"]
    torch.testing.assert_close(*states, rtol=0.0, atol=0.0)


def test_hooks_are_called_at_every_step():
    parameters, heard = weights(), []
    optimizer = OPTIMIZERS["adam"](parameters)
    optimizer.register_step_post_hook(lambda *_: heard.append(1))
    for k in range(3):
        give_gradients(parameters, k)
        direct_step(optimizer)()
    assert len(heard) == 3
