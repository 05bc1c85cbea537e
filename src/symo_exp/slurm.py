"""What SLURM is asked, by its commands: which jobs are in its queue, and to stop some."""

from __future__ import annotations

import getpass
import os
import subprocess


def own_job() -> str:
    """The user and the job of SLURM that this process works for; empty elsewhere."""
    array, number = os.environ.get("SLURM_ARRAY_JOB_ID"), os.environ.get("SLURM_ARRAY_TASK_ID")
    job = f"{array}_{number}" if array else os.environ.get("SLURM_JOB_ID")
    return f"{getpass.getuser()}/{job}" if job else ""


def has_left(job: str) -> bool:
    """Whether a job, as ``own_job`` named it, neither runs nor waits to. False if unknown."""
    user, _, number = job.partition("/")
    return user == getpass.getuser() and is_over(number)


def is_over(number: str) -> bool:
    """Whether a job of this user, or every job of an array, has left the queue. False if SLURM
    does not say. (Its accounting would know more, but not every cluster has one.)"""
    queue = _ask("squeue", "--me", "--noheader", "--array", "--format=%i")
    if queue is None:
        return False
    return not any(job == number or job.startswith(f"{number}_") for job in queue.split())


def stop(array: str) -> None:
    """Have the jobs of an array that run finish their epoch, and the others not begin."""
    _ask("scancel", "--state=PENDING", array)
    _ask("scancel", "--state=RUNNING", "--signal=TERM", array)


def cancel(array: str) -> None:
    """Take all jobs of an array out of the queue now."""
    _ask("scancel", array)


def _ask(*words: str) -> str | None:
    try:
        done = subprocess.run(words, check=True, capture_output=True, text=True, timeout=60.0)
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout
