"""What is asked of SLURM, and what its answers are taken for."""

import getpass
import subprocess

import pytest
from hydra._internal.config_loader_impl import ConfigLoaderImpl

from symo_exp import slurm
from symo_exp.configuration.command import jobs_of, parse
from symo_exp.errors import ConfigError
from symo_exp.tracking.process import HOST, SLURM_JOB, identity, is_dead


@pytest.fixture
def queue(monkeypatch):
    """Jobs in the queue; ``None`` for a SLURM that does not answer."""
    jobs = ["7", "12_0", "12_3"]

    def run(words, **options):
        if not jobs:
            raise subprocess.CalledProcessError(1, words)
        return subprocess.CompletedProcess(words, 0, "\n".join(jobs) + "\n", "")

    monkeypatch.setattr(slurm.subprocess, "run", run)
    return jobs


@pytest.mark.parametrize(
    ("number", "over"),
    [("7", False), ("12", False), ("12_3", False), ("12_1", True), ("1", True), ("2", True)],
)
def test_what_has_left_the_queue_is_over(number, over, queue):
    assert slurm.is_over(number) is over


def test_what_is_not_known_is_not_over(queue):
    queue.clear()
    assert not slurm.is_over("1")
    assert not slurm.has_left(f"{getpass.getuser()}/1")


def test_the_job_of_a_process(monkeypatch):
    monkeypatch.delenv("SLURM_JOB_ID", raising=False)
    assert SLURM_JOB not in identity()
    monkeypatch.setenv("SLURM_JOB_ID", "7")
    assert identity()[SLURM_JOB] == f"{getpass.getuser()}/7"
    monkeypatch.setenv("SLURM_ARRAY_JOB_ID", "12")
    monkeypatch.setenv("SLURM_ARRAY_TASK_ID", "3")
    assert identity()[SLURM_JOB] == f"{getpass.getuser()}/12_3"


def test_a_process_on_another_node_is_dead_when_its_job_is_over(queue):
    user = getpass.getuser()
    elsewhere = identity() | {HOST: "elsewhere"}
    assert not is_dead(elsewhere)
    assert not is_dead(elsewhere | {SLURM_JOB: f"{user}/12_3"})
    assert is_dead(elsewhere | {SLURM_JOB: f"{user}/12_1"})
    assert not is_dead(elsewhere | {SLURM_JOB: "somebody/12_1"})


@pytest.mark.parametrize(
    ("installed", "says"),
    [(True, "no SLURM here"), (False, r"pip install 'symo_exp\[cluster\]'")],
)
def test_a_cluster_that_is_not_there_is_refused(installed, says, workplace, monkeypatch):
    if installed:
        pytest.importorskip("hydra_plugins.hydra_submitit_launcher")
    else:
        options = ConfigLoaderImpl.get_group_options

        def without(loader, group, *args, **kwargs):
            return [name for name in options(loader, group) if name != "submitit_slurm"]

        monkeypatch.setattr(ConfigLoaderImpl, "get_group_options", without)
    monkeypatch.setenv("PATH", "")
    with pytest.raises(ConfigError, match=says):
        jobs_of(parse(["-m", "seed=0", "hydra/launcher=submitit_slurm_cpu"]))
