"""The jobs of a command, composed and checked but not run."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any, NamedTuple
from unittest import mock

from hydra.core.global_hydra import GlobalHydra
from omegaconf import OmegaConf

from symo_exp.cli.command import Command
from symo_exp.cli.explain import BAD_INPUT, explained
from symo_exp.errors import ConfigError
from symo_exp.sweep.compose import Job
from symo_exp.sweep.sweeper import Sweep


class Kept(NamedTuple):
    """A sweep as Hydra made it, and what the command line adds to."""

    sweep: Sweep
    params: Mapping[str, Any]
    hydra: Any


_kept: dict[tuple[object, ...], Kept] = {}
"""By all that is Hydra's in a command: commands that differ in settings share what it composed."""


def jobs_of(*words: str) -> list[Job]:
    """The jobs of ``python -m symo_exp`` with these words; ``ConfigError`` for a bad one."""
    with planned(*words) as (_, jobs):
        return jobs


def job_of(*words: str) -> Job:
    """The only one."""
    (job,) = jobs_of(*words)
    return job


def settings_of(*words: str) -> list[Any]:
    """The resolved settings of each job, as attributes."""
    return [OmegaConf.create(job.values) for job in jobs_of(*words)]


def params_of(sweep: str) -> dict[str, Any]:
    """What a sweep varies, by its file and those that it changes."""
    return dict(_kept_of(Command(["-cn", sweep])).params)


def refusal(*words: str) -> str:
    """Return the error of a command that must not start."""
    try:
        with planned(*words) as (sweep, jobs):
            sweep.check(jobs)
    except ConfigError as error:
        return str(error)
    raise AssertionError(f"{words} are accepted")


@contextmanager
def planned(*words: str) -> Iterator[tuple[Sweep, list[Job]]]:
    """The sweep of a command and its jobs, while Hydra is there to compose more."""
    command = Command(words)
    hydras = [word for word in command.overrides if word.lstrip("+~").startswith("hydra")]
    settings = [word for word in command.overrides if word not in hydras]
    options = [word for word in command.options if word not in ("-m", "--multirun")]
    try:
        sweep, params, hydra = _kept_of(Command([*options, *hydras]))
        GlobalHydra.instance().initialize(hydra)
        yield sweep, sweep.plan(settings, params)
    except BAD_INPUT as error:
        GlobalHydra.instance().clear()
        raise explained(error) from error
    finally:
        GlobalHydra.instance().clear()


def _kept_of(command: Command) -> Kept:
    key = (*command.options, *command.folders, *command.overrides)
    if key not in _kept:
        _kept[key] = _compose(command)
    return _kept[key]


def _compose(command: Command) -> Kept:
    found: list[Kept] = []

    def keep(sweep, arguments, params, **_):
        found.append(Kept(sweep, params, GlobalHydra.instance().hydra))
        return 0

    root = logging.getLogger()
    logs = mock.patch.multiple(root, handlers=[*root.handlers], level=root.level)
    with mock.patch.object(Sweep, "run", keep), logs:  # Hydra sets up logs of its own
        command.execute()
    return found[0]
