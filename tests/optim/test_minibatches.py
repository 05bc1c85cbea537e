"""Steps on mini batches: those whose gradient is not finite change nothing and are counted."""

import copy
from functools import partial

import pytest
import torch

from symo_exp.optim import base
from symo_exp.optim.base import minibatches, step_bounded
from tests.models.methods import learner, windows

OPTIMIZERS = {
    "sgd": lambda p: torch.optim.SGD(p, lr=1e-2, momentum=0.9),
    "adam": lambda p: torch.optim.Adam(p, lr=1e-2),
    "fused adam": lambda p: torch.optim.Adam(p, lr=1e-2, fused=True),
    "fused adamw": lambda p: torch.optim.AdamW(p, lr=1e-2, fused=True),
}


@pytest.fixture(params=[True, False], ids=["on a CPU", "as on a GPU"])
def waiting(request, monkeypatch):
    """Run with and without reading the norm of the gradient on the host."""
    told = partial(step_bounded, wait=request.param)
    monkeypatch.setattr(base, "step_bounded", lambda *it, wait: told(*it))


@pytest.mark.parametrize("kind", OPTIMIZERS)
def test_a_batch_without_a_finite_gradient_is_skipped(kind, waiting):
    data = windows(2, 24)
    good = [data.rows(slice(0, 12)), data.rows(slice(12, 24))]
    bad = good[0]._replace(q=torch.full_like(good[0].q, torch.inf))
    model = learner("symo", "midpoint", 2)
    model.gradient_clip = 10.0
    twin = copy.deepcopy(model)
    results = [
        [minibatches(optimizer, trained, batches) for _ in range(3)]
        for trained, batches in ((model, [good[0], bad, good[1]]), (twin, good))
        for optimizer in (OPTIMIZERS[kind](trained.parameters()),)
    ]
    for with_bad, without in zip(*results, strict=True):
        assert (with_bad["skipped_steps"], without["skipped_steps"]) == (1, 0)
        assert with_bad["train_loss"] == without["train_loss"]
    assert results[1][-1]["train_loss"] < results[1][0]["train_loss"]
    for mine, other in zip(model.parameters(), twin.parameters(), strict=True):
        assert torch.equal(mine, other)


def test_the_loss_is_nan_if_every_batch_is_skipped(waiting):
    data = windows(1, 12)
    model = learner("symo", "midpoint", 1)
    model.gradient_clip = 10.0
    before = [p.detach().clone() for p in model.parameters()]
    optimizer = OPTIMIZERS["fused adam"](model.parameters())
    results = minibatches(optimizer, model, [data._replace(q=torch.nan * data.q)] * 2)
    assert results["skipped_steps"] == 2
    assert results["train_loss"].isnan()
    assert all(torch.equal(a, b) for a, b in zip(before, model.parameters(), strict=True))
