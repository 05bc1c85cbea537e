"""Handing jobs to Hydra and its launchers, again where a launcher broke."""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import BrokenExecutor
from contextlib import contextmanager, nullcontext
from typing import Any
from unittest import mock

import hydra
from hydra._internal.core_plugins import basic_sweeper
from hydra.errors import HydraException
from omegaconf.errors import OmegaConfBaseException

from symo_exp.configuration import CONF
from symo_exp.configuration.command import Job, one_line
from symo_exp.errors import ConfigError
from symo_exp.job import debugging, job
from symo_exp.submitted import waiting_for_all
from symo_exp.training import stopping
from symo_exp.training.outcome import Outcome

log = logging.getLogger(__name__)


def launch(argv: Sequence[str], jobs: Sequence[Job], *, multirun: bool) -> None:
    """Have the jobs done, each in whichever process.

    When a process of joblib is killed, its neighbours are killed with it and the rest is not
    started. So the rest is started then, and after it those that died, each alone: whose process
    is killed a second time has no one else to blame.
    """
    alone: list[Job] = []
    todo = list(jobs)
    while todo:
        whole = _attempt(argv, todo, multirun)
        if whole or stopping.requested():
            break
        left = [(job, Outcome.read(job.folder).status) for job in todo]
        died = [job for job, status in left if status == "running"]
        waiting = [job for job, status in left if status == "waiting"]
        if len(waiting) == len(todo):
            break  # nothing has happened: nor will it
        log.error("a worker was killed: %d jobs are started again", len(died) + len(waiting))
        alone += died
        todo = waiting
    for one in alone:
        if not stopping.requested():
            _attempt(argv, [one], multirun)


def _attempt(argv: Sequence[str], jobs: Sequence[Job], multirun: bool) -> bool:
    """Whether the launcher worked to its end, well or not; else a process of it was killed."""
    try:
        with _only(jobs) if multirun else nullcontext(), waiting_for_all():
            compose_and_run(argv)
    except BrokenExecutor:
        if debugging():
            raise
        return False
    except Exception as error:  # what it finished still counts
        if debugging() or not multirun:
            raise
        log.error("the launcher stopped: %s", one_line(error))
    return True


@contextmanager
def _only(jobs: Sequence[Job]) -> Iterator[None]:
    """Have Hydra's own sweeper launch these jobs, which are known to be sound, and no others."""
    overrides = [job.overrides for job in jobs]
    sweeper = basic_sweeper.BasicSweeper  # looked up here: Hydra makes the class anew

    def split_arguments(given: Any, size: int | None) -> list[Any]:
        return [*sweeper.split_overrides_to_chunks(overrides, size)]

    with (
        mock.patch.object(sweeper, "split_arguments", staticmethod(split_arguments)),
        mock.patch.object(sweeper, "validate_batch_is_legal"),
    ):
        yield


def compose_and_run(argv: Sequence[str]) -> None:
    """Compose again and run, by Hydra's launcher or sweeper."""
    entry = hydra.main(version_base="1.3", config_path=str(CONF), config_name="config")(job)
    with (
        mock.patch.object(sys, "argv", [sys.argv[0], *argv]),
        # errors come here instead of being printed
        mock.patch.dict(os.environ, HYDRA_FULL_ERROR="1"),
    ):
        try:
            entry()
        except (HydraException, OmegaConfBaseException) as error:
            raise ConfigError(one_line(error)) from error
