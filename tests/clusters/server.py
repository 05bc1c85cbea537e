"""PostgreSQL with an MLflow server before it, set up for a test as docs/clusters.md describes."""

from __future__ import annotations

import os
import pwd
import secrets
import shutil
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

USER = "postgres"
"""Who runs PostgreSQL when root starts it: root itself may not."""
SECONDS = 300.0
"""A fresh database takes MLflow some time, and so does a start while eight jobs use the cores."""


class UnavailableError(RuntimeError):
    """There can be no such server here."""


class Server:
    """The two processes, from ``start`` to ``stop``."""

    def __init__(self, folder: Path, *, host: str, port: int, workers: int) -> None:
        self.folder = folder.absolute()
        self.host, self.port, self.workers = host, port, workers
        self._processes: list[subprocess.Popen[bytes]] = []

    @property
    def address(self) -> str:
        return f"http://{self.host}:{self.port}"

    def start(self) -> None:
        """Come back when runs can be logged."""
        programs = _programs()
        owner = _owner()
        data = self.folder / "postgres"
        data.mkdir(parents=True, exist_ok=True)
        if owner:
            os.chown(data, owner["user"], owner["group"])
        password = data / "password"
        if not (data / "data" / "PG_VERSION").exists():
            _write_secret(password, owner)
            subprocess.run(
                [programs / "initdb", f"--pgdata={data}/data", f"--pwfile={password}",
                 f"--username={USER}", "--auth=scram-sha-256", "--encoding=UTF8", "--no-locale"],
                check=True, stdout=subprocess.DEVNULL, cwd="/", **owner,
            )  # fmt: skip
        (inner,) = free_ports(1)
        settings = {"port": inner, "listen_addresses": "127.0.0.1", "unix_socket_directories": ""}
        flags = [word for key, value in settings.items() for word in ("-c", f"{key}={value}")]
        self._run("postgres", [programs / "postgres", "-D", data / "data", *flags], **owner)
        self._until(lambda: _listens(inner))
        env = {
            **os.environ,
            "MLFLOW_BACKEND_STORE_URI": f"postgresql+psycopg2://{USER}:{password.read_text().strip()}"
            f"@127.0.0.1:{inner}/{USER}",
            "MLFLOW_DISABLE_TELEMETRY": "true",
            "MLFLOW_SERVER_ENABLE_JOB_EXECUTION": "false",
        }
        self._run(
            "mlflow",
            [sys.executable, "-m", "mlflow", "server", "--host", self.host, "--port", self.port,
             "--workers", self.workers, "--artifacts-destination", self.folder / "artifacts"],
            env=env,
        )  # fmt: skip
        self._until(lambda: _is_well(self.address))

    def stop(self) -> None:
        """End both, MLflow first; what they were told is on disk."""
        for process in reversed(self._processes):
            # SIGINT has PostgreSQL end its connections, not wait for their ends
            _signal(process, signal.SIGINT)
            try:
                process.wait(20.0)
            except subprocess.TimeoutExpired:
                _signal(process, signal.SIGKILL)
                process.wait()
        self._processes.clear()

    def _run(self, name: str, words: Sequence[object], **options: Any) -> None:
        with (self.folder / f"{name}.log").open("ab") as log:
            # a session of its own: Ctrl-C in a terminal is for us to pass on
            process = subprocess.Popen(
                [*map(str, words)], start_new_session=True, stdin=subprocess.DEVNULL,
                stdout=log, stderr=log, cwd="/", **options,
            )  # fmt: skip
        self._processes.append(process)

    def _until(self, ready: Callable[[], bool]) -> None:
        end = time.monotonic() + SECONDS
        while not ready():
            dead = [p for p in self._processes if p.poll() is not None]
            if dead or time.monotonic() > end:
                self.stop()
                said = [file.read_text(errors="replace") for file in self.folder.glob("*.log")]
                raise UnavailableError("\n".join(["the server did not come up", *said]))
            time.sleep(0.2)


def _programs() -> Path:
    """Return the folder of PostgreSQL, which Debian keeps off the PATH."""
    found = shutil.which("initdb")
    places = sorted(Path("/usr/lib/postgresql").glob("*/bin"), key=lambda p: int(p.parent.name))
    if found is None and not places:
        raise UnavailableError("PostgreSQL is not installed: apt-get install postgresql")
    return places[-1] if places else Path(found or "").parent


def _owner() -> dict[str, Any]:
    """For ``subprocess``: the user and the group of PostgreSQL, if they are not ours."""
    if os.getuid() != 0:
        return {}
    try:
        user = pwd.getpwnam(USER)
    except KeyError:
        raise UnavailableError(f"root cannot run PostgreSQL, and there is no user {USER}") from None
    return {"user": user.pw_uid, "group": user.pw_gid, "extra_groups": []}


def _write_secret(path: Path, owner: dict[str, Any]) -> None:
    path.touch(mode=0o600)
    path.write_text(secrets.token_hex(16) + "\n")
    if owner:
        os.chown(path, owner["user"], owner["group"])


def _signal(process: subprocess.Popen[bytes], signum: int) -> None:
    if process.poll() is None:
        process.send_signal(signum)


def free_ports(count: int) -> list[int]:
    """Return different ports that nothing listens at."""
    with ExitStack() as probes:
        sockets = [probes.enter_context(socket.socket()) for _ in range(count)]
        for one in sockets:
            one.bind(("127.0.0.1", 0))
        return [int(one.getsockname()[1]) for one in sockets]


def _listens(port: int) -> bool:
    try:
        socket.create_connection(("127.0.0.1", port), 1.0).close()
    except OSError:
        return False
    return True


def _is_well(address: str) -> bool:
    try:
        urllib.request.urlopen(f"{address}/health", timeout=2.0).close()
    except (OSError, urllib.error.URLError):
        return False
    return True
