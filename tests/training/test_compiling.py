"""Decisions about which parts of a training are compiled."""

import os
from types import SimpleNamespace

import pytest
from torch._inductor.runtime import cache_dir_utils

from symo_exp.compile.inductor import kernel_cache
from symo_exp.training import compiling
from symo_exp.training.compiling import COLD, WARM, CompileTraining, watches_much
from tests.models.methods import learner, windows


@pytest.mark.parametrize(
    ("watched", "every", "much"), [(16, 1, True), (15, 1, False), (80, 5, True), (79, 5, False)]
)
def test_validation_is_compiled_where_it_sees_as_many_samples_as_training(watched, every, much):
    data = SimpleNamespace(
        batches=lambda epoch: [windows(1, 8), windows(1, 8)],
        val_dataloader=lambda: [windows(1, watched)],
    )
    assert watches_much(SimpleNamespace(datamodule=data, check_val_every_n_epoch=every)) == much


@pytest.fixture
def trained(monkeypatch, tmp_path):
    """``(steps, mode, state) → whether it is compiled``, and the state of its checkpoint; after an
    epoch, on a machine with a compiler and kernels in a folder of its own."""
    calls = []
    monkeypatch.setenv("TORCHINDUCTOR_CACHE_DIR", str(tmp_path / "kernels"))
    monkeypatch.setattr(compiling, "compiler_available", lambda: True)
    monkeypatch.setattr(compiling, "compile_training", lambda *_, **__: calls.append(True))
    model = learner("symo", "midpoint", 1)

    def train(steps, mode="auto", state=None, rows=8):
        batches = [windows(1, rows)]
        data = SimpleNamespace(batches=lambda epoch: batches, val_dataloader=lambda: [])
        trainer = SimpleNamespace(max_epochs=steps, datamodule=data, check_val_every_n_epoch=1)
        callback, before = CompileTraining(mode, "settings"), len(calls)
        if state is not None:
            callback.load_state_dict(state)
        callback.on_fit_start(trainer, model)
        callback.on_train_epoch_end(trainer, model)
        return len(calls) > before, callback.state_dict()

    return train


def test_a_short_training_is_compiled_if_its_kernels_are_cached(trained):
    assert not trained(WARM)[0]
    assert not trained(COLD - 1)[0]
    assert trained(COLD)[0]  # leaves kernels
    assert trained(WARM)[0]
    assert not trained(WARM - 1)[0]
    assert trained(WARM, rows=9)[0]  # kernels are for any number of rows
    assert not trained(COLD, mode=False)[0]


def test_kernels_are_kept_where_the_user_says_or_in_the_users_own_cache(monkeypatch, tmp_path):
    """Not in the folder of temporary files that PyTorch names when it is imported."""
    monkeypatch.delenv("TORCHINDUCTOR_CACHE_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert kernel_cache() == tmp_path / "symo_exp" / "kernels"
    cache_dir_utils.cache_dir()  # PyTorch sets the variable
    assert "TORCHINDUCTOR_CACHE_DIR" in os.environ
    assert kernel_cache() == tmp_path / "symo_exp" / "kernels"
    monkeypatch.setenv("TORCHINDUCTOR_CACHE_DIR", str(tmp_path / "mine"))
    assert kernel_cache() == tmp_path / "mine"


def test_a_resumed_training_stays_eager_or_compiled(trained):
    _, eager = trained(WARM)
    assert trained(1, mode=True)[0]  # another run leaves kernels
    assert trained(WARM)[0]
    assert not trained(WARM, state=eager)[0]
    _, compiled = trained(WARM)
    assert trained(1, state=compiled)[0]
