"""Description and status of a run."""

from __future__ import annotations

import ast
import os
import socket
import time
import uuid
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

Status = Literal["waiting", "running", "finished", "failed", "refused", "interrupted"]


@dataclass(frozen=True)
class Outcome:
    """The status of a run; one that did not finish has a reason.

    ``seconds`` are those of all starts of the run together, except those that were killed.
    ``process`` names the process for a person to find; only the lock says whether it lives.
    """

    status: Status
    reason: str = ""
    seconds: float = 0.0
    process: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class About:
    """The description of a run.

    ``parameters`` are flat. ``variant`` names the settings that differ from the files that ship,
    beyond those with columns in tables. ``sweep`` is the identity of the first sweep of the run.
    ``recordings`` is a digest of their content, nothing without any. ``code`` has the digests of
    the user's modules, by their files below the folder ``code=FOLDER``.
    """

    name: str
    parameters: dict[str, Any]
    variant: str = ""
    sweep: str = ""
    tags: dict[str, str] = field(default_factory=dict)
    recordings: str = ""
    code: dict[str, str] = field(default_factory=dict)
    started: float = field(default_factory=time.time)
    identity: str = field(default_factory=lambda: uuid.uuid4().hex)


def recording_names(path: object) -> str:
    """Return the names of the files of recordings.

    Args:
        path: The parameter ``data.path`` of a run, or its text: a path or a list of them.
    """
    try:
        found = ast.literal_eval(str(path))
    except (SyntaxError, ValueError):
        found = None
    every = found if isinstance(found, list) else [str(path)]
    return ", ".join(Path(one).name or one for one in every)  # "." has no name


def this_process() -> dict[str, str]:
    """Return names by which a person finds this process."""
    array, number = os.environ.get("SLURM_ARRAY_JOB_ID"), os.environ.get("SLURM_ARRAY_TASK_ID")
    job = f"{array}_{number}" if array else os.environ.get("SLURM_JOB_ID", "")
    named = {"host": socket.gethostname(), "pid": str(os.getpid())}
    return named | ({"slurm_job": job} if job else {})
