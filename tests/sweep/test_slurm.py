"""Requests to SLURM, and machines without it."""

import subprocess
import threading

import pytest
from hydra.errors import MissingConfigException
from omegaconf import OmegaConf

from symo_exp.cli.explain import explained
from symo_exp.errors import ConfigError
from symo_exp.sweep import slurm
from tests.jobs import jobs_of

SLURM = {"_target_": "hydra_plugins.hydra_submitit_launcher.submitit_launcher.SlurmLauncher"}


@pytest.fixture
def asked(monkeypatch):
    """The requests to a queue that answers with two jobs, with one, with none."""
    words, answers = [], ["7_0\n7_1\n", "7_1\n", ""]

    def run(command, **_):
        if command == ("squeue", "--me", "--noheader"):  # before anything is queued
            return subprocess.CompletedProcess(command, 0, "", "")
        words.append(command)
        return subprocess.CompletedProcess(command, 0, answers.pop(0) if answers else "", "")

    monkeypatch.setattr(slurm.subprocess, "run", run)
    monkeypatch.setattr(slurm, "SECONDS", 0.01)
    monkeypatch.setattr(slurm.shutil, "which", lambda _: "/usr/bin/sbatch")
    return words


def queue():
    launcher = {**SLURM, "name": "symo_exp"}
    choices = {"choices": {"hydra/launcher": "submitit_slurm"}}
    return slurm.Queue.of(OmegaConf.create({"hydra": {"launcher": launcher, "runtime": choices}}))


def test_the_jobs_of_a_command_are_told_apart_by_name(asked):
    one, other = queue(), queue()
    assert one.name != other.name
    one.run(lambda: None)
    assert len(asked) == 3
    one.stop()
    one.cancel()
    assert all(f"--name={one.name}" in words for words in asked)
    assert [words[0] for words in asked[3:]] == ["scancel"] * 3


def test_a_queue_that_does_not_answer_at_first_is_refused(asked, monkeypatch):
    """Jobs could not be submitted, and the command would wait for the queue for ever."""

    def fails(*_, **__):
        raise subprocess.CalledProcessError(1, "squeue")

    monkeypatch.setattr(slurm.subprocess, "run", fails)
    with pytest.raises(ConfigError, match="launcher=submitit_slurm: SLURM does not answer"):
        queue()


def test_a_queue_that_does_not_answer_is_asked_again(asked, monkeypatch):
    one = queue()
    failures = [OSError(), subprocess.TimeoutExpired("squeue", 60)]
    run = slurm.subprocess.run

    def unsure(command, **options):
        if failures:
            raise failures.pop()
        return run(command, **options)

    monkeypatch.setattr(slurm.subprocess, "run", unsure)
    one.run(lambda: None)
    assert not failures
    assert len(asked) == 3


def test_a_launcher_that_waits_for_ever_is_not_waited_for(asked):
    never = threading.Event()
    queue().run(never.wait)
    assert len(asked) >= 3
    never.set()


def test_other_launchers_have_no_queue():
    assert (
        slurm.Queue.of(OmegaConf.create({"hydra": {"launcher": {"_target_": "x.Local"}}})) is None
    )


def test_a_cluster_that_is_not_there_is_refused(monkeypatch):
    pytest.importorskip("hydra_plugins.hydra_submitit_launcher")
    monkeypatch.setenv("PATH", "")
    with pytest.raises(ConfigError, match="no SLURM here"):
        jobs_of("seed=0", "hydra/launcher=submitit_slurm_cpu")


@pytest.mark.parametrize("choice", ["submitit_slurm_cpu", "submitit_local"])
def test_an_extra_that_is_not_installed_is_named(choice):
    missing = MissingConfigException("", f"hydra/launcher/{choice}", ["basic", "joblib"])
    assert "pip install 'symo_exp[cluster]'" in str(explained(missing))
