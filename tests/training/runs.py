"""Short runs that are interrupted in the middle of an epoch."""

import functools

import pytest
import torch

from symo_exp.job.parts import build
from symo_exp.job.recipe import perform
from symo_exp.runs.folder import About, RunFolder
from symo_exp.runs.series import TIME
from symo_exp.training.learner import Learner
from tests.jobs import job_of
from tests.tiny import TINY

EPOCHS = 6
CLOCKS = {TIME, "step_ms", "training_seconds", "peak_memory"}
"""Columns of a series that differ from run to run."""
WORDS = [
    *TINY, f"trainer.max_epochs={EPOCHS}", "trainer.validate_every=2", "trainer.checkpoint_every=0",
    "pictures=false", "logger=none",
]  # fmt: skip


class Cut(BaseException):
    """Stands for the end of the process."""


@functools.cache
def configuration(words):
    """Return the configuration; composing it takes longer than the run."""
    return job_of(*WORDS, *words.split()).values


def go(words, path):
    """Run, and return the measures as text, so that nan equals nan."""
    config, folder = configuration(words), RunFolder(path)
    perform(build(config, folder), config, folder, About("a b", {"model": "a"}))
    return {name: str(value) for name, value in folder.measures().items()}


def cut(words, path, epoch, monkeypatch):
    """Run until just before the end of an epoch."""
    step = Learner.training_step

    def last_step(model, batches, index):
        step(model, batches, index)
        if model.current_epoch == epoch:
            raise Cut

    with monkeypatch.context() as patch:
        patch.setattr(Learner, "training_step", last_step)
        with pytest.raises(Cut):
            go(words, path)


def state(folder):
    """Return the state of a training in its last checkpoint."""
    found = torch.load(folder / "checkpoints" / "last.ckpt", weights_only=True)
    return {k: found[k] for k in ("state_dict", "optimizer_states", "lr_schedulers", "random")}


def same(a, b):
    """Return whether two states are equal bit for bit."""
    if isinstance(a, torch.Tensor):
        return torch.equal(a, b)
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(a[k], b[k]) for k in a)
    if isinstance(a, list | tuple):
        return len(a) == len(b) and all(map(same, a, b))
    return a == b
