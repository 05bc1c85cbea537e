"""A training that was cut ends with the bits of one that was not, whatever is left on disk."""

import pytest
import torch

from symo_exp.configuration.command import jobs_of, parse
from symo_exp.models.base import DynamicsModel
from symo_exp.recipe import run
from tests.tiny import TINY

EPOCHS = 6
WORDS = [
    *TINY, f"trainer.max_epochs={EPOCHS}", "trainer.validate_every=2", "trainer.checkpoint_every=0",
    "pictures=false", "logger=none",
]  # fmt: skip
METHODS = [
    "model=node integrator=rk4",
    "model=l_node",
    "model=symo",
    "model=e2e_symo scheduler=cosine",
    "model=node optimizer=lbfgs scheduler=none",
    "model=symo dtype=float64 optimizer=levenberg_marquardt scheduler=none",
    "model=symo dtype=float64 optimizer=adam_then_lm optimizer.epochs=3 scheduler=none",
    "model=symo data.monitor=held_out data.held_out=1 data.monitor_trajectories=null"
    " optimizer=lbfgs scheduler=none optimizer.patience=1",
]


class Cut(BaseException):
    """The power is gone."""


def go(words, folder):
    (job,) = jobs_of(parse([*WORDS, *words.split()])).jobs
    choices = {"model": "a", "system": "b"}
    done = run(job.config, folder, choices)
    return {name: str(value) for name, value in done.evaluation.measures.items()}  # nan too


def cut(words, folder, epoch, monkeypatch):
    """The same, ending abruptly in the middle of an epoch."""
    step = DynamicsModel.training_step

    def last_step(model, batches, index):
        step(model, batches, index)
        if model.current_epoch == epoch:
            raise Cut

    with monkeypatch.context() as patch:
        patch.setattr(DynamicsModel, "training_step", last_step)
        with pytest.raises(Cut):
            go(words, folder)


def state(folder):
    found = torch.load(folder / "checkpoints" / "last.ckpt", weights_only=True)
    return {k: found[k] for k in ("state_dict", "optimizer_states", "lr_schedulers", "random")}


def same(a, b):
    if isinstance(a, torch.Tensor):
        return torch.equal(a, b)
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(a[k], b[k]) for k in a)
    if isinstance(a, list | tuple):
        return len(a) == len(b) and all(map(same, a, b))
    return a == b


@pytest.mark.parametrize("words", METHODS)
def test_cut_twice_and_resumed_it_ends_with_the_same_bits(words, workplace, monkeypatch, caplog):
    caplog.set_level("INFO", logger="symo_exp")
    whole = go(words, workplace / "whole")
    for epoch in (2, 3):
        cut(words, workplace / "cut", epoch, monkeypatch)
    torch.manual_seed(99)  # what another process would draw
    assert go(words, workplace / "cut") == whole
    resumed = [r.message for r in caplog.records if r.message.startswith("going on")]
    assert resumed == ["going on after epoch 2", "going on after epoch 3"]
    assert same(state(workplace / "cut"), state(workplace / "whole"))
