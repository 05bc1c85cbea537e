"""Training steps read no values back, so on a GPU the host does not wait."""

from functools import partial

import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode

from symo_exp.optim import base
from symo_exp.optim.base import minibatches, step_bounded
from tests.models.methods import combinations, learner, one_each, reads_back, windows


class Reads(TorchDispatchMode):
    """Counts the operations whose result, or its shape, the host has to know."""

    names = ("_local_scalar_dense", "nonzero", "equal", "masked_select")

    def __init__(self):
        super().__init__()
        self.count = 0

    def __torch_dispatch__(self, function, types, args=(), kwargs=None):
        name = function.overloadpacket.__name__
        masks = args[1] if name == "index" else ()
        masked = any(mask is not None and mask.dtype == torch.bool for mask in masks)
        self.count += name in self.names or masked
        return function(*args, **(kwargs or {}))


def reads(model, steps):
    """In an epoch, after the first, in which optimisers make room."""
    optimizer = torch.optim.Adam(model.parameters(), fused=True)
    batches = [windows(2, 4)] * steps
    minibatches(optimizer, model, batches)
    with Reads() as counted:
        minibatches(optimizer, model, batches)
    return counted.count


@pytest.mark.parametrize(
    ("method", "integrator", "clip"),
    [*((*pair, 10.0) for pair in combinations()), *((*pair, None) for pair in one_each())],
)
def test_a_step_reads_no_values_unless_it_finds_roots(method, integrator, clip, monkeypatch):
    told = partial(step_bounded, wait=False)
    monkeypatch.setattr(base, "step_bounded", lambda *it, wait: told(*it))
    model = learner(method, integrator, 2)
    model.gradient_clip = clip
    once = clip is not None  # at the end of the epoch: which losses count
    counted = [reads(model, steps) for steps in (1, 4)]
    if reads_back(model.model):
        assert counted[1] > counted[0] > once
    else:
        assert counted == [once, once]
