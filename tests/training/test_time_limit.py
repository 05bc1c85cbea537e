"""On the signal of a cluster's time limit a job saves and is queued again."""

import json
import os
import signal

import pytest

from symo_exp.__main__ import main
from symo_exp.process import stopping
from symo_exp.training.learner import Learner
from tests.training.runs import WORDS, same, state

COMMAND = [*WORDS, "model=symo", "trainer.compile=false"]


class Requeued(BaseException):
    """The launcher has ended the process."""


@pytest.fixture(autouse=True)
def _signals():
    kept = {signum: signal.getsignal(signum) for signum in (*stopping.SIGNALS, signal.SIGUSR2)}
    yield
    for signum, handler in kept.items():
        signal.signal(signum, handler)


def tell_in_epoch(epoch, monkeypatch):
    """Send the signal in the middle of an epoch."""
    step = Learner.training_step

    def told(model, batches, index):
        if model.current_epoch == epoch:
            os.kill(os.getpid(), signal.SIGUSR2)
        return step(model, batches, index)

    monkeypatch.setattr(Learner, "training_step", told)


def left(folder):
    (run,) = folder.glob("outputs/default/*")
    return run, json.loads((run / "outcome.json").read_text())


def test_a_job_saves_before_the_launcher_ends_it(workplace, monkeypatch):
    saved = []

    def launchers(signum, frame):
        saved.append(state(left(workplace)[0])["state_dict"])
        raise Requeued

    signal.signal(signal.SIGUSR2, launchers)
    with monkeypatch.context() as patch:
        tell_in_epoch(2, patch)
        with pytest.raises(Requeued):
            main(COMMAND)
    assert len(saved) == 1
    assert left(workplace)[1]["status"] == "waiting"
    assert main(COMMAND) == 0
    cut = state(left(workplace)[0])
    signal.signal(signal.SIGUSR2, signal.SIG_DFL)
    assert main([*COMMAND, "resume=false"]) == 0
    assert signal.getsignal(signal.SIGUSR2) is signal.SIG_DFL  # where no launcher listens
    assert same(cut, state(left(workplace)[0]))


def test_a_job_that_cannot_be_queued_again_reports_the_reason(workplace, monkeypatch, capsys):
    def launchers(signum, frame):
        raise RuntimeError("timed out too many times")

    signal.signal(signal.SIGUSR2, launchers)
    tell_in_epoch(2, monkeypatch)
    assert main(COMMAND) == 128 + signal.SIGUSR2
    assert "timed out too many times" in capsys.readouterr().err
    assert left(workplace)[1]["status"] == "interrupted"
