"""A SLURM cluster of one node, this machine, with all that belongs to it in one folder."""

from __future__ import annotations

import getpass
import os
import shutil
import socket
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path

from tests.clusters.server import free_ports

PROGRAMS = ("munged", "slurmctld", "slurmd", "sbatch", "squeue", "scontrol", "scancel")
CPUS = 2

SETTINGS = """\
ClusterName=one
SlurmctldHost={host}(127.0.0.1)
SlurmctldPort={controller}
SlurmdPort={daemon}
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
CredType=cred/munge
AuthInfo=socket={folder}/munge.socket,cred_expire=5
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd.pid
SlurmctldLogFile={folder}/slurmctld.log
SlurmdLogFile={folder}/slurmd.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
MpiDefault=none
SchedulerType=sched/backfill
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
ReturnToService=2
KillWait=5
MinJobAge=86400
GresTypes=gpu
NodeName={host} NodeAddr=127.0.0.1 CPUs={cpus} RealMemory={memory} Gres=gpu:1
PartitionName=all Nodes={host} Default=YES MaxTime=INFINITE State=UP
"""


class Cluster:
    """``env`` leads SLURM's commands here."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.env = {"SLURM_CONF": str(folder / "slurm.conf")}

    def ask(self, *words: str) -> str:
        """Return the output of a command of SLURM."""
        env = {**os.environ, **self.env}
        return subprocess.run(words, env=env, check=True, capture_output=True, text=True).stdout

    def queue(self) -> list[str]:
        """The jobs that wait or run."""
        return self.ask("squeue", "--noheader", "--array", "--format=%i").split()

    def minutes(self, job: str) -> int:
        """Return the time for which a job has been running, rounded down."""
        start = self.ask("squeue", "--noheader", "--format=%S", f"--jobs={job}").strip()
        return int((datetime.now() - datetime.fromisoformat(start)).total_seconds() // 60)

    def limit(self, job: str, *, minutes: int) -> None:
        """Change how long a job may run, in all."""
        self.ask("scontrol", "update", f"JobId={job}", f"TimeLimit={minutes}")

    def restarts(self, job: str) -> int:
        """Return the number of times that a job was queued again."""
        return int(self.ask("scontrol", "show", "job", job).partition("Restarts=")[2].split()[0])

    def clear(self) -> None:
        """Cancel what waits or runs."""
        with suppress(subprocess.SubprocessError):
            self.ask("scancel", f"--user={getpass.getuser()}")
            end = time.monotonic() + 60.0
            while self.queue() and time.monotonic() < end:
                time.sleep(0.5)


def missing() -> str:
    """Return the reason why no cluster can be started here; empty if one can."""
    absent = [program for program in PROGRAMS if shutil.which(program) is None]
    if absent:
        return f"no {', '.join(absent)} here: apt-get install slurmctld slurmd slurm-client munge"
    return "" if os.getuid() == 0 else "only root can start slurmd"


@contextmanager
def cluster(folder: Path) -> Iterator[Cluster]:
    for name in ("state", "spool"):
        (folder / name).mkdir()
    host = socket.gethostname().partition(".")[0]
    controller, daemon = free_ports(2)
    memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") // 2**20
    settings = SETTINGS.format(
        folder=folder, host=host, controller=controller, daemon=daemon, cpus=CPUS, memory=memory
    )
    (folder / "slurm.conf").write_text(settings)
    (folder / "gres.conf").write_text(f"NodeName={host} Name=gpu File=/dev/null\n")
    (folder / "cgroup.conf").write_text("CgroupAutomount=no\n")
    key = folder / "munge.key"
    key.write_bytes(os.urandom(128))
    key.chmod(0o600)
    munge = [
        f"--socket={folder}/munge.socket", f"--key-file={key}", f"--pid-file={folder}/munge.pid",
        f"--log-file={folder}/munge.log", f"--seed-file={folder}/munge.seed",
    ]  # fmt: skip
    there = Cluster(folder)
    daemons = []
    try:
        for words in (
            ["munged", "--foreground", "--force", *munge],
            ["slurmctld", "-D", "-i"],
            ["slurmd", "-D", "-N", host],
        ):
            daemons.append(_start(words, there))
            if words[0] == "munged":
                _until(lambda: (folder / "munge.socket").exists(), daemons, folder)
        _until(lambda: "idle" in there.ask("sinfo", "--noheader", "--format=%T"), daemons, folder)
        yield there
    finally:
        there.clear()  # slurmd leaves alone what runs
        for process in reversed(daemons):
            process.terminate()
        for process in reversed(daemons):
            try:
                process.wait(20)
            except subprocess.TimeoutExpired:
                process.kill()


def _start(words: list[str], there: Cluster) -> subprocess.Popen[bytes]:
    output = (there.folder / f"{words[0]}.out").open("wb")
    env = {**os.environ, **there.env}
    return subprocess.Popen(words, env=env, stdout=output, stderr=output, stdin=subprocess.DEVNULL)


def _until(ready, daemons, folder, timeout=60.0) -> None:
    end = time.monotonic() + timeout
    while True:
        try:
            if ready():
                return
        except subprocess.CalledProcessError:
            pass  # not yet
        dead = [p.args[0] for p in daemons if p.poll() is not None]
        if dead or time.monotonic() > end:
            said = "\n".join(f"{f.name}: {f.read_text()}" for f in folder.glob("*.out"))
            raise RuntimeError(f"{dead or 'SLURM'} did not come up:\n{said}")
        time.sleep(0.2)
