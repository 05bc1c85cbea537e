"""What a command would do, composed and checked, and nothing of it run."""

import logging
from unittest import mock

from symo_exp.sweep.command import Command
from symo_exp.sweep.compose import Job
from symo_exp.sweep.explain import explained
from symo_exp.sweep.sweeper import Sweep


def jobs_of(*words: str) -> list[Job]:
    """The jobs of ``python -m symo_exp`` with these words; ``ConfigError`` for a bad one."""
    found: list[Job] = []

    def keep(sweep, arguments, params, **_):
        found.extend(sweep._plan(arguments, params))
        return 0

    command = Command(words)
    root = logging.getLogger()
    logs = mock.patch.multiple(root, handlers=[*root.handlers], level=root.level)
    with mock.patch.object(Sweep, "run", keep), logs:  # Hydra sets up logs of its own
        try:
            command.execute()
        except Exception as error:
            raise explained(error, command) from error
    return found


def job_of(*words: str) -> Job:
    """The only one."""
    (job,) = jobs_of(*words)
    return job
