"""The tracking store: an SQLite file by default, or any MLflow tracking URI.

MLflow creates a database, its tables and an experiment without a lock, so that processes starting
together on a new store fail ("table experiments already exists"). Here all of it happens under a
file lock beside the database.
"""

from __future__ import annotations

import functools
import http.client
import os
import socket
import sqlite3
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from filelock import FileLock, Timeout

from symo_exp.checks import path_text
from symo_exp.errors import ConfigError, first_line, without_passwords
from symo_exp.files import write_whole
from symo_exp.imports import first_import

if TYPE_CHECKING:
    from mlflow import MlflowClient

MEND = "correct logger.tracking_uri or MLFLOW_TRACKING_URI, or set neither for a local SQLite store"
NEW_STORE = (
    "logger.directory=NAME for a new store, to which the commands of finished runs upload them "
    "again"
)
PORTS = {"postgresql": 5432, "mysql": 3306, "mssql": 1433}
LOCK_SECONDS = 300.0
UNUSED = "0"
"""The experiment that MLflow makes with every store, and calls Default."""


class AwayError(ConfigError):
    """Raised when the store does not answer."""


def is_away(error: BaseException) -> bool:
    """Return whether an error says that the store does not work now."""
    if isinstance(error, AwayError | ConnectionError):
        return True
    status = getattr(error, "get_http_status_code", None)  # of an MlflowException
    return status is not None and status() >= 500


@dataclass(frozen=True)
class Store:
    """A tracking store; relative paths have been made absolute."""

    uri: str
    artifacts: str | None
    """Folder of the files of a new experiment; ``None``: the server chooses one."""
    database: Path | None
    """The file of an SQLite store."""

    def __str__(self) -> str:
        """Return the URI without a password."""
        return without_passwords(self.uri)

    def may_have(self, run_id: str) -> bool:
        """Return whether a run is there, without importing MLflow; true for servers.

        An SQLite file may have been deleted, and another one made in its place.
        """
        if self.database is None:
            return True
        try:
            with closing(sqlite3.connect(f"{self.database.as_uri()}?mode=ro", uri=True)) as there:
                found = there.execute("SELECT 1 FROM runs WHERE run_uuid = ?", (run_id,)).fetchone()
        except sqlite3.Error:  # no file, no tables, or none that can be read
            return False
        return found is not None

    @contextmanager
    def lock(self) -> Iterator[None]:
        """Lock an SQLite store while something is created in it."""
        if self.database is None:
            yield
            return
        self.database.parent.mkdir(parents=True, exist_ok=True)
        try:
            with FileLock(f"{self.database}.lock", timeout=LOCK_SECONDS):
                yield
        except Timeout:
            raise ConfigError(
                f"{self.database}.lock has been held for {LOCK_SECONDS:.0f} s by another process: "
                "wait for it or end it"
            ) from None


def find(tracking_uri: str | None, directory: str | Path) -> Store:
    """Return the store of the configuration, else of MLFLOW_TRACKING_URI, else SQLite."""
    if not isinstance(tracking_uri, str | None):
        wanted = "expected text, such as sqlite:///mlruns/mlflow.db"
        raise ConfigError(f"tracking_uri={tracking_uri!r}: {wanted}")
    directory = path_text("directory", directory, "the folder of an SQLite store")
    folder = Path(directory).expanduser().absolute()
    uri = tracking_uri or os.environ.get("MLFLOW_TRACKING_URI") or f"sqlite:///{folder}/mlflow.db"
    scheme = urlsplit(uri).scheme.partition("+")[0]
    if scheme == "sqlite":
        name = uri.partition("?")[0].partition(":///")[2]
        if not name:
            raise ConfigError(f"tracking URI {uri!r} names no file; give sqlite:///path/mlflow.db")
        database = Path(name).absolute()
        uri = uri.replace(f":///{name}", f":///{database}", 1)
        return Store(uri, str(database.parent / "artifacts"), database)
    if scheme in ("http", "https", "databricks") or uri == "databricks":
        return Store(uri.rstrip("/"), None, None)
    if scheme in PORTS and len(uri) > len(f"{urlsplit(uri).scheme}://"):
        return Store(uri, str(folder / "artifacts"), None)
    known = "sqlite:///, http://, https://, " + ", ".join(f"{name}://" for name in PORTS)
    raise ConfigError(f"tracking URI {uri!r} is not supported by MLflow ({known}): {MEND}")


def check(store: Store, timeout: float) -> None:
    """Refuse a store that cannot be reached or written, within ``timeout`` seconds.

    Costs no import of MLflow, so that every job can ask before anything starts.
    """
    parts = urlsplit(store.uri)
    port = PORTS.get(parts.scheme.partition("+")[0])
    if store.database is not None:
        _check_file(store.database)
    elif parts.scheme in ("http", "https"):
        _check_server(store, timeout)
    elif parts.hostname is not None and port is not None:
        try:
            socket.create_connection((parts.hostname, parts.port or port), timeout).close()
        except (OSError, ValueError) as error:
            raise AwayError(f"no database answers at {store} ({error}): {MEND}") from None


def _check_server(store: Store, timeout: float) -> None:
    try:
        urllib.request.urlopen(f"{store.uri}/health", timeout=timeout).close()
    except urllib.error.HTTPError as error:
        if error.code in (502, 503, 504):  # a proxy, whose server is away
            raise AwayError(f"no tracking server answers at {store} ({error}): {MEND}") from None
    except (OSError, ValueError, http.client.HTTPException) as error:
        reason = getattr(error, "reason", None) or error
        raise AwayError(f"no tracking server answers at {store} ({reason}): {MEND}") from None


def _check_file(database: Path) -> None:
    folder = database.parent
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if database.exists():
            with database.open("rb+") as file:
                header = file.read(16)
            if header not in (b"", b"SQLite format 3\0"):
                raise ConfigError(f"{database} is not an SQLite database: move it away or {MEND}")
        elif not os.access(folder, os.W_OK):
            raise PermissionError(f"no permission to write in {folder}")
    except OSError as error:
        reason = error.strerror or error
        raise ConfigError(f"tracking store {database} is not writable ({reason}): {MEND}") from None


@functools.lru_cache(maxsize=8)
def connect(store: Store) -> MlflowClient:
    """Return a client; creates and migrates the tables of a new database (3 s)."""
    os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")
    os.environ.setdefault("MLFLOW_ENABLE_ARTIFACTS_PROGRESS_BAR", "false")
    # MLflow's own patience is minutes per call: training would seem to hang on a dead server.
    os.environ.setdefault("MLFLOW_HTTP_REQUEST_MAX_RETRIES", "2")
    os.environ.setdefault("MLFLOW_HTTP_REQUEST_TIMEOUT", "20")

    import logging

    logging.getLogger("alembic").setLevel(logging.WARNING)
    for name in ("mlflow.store.db.utils", "sqlalchemy.pool"):
        # they print the tracebacks of errors that they raise as well
        logging.getLogger(name).setLevel(logging.CRITICAL)

    with first_import("mlflow"):
        from mlflow import MlflowClient

    try:
        with store.lock():
            _create(store)
            client = MlflowClient(store.uri, registry_uri=store.uri)
            client.search_experiments(max_results=1)
    except ConfigError:
        raise
    except Exception as error:  # of MLflow or of the database
        told = f"tracking store {store} cannot be opened: {_reason(error, store)}"
        away = is_away(error) if store.database is None else "is locked" in str(error)
        if away or store.database is None:
            raise (AwayError if away else ConfigError)(told) from error
        raise ConfigError(f"{told}; or give {NEW_STORE}") from error
    return client


def _reason(error: Exception, store: Store) -> str:
    """Return what MLflow or a database says, of another version with the command for this store."""
    told = first_line(error).partition(" NOTE: ")[0].rstrip(".")
    return told.replace("<database_uri>", str(store))


def connect_existing(store: Store, mend: str) -> MlflowClient:
    """Return a client of a store that has to be there; an error says ``mend`` for another one."""
    if store.database is not None and not store.database.exists():
        raise ConfigError(f"no tracking store at {store.database}: {mend}")
    check(store, timeout=5.0)
    return connect(store)


def _create(store: Store) -> None:
    """Create a new SQLite database atomically.

    MLflow cannot use the half of one that a killed process would leave.
    """
    if store.database is None or (store.database.exists() and store.database.stat().st_size):
        return
    from mlflow.store.tracking.sqlalchemy_store import SqlAlchemyStore

    def create(file: Path) -> None:
        SqlAlchemyStore(f"sqlite:///{file}", store.artifacts).engine.dispose()

    write_whole(store.database, create)


def experiment_id(store: Store, name: str) -> str:
    """Return the experiment of that name, created if need be, once for racing processes."""
    from mlflow.exceptions import MlflowException

    client = connect(store)
    with store.lock():
        found = client.get_experiment_by_name(name)
        if found is None and store.database is not None and _is_unused(client, store):
            client.rename_experiment(UNUSED, name)
            return UNUSED
        if found is None:
            try:
                return client.create_experiment(name, artifact_location=store.artifacts)
            except MlflowException as error:
                # behind a server there is no lock: another process was faster
                if error.error_code != "RESOURCE_ALREADY_EXISTS":
                    raise
                found = client.get_experiment_by_name(name)
                assert found is not None
    if found.lifecycle_stage != "active":
        raise ConfigError(
            f"experiment {name!r} was deleted in {store}: restore it "
            f"(mlflow experiments restore -x {found.experiment_id}) or choose another name"
        )
    if _was_moved(store, Path(str(found.artifact_location))):
        raise ConfigError(
            f"{store} was moved or copied here, and MLflow would write files to "
            f"{found.artifact_location}: move it back, or give {NEW_STORE}"
        )
    return str(found.experiment_id)


def _was_moved(store: Store, kept: Path) -> bool:
    """Return whether the folder that MLflow keeps by its absolute path now is beside the store."""
    if store.database is None or store.artifacts is None or not kept.is_absolute():
        return False
    possible = [Path(store.artifacts, *parts) for parts in ((), (kept.name,))]
    here = [one for one in possible if one.name == kept.name and one.is_dir()]
    return bool(here) and not any(kept.exists() and one.samefile(kept) for one in here)


def _is_unused(client: MlflowClient, store: Store) -> bool:
    """Return whether the experiment that MLflow makes with every store has no runs."""
    found = [one for one in client.search_experiments() if one.experiment_id == UNUSED]
    if not found or found[0].name != "Default":
        return False
    here = str(found[0].artifact_location).startswith(str(store.artifacts))
    return here and not client.search_runs([UNUSED], max_results=1)
