"""Which process a run belongs to, and whether that process still lives.

A process that is killed leaves its run RUNNING for ever. The run's tags name the process, so that
the next start can tell. A process id alone would not do: ids are used again. On a cluster the
process may live on another machine: there the queue is asked.
"""

from __future__ import annotations

import os
import socket
from pathlib import Path

from symo_exp import slurm

HOST, PID, STARTED = "symo_exp.host", "symo_exp.pid", "symo_exp.process_started"
SLURM_JOB = "symo_exp.slurm_job"


def identity(pid: int | None = None) -> dict[str, str]:
    """Tags that name a process (this one by default) on this machine."""
    pid = os.getpid() if pid is None else pid
    tags = {HOST: socket.gethostname(), PID: str(pid), STARTED: _started(pid)}
    job = slurm.own_job()
    return tags | ({SLURM_JOB: job} if job else {})


def is_dead(tags: dict[str, str]) -> bool:
    """Whether the process named by ``tags`` is known to have ended.

    False where it cannot be known: another machine outside of SLURM, another container, no tags.
    """
    if tags.get(HOST) != socket.gethostname() and SLURM_JOB in tags:
        return slurm.has_left(tags[SLURM_JOB])
    if tags.get(HOST) != socket.gethostname() or not tags.get(PID, "").isdigit():
        return False
    pid, started = int(tags[PID]), tags.get(STARTED, "")
    if started == "":
        return not _exists(pid)
    boot, namespace, _ = started.split("/")
    if boot != _boot():
        return True  # the machine has been started anew since
    return namespace == _namespace() and started != _started(pid)


def _started(pid: int) -> str:
    """Boot of the machine, process namespace and start in clock ticks since boot; Linux only."""
    try:
        # the name in brackets may hold spaces and brackets; the start is field 22
        ticks = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[19]
        return f"{_boot()}/{_namespace()}/{ticks}"
    except (OSError, IndexError):
        return ""


def _boot() -> str:
    return Path("/proc/sys/kernel/random/boot_id").read_text().strip()


def _namespace() -> str:
    return os.readlink("/proc/self/ns/pid")


def _exists(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True
