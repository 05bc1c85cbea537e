"""Signals that workers hear."""

import os
import signal

import pytest

from symo_exp.process import stopping


@pytest.mark.parametrize("same", [True, False])
def test_a_worker_forgets_the_signal_of_a_command_when_another_one_uses_it(
    same, tmp_path, monkeypatch
):
    with stopping.command(), monkeypatch.context() as patch:
        os.kill(os.getpid(), signal.SIGINT)
        if not same:
            patch.setenv(stopping.FOLDER, str(tmp_path))
        stopping.install()  # as a job does that begins
        assert stopping.requested() == (signal.SIGINT if same else None)
