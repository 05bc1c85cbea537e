"""Launching jobs, and again those whose processes were killed."""

from __future__ import annotations

import copy
import logging
import os
import time
from collections.abc import Sequence
from contextlib import ExitStack

from hydra.core.plugins import Plugins
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig, open_dict

from symo_exp.errors import debugging, one_line
from symo_exp.job.job import SWEEP, VARIED, end
from symo_exp.process import stopping
from symo_exp.runs.folder import DIED
from symo_exp.shell import override_value
from symo_exp.sweep import slurm
from symo_exp.sweep.compose import Job
from symo_exp.words import counted

log = logging.getLogger(__name__)


class Launches:
    """Has jobs done by Hydra's launcher.

    Args:
        context: How Hydra composes configurations.
        task: The function that does a job.
        master: The configuration of the command.

    Attributes:
        cluster: The queue of a cluster, if jobs are done by one.
        apart: Whether jobs are done in other processes.
    """

    def __init__(self, context: HydraContext, task: TaskFunction, master: DictConfig) -> None:
        self._context, self._task, self._master = context, task, master
        self.cluster = slurm.Queue.of(master)
        self.apart = "basic_launcher" not in master.hydra.launcher._target_
        self._stopped = ""  # why the launcher stopped

    def run(self, jobs: Sequence[Job]) -> list[Job]:
        """Launch jobs, and launch again those that a broken launcher left.

        When a process of joblib is killed, its neighbours are killed too and the rest is not
        started. The rest is started again, then those that died, each alone: a job whose process
        is killed twice has failed.

        Returns:
            The jobs whose processes were killed, which is recorded as their outcome.
        """
        for job in self._start_all(jobs):
            if stopping.requested() is None:
                self._launch([job])
        died = [job for job in jobs if job.folder.died()]
        for job in died:
            if stopping.requested() is None:
                end(job.folder, None, "failed", DIED)
            else:
                end(job.folder, None, "interrupted", "its process was ended")
        return died

    def _start_all(self, jobs: Sequence[Job]) -> list[Job]:
        """Launch jobs until each was started once; return those whose processes were killed."""
        died: list[Job] = []
        todo = list(jobs)
        while todo and stopping.requested() is None:
            self._launch(todo)
            killed = [job for job in todo if job.folder.died()]
            died += killed
            waiting = [job for job in todo if job.folder.outcome().status == "waiting"]
            if len(waiting) == len(todo):
                if self._stopped and stopping.requested() is None:
                    log.error("no run was started: %s", self._stopped)
                break
            if killed and stopping.requested() is None:
                again = counted(len(died + waiting), "run")
                log.error("a worker was killed: the command starts %s again", again)
            todo = waiting
        return died

    def _launch(self, jobs: Sequence[Job]) -> None:
        """Launch jobs and wait for those that the launcher left running."""
        launcher = Plugins.instance().instantiate_launcher(
            hydra_context=self._context, task_function=self._task, config=self._for_jobs()
        )
        here = self.apart and self.cluster is None

        def launch() -> None:
            try:
                with stopping.deaf_children() if here else ExitStack():
                    launcher.launch([job.overrides for job in jobs], initial_job_idx=0)
            except Exception as error:  # what it finished still counts
                if debugging():
                    raise
                log.debug("the launcher stopped", exc_info=True)
                self._stopped = one_line(error)

        try:
            if self.cluster:
                self.cluster.run(launch)
            else:
                launch()
            for job in jobs:
                while job.folder.in_use():
                    time.sleep(0.2)
        except stopping.Interrupted:  # the second signal
            if self.cluster:
                self.cluster.cancel()
            raise

    def _for_jobs(self) -> DictConfig:
        """Return the configuration with the environment that this command has for its jobs.

        joblib reuses its workers, which have the environment of the command that started them.
        """
        config = copy.deepcopy(self._master)
        with open_dict(config):
            for name in (stopping.FOLDER, SWEEP, VARIED):
                value = override_value(os.environ.get(name, ""), nested=True)
                config.hydra.overrides.hydra.append(f"++hydra.job.env_set.{name}={value}")
        return config
