"""What was asked of a run, and how far it has come."""

from __future__ import annotations

import os
import socket
import time
import uuid
from dataclasses import dataclass, field
from typing import Any, Literal

Status = Literal["waiting", "running", "finished", "failed", "refused", "interrupted"]


@dataclass(frozen=True)
class Outcome:
    """How far a run has come; one that ended otherwise than ``finished`` says why.

    ``process`` names who works on it, for a person to look for: that it lives, only the lock says.
    """

    status: Status
    reason: str = ""
    seconds: float = 0.0
    process: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class About:
    """What was asked for. ``parameters`` are flat; ``variant`` says in which of them the run
    differs from the files that ship, beyond what tables have columns for; ``sweep`` is the identity
    of the sweep that it was part of first."""

    name: str
    parameters: dict[str, Any]
    variant: str = ""
    sweep: str = ""
    tags: dict[str, str] = field(default_factory=dict)
    started: float = field(default_factory=time.time)
    identity: str = field(default_factory=lambda: uuid.uuid4().hex)


def this_process() -> dict[str, str]:
    """Names of this process, by which a person finds it."""
    array, number = os.environ.get("SLURM_ARRAY_JOB_ID"), os.environ.get("SLURM_ARRAY_TASK_ID")
    job = f"{array}_{number}" if array else os.environ.get("SLURM_JOB_ID", "")
    named = {"host": socket.gethostname(), "pid": str(os.getpid())}
    return named | ({"slurm_job": job} if job else {})
