"""Jobs that submitit has started, waited for until the last of them has ended."""

from __future__ import annotations

import logging
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any
from unittest import mock

from hydra.core.utils import JobReturn, JobStatus

from symo_exp import slurm
from symo_exp.training import stopping

log = logging.getLogger(__name__)

SECONDS = 5.0
"""Between two looks at the queue of a cluster, which others want to look at, too."""


@contextmanager
def waiting_for_all() -> Iterator[None]:
    """Have submitit's launchers come back when every job has ended; how, is in its folder.

    Left to itself submitit raises what it finds wrong with the first, while others still run;
    and it learns from SLURM's accounting, if there is one, that a job was killed.
    """
    try:
        import submitit
        from submitit.local import local
    except ImportError:
        yield
        return
    over: set[str] = set()

    def results(job: Any) -> list[JobReturn]:
        if isinstance(job, submitit.SlurmJob):
            array = job.job_id.partition("_")[0]
            if array not in over:
                _wait_for_array(array)
                over.add(array)
        else:
            while not job.done():
                time.sleep(0.1)
        if not job.paths.result_pickle.exists() and not stopping.requested():
            log.error("job %s ended without a word: see %s", job.job_id, job.paths.stderr)
        return [JobReturn(status=JobStatus.COMPLETED)]

    with (
        mock.patch.object(submitit.Job, "results", results),
        mock.patch.object(local, "start_controller", _deaf(local.start_controller)),
    ):
        yield


def _deaf(start: Callable[..., Any]) -> Callable[..., Any]:
    """What it starts does not hear Ctrl-C, upon which submitit gives its job a second to end."""

    def started(*args: Any, **kwargs: Any) -> Any:
        before = signal.signal(signal.SIGINT, signal.SIG_IGN)
        try:
            return start(*args, **kwargs)
        finally:
            signal.signal(signal.SIGINT, before)

    return started


def _wait_for_array(array: str) -> None:
    told = False
    try:
        while not slurm.is_over(array):
            if stopping.requested() and not told:
                slurm.stop(array)
                told = True
            time.sleep(SECONDS)
    except stopping.Interrupted:  # the second signal
        slurm.cancel(array)
        raise
