"""Training in single precision, here and on a GPU where there is one."""

import pytest
import torch

from symo_exp.mechanics.roots import Newton
from symo_exp.mechanics.types import Windows
from symo_exp.optim.base import minibatches
from tests.models.methods import combinations, learner, reads_back, windows

N = 2


def small(method, integrator):
    model = learner(method, integrator, N)
    if not model.reads_velocity:
        model.model.flow.root = Newton(tolerance=1e-5)
    model.gradient_clip = 10.0
    return model


def losses(model, samples, epochs=3):
    """Of each epoch of two steps of Adam."""
    optimizer = torch.optim.Adam(model.parameters(), lr=1e-2, fused=True)
    halves = [samples.rows(slice(0, 6)), samples.rows(slice(6, 12))]
    return [float(minibatches(optimizer, model, halves)["train_loss"]) for _ in range(epochs)]


@pytest.mark.parametrize("device", ["cpu", pytest.param("cuda", marks=pytest.mark.gpu)])
@pytest.mark.parametrize(("method", "integrator"), combinations())
def test_training_in_single_precision_follows_double(method, integrator, device):
    samples = windows(N, 12)
    expected = losses(small(method, integrator), samples)
    assert expected[-1] < expected[0]
    single = Windows(*(x.to(device, torch.float32) for x in samples))
    found = losses(small(method, integrator).to(device, torch.float32), single)
    assert found == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize(("method", "integrator"), combinations())
def test_a_loss_needs_nothing_from_another_device(method, integrator):
    """Tested without a GPU: tensors of the meta device do not mix with those in memory."""
    model = small(method, integrator)
    if reads_back(model.model):
        pytest.skip("reads a number on its way")
    nowhere = Windows(*(x.to("meta") for x in windows(N, 12)))
    model.to("meta").loss(nowhere).backward()
    assert {p.grad.device.type for p in model.parameters() if p.grad is not None} == {"meta"}
