"""The jobs of one command in SLURM's queue."""

from __future__ import annotations

import logging
import shutil
import subprocess
import threading
import time
import uuid
from collections.abc import Callable

from omegaconf import DictConfig, OmegaConf

from symo_exp.errors import ConfigError

SECONDS = 5.0
"""Between two looks at the queue, which others want to look at, too."""
UNKNOWN = "unknown"
"""The answer of a command that fails."""


class Queue:
    """The jobs of a command, which share a name that no other command's jobs have."""

    def __init__(self, name: str) -> None:
        self.name = name

    @classmethod
    def of(cls, master: DictConfig) -> Queue | None:
        """Return the queue if the launcher uses SLURM."""
        launcher = master.hydra.launcher
        if not str(launcher._target_).endswith(".SlurmLauncher"):
            return None
        missing = "" if shutil.which("sbatch") else "there is no SLURM here (no command sbatch)"
        if not missing and _ask("squeue", "--me", "--noheader") == UNKNOWN:
            missing = "SLURM does not answer here (squeue --me fails)"
        if missing:
            choice = master.hydra.runtime.choices["hydra/launcher"]
            raise ConfigError(f"hydra/launcher={choice}: {missing}")
        OmegaConf.update(master, "hydra.launcher.name", f"symo_exp-{uuid.uuid4().hex[:8]}")
        return cls(launcher.name)

    def run(self, launch: Callable[[], object]) -> None:
        """Launch jobs and return when none of them runs or waits.

        The launcher learns from SLURM's accounting that a job was killed, and waits forever
        without accounting; it is left in a thread of its own when the queue is empty.
        """
        launcher = threading.Thread(target=launch, daemon=True)
        launcher.start()
        seen = False
        while launcher.is_alive() and not (seen and not self._listed()):
            seen = seen or self._listed()
            logging.getLogger("submitit").setLevel(logging.ERROR)  # of accounting that is not there
            launcher.join(SECONDS if seen else 1.0)
        while self._listed():
            time.sleep(SECONDS)

    def _listed(self) -> bool:
        return bool(_ask("squeue", "--me", "--noheader", "--format=%i", f"--name={self.name}"))

    def stop(self) -> None:
        """Ask running jobs to finish their epoch and remove waiting ones."""
        _ask("scancel", "--state=PENDING", f"--name={self.name}")
        _ask("scancel", "--state=RUNNING", "--signal=TERM", f"--name={self.name}")

    def cancel(self) -> None:
        """Remove all jobs from the queue now."""
        _ask("scancel", f"--name={self.name}")


def _ask(*words: str) -> str:
    """Return the output of a command of SLURM, ``UNKNOWN`` if it fails."""
    try:
        done = subprocess.run(words, check=True, capture_output=True, text=True, timeout=60.0)
    except (OSError, subprocess.SubprocessError):
        return UNKNOWN
    return done.stdout.strip()
