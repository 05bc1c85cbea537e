"""The limit of the processor time of a training."""

from types import SimpleNamespace

import pytest

from symo_exp.training import overrun
from symo_exp.training.overrun import StopOverrun


@pytest.fixture
def clock(monkeypatch):
    now = SimpleNamespace(seconds=100.0)
    monkeypatch.setattr(overrun, "time", SimpleNamespace(process_time=lambda: now.seconds))
    return now


def epoch_ends(callback):
    """Return whether the training is ended there."""
    trainer = SimpleNamespace(should_stop=False, current_epoch=0)
    callback.on_train_epoch_end(trainer, None)
    return trainer.should_stop


@pytest.mark.parametrize("before", [10.0, None])  # a limit may be added when a run is resumed
def test_the_time_of_all_starts_counts(before, clock):
    first = StopOverrun(before)
    first.on_train_start(None, None)
    clock.seconds = 106.0
    assert not epoch_ends(first)
    saved = first.state_dict()

    clock.seconds = 1.0  # in another process
    resumed = StopOverrun(10.0)
    resumed.load_state_dict(saved)
    resumed.on_train_start(None, None)
    clock.seconds = 4.0
    assert not epoch_ends(resumed)
    clock.seconds = 6.0
    assert epoch_ends(resumed)
    assert resumed.state_dict() == {"seconds": 11.0}


def test_without_a_limit_no_time_is_too_long(clock):
    callback = StopOverrun(None)
    callback.on_train_start(None, None)
    clock.seconds = 1e9
    assert not epoch_ends(callback)
