"""Choice and checks of the store, and processes that create it at once."""

import dataclasses
import multiprocessing
import os
import shutil
import socket
import sqlite3
import subprocess
import sys
import threading
import time
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import pytest

from symo_exp.errors import ConfigError
from symo_exp.runs.folder import About, RunFolder
from symo_exp.tracking import store as stores
from symo_exp.tracking.publish import MlflowView
from symo_exp.tracking.store import Store, check, connect, experiment_id, find


def test_configuration_then_environment_then_sqlite(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    assert find(None, "runs").uri == f"sqlite:///{tmp_path}/runs/mlflow.db"
    assert find(None, "runs").artifacts == f"{tmp_path}/runs/artifacts"
    monkeypatch.setenv("MLFLOW_TRACKING_URI", "http://host:5000/")
    assert find(None, "runs") == Store("http://host:5000", None, None)
    assert find("sqlite:///x/y.db", "runs").uri == f"sqlite:///{tmp_path}/x/y.db"
    assert find("sqlite:///x/y.db", "runs").artifacts == f"{tmp_path}/x/artifacts"
    assert find("sqlite:///lite", "runs").uri == f"sqlite:///{tmp_path}/lite"
    assert find("postgresql+psycopg2://u@h/db", "runs").artifacts == f"{tmp_path}/runs/artifacts"


@pytest.mark.parametrize("uri", ["file:./mlruns", "mlruns", "/tmp/mlruns", "ftp://x", "sqlite://"])
def test_a_uri_of_no_use_is_refused(uri, tmp_path):
    with pytest.raises(ConfigError, match=r"tracking URI .*sqlite:///"):
        find(uri, tmp_path)


def test_a_password_is_not_shown():
    assert "secret" not in str(find("postgresql://me:secret@host/db", "."))


def refused(store: Store, timeout: float = 0.5) -> str:
    start = time.monotonic()
    with pytest.raises(ConfigError) as caught:
        check(store, timeout)
    assert time.monotonic() - start < timeout + 2
    return str(caught.value)


@pytest.mark.parametrize("scheme", ["http", "postgresql"])
def test_an_address_where_nothing_listens_is_refused(scheme):
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        port = unused.getsockname()[1]
        assert "refused" in refused(find(f"{scheme}://127.0.0.1:{port}", "."))


def test_a_server_that_does_not_answer_is_refused():
    with socket.socket() as silent:
        silent.bind(("127.0.0.1", 0))
        silent.listen()
        assert "timed out" in refused(find(f"http://127.0.0.1:{silent.getsockname()[1]}", "."))


@pytest.mark.parametrize("scheme", ["http", "postgresql"])
def test_a_port_that_is_no_number_is_refused(scheme):
    assert "'abc'" in refused(find(f"{scheme}://127.0.0.1:abc", "."))


def test_another_service_than_a_tracking_server_is_refused():
    with socket.create_server(("127.0.0.1", 0)) as other:

        def greet():
            client, _ = other.accept()
            with client:
                client.recv(1000)
                client.sendall(b"SSH-2.0-OpenSSH\r\n")

        threading.Thread(target=greet, daemon=True).start()
        told = refused(find(f"http://127.0.0.1:{other.getsockname()[1]}", "."))
    assert "no tracking server answers" in told
    assert "SSH" in told


def test_a_profile_of_databricks_is_not_asked_before_it_is_used():
    check(find("databricks://profile", "."), timeout=0.5)


def test_a_server_that_asks_for_a_password_is_accepted():
    class Guarded(BaseHTTPRequestHandler):
        def do_GET(self):
            self.send_error(401)

        def log_message(self, *_):
            pass

    server = HTTPServer(("127.0.0.1", 0), Guarded)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        check(find(f"http://127.0.0.1:{server.server_port}", "."), timeout=2)
    finally:
        server.shutdown()
        server.server_close()


def test_a_place_that_cannot_be_written_is_refused(tmp_path):
    (tmp_path / "file").write_text("in the way")
    assert "not writable" in refused(find(None, tmp_path / "file"))
    assert "not writable" in refused(find(None, "/proc/nothing"))


def test_a_foreign_file_is_not_touched(tmp_path):
    (tmp_path / "mlflow.db").write_text("my diary, volume one")
    assert "not an SQLite database" in refused(find(None, tmp_path))
    assert (tmp_path / "mlflow.db").read_text() == "my diary, volume one"


def test_a_store_of_a_newer_mlflow_is_refused(store):
    with sqlite3.connect(store.database) as database:
        database.execute("update alembic_version set version_num = 'from_the_future'")
    with pytest.raises(ConfigError, match="cannot be opened") as caught:
        connect(store)
    told = str(caught.value)
    assert f"mlflow db upgrade {store}" in told
    assert told.endswith(stores.NEW_STORE)
    assert len(told) < 600


def test_a_damaged_store_is_refused_with_what_to_do(store):
    content = store.database.read_bytes()
    store.database.write_bytes(content[:20000] + bytes(len(content) - 20000))
    connect.cache_clear()
    with pytest.raises(ConfigError, match=r"cannot be opened: .*malformed; or give logger\.dir"):
        connect(store)


def test_a_store_that_another_program_has_locked_does_not_answer(store):
    store = dataclasses.replace(store, uri=f"{store.uri}?timeout=0.1")
    connect.cache_clear()
    with sqlite3.connect(store.database) as other:
        other.execute("BEGIN EXCLUSIVE")
        with pytest.raises(stores.AwayError, match=r"cannot be opened.*locked"):
            connect(store)


def test_an_experiment_is_created_once_and_keeps_its_artifacts_beside_the_database(store):
    first = experiment_id(store, "e")
    assert experiment_id(store, "e") == first
    assert connect(store).get_experiment(first).artifact_location == store.artifacts


def as_it_was_made(store: Store) -> Store:
    """The store of a test is a copy: as if its files were to lie where they did at first."""
    location = connect(store).get_experiment("0").artifact_location
    return dataclasses.replace(store, artifacts=str(Path(location).parent))


def test_mlflow_s_own_experiment_becomes_the_first_of_ours(store):
    store = as_it_was_made(store)
    assert experiment_id(store, "e") == "0"
    assert experiment_id(store, "e") == "0"
    assert experiment_id(store, "f") != "0"
    assert {e.name for e in connect(store).search_experiments()} == {"e", "f"}


def test_runs_that_others_logged_to_default_stay_there(store):
    store = as_it_was_made(store)
    connect(store).create_run("0")
    assert experiment_id(store, "e") != "0"
    assert {e.name for e in connect(store).search_experiments()} == {"e", "Default"}


def test_a_deleted_experiment_is_reported(store):
    connect(store).delete_experiment(experiment_id(store, "e"))
    with pytest.raises(ConfigError, match="mlflow experiments restore"):
        experiment_id(store, "e")


@pytest.mark.parametrize("name", ["first", "second"])
def test_a_store_that_was_moved_or_copied_does_not_write_where_it_was(name, tmp_path):
    """MLflow keeps absolute paths, of its own experiment and of others."""
    before = find(None, tmp_path / "before")
    for one in ("first", "second"):
        run = connect(before).create_run(experiment_id(before, one))
        connect(before).log_text(run.info.run_id, "text", "file.txt")
    connect.cache_clear()
    (tmp_path / "link").symlink_to(tmp_path / "before")
    assert experiment_id(find(None, tmp_path / "link"), name)

    def refused_at(place):
        with pytest.raises(ConfigError, match=f"write files to {tmp_path}/before.*directory="):
            experiment_id(find(None, tmp_path / place), name)

    shutil.copytree(tmp_path / "before", tmp_path / "copy")
    refused_at("copy")
    (tmp_path / "before").rename(tmp_path / "after")
    refused_at("after")
    refused_at("copy")
    (tmp_path / "after").rename(tmp_path / "before")
    assert experiment_id(before, name)


def test_an_experiment_that_another_process_just_created(store, monkeypatch):
    """Behind a server there is no lock: between our look and our creation it appears."""
    client = connect(store)
    wanted = client.create_experiment("e")
    look = client.get_experiment_by_name
    answers = iter([None, look("e")])
    monkeypatch.setattr(client, "get_experiment_by_name", lambda name: next(answers))
    assert experiment_id(store, "e") == wanted


def _start(directory: Path, barrier, results) -> None:
    try:
        folder = RunFolder(directory / str(os.getpid()))
        folder.describe(About("job", {}))
        folder.record("finished")
        barrier.wait(60)
        MlflowView(experiment="crowd", directory=directory).publish(folder)
        results.put(folder.published()["run_id"])
    except BaseException as error:
        results.put(error)
        raise


def test_four_processes_at_once_on_a_store_that_does_not_exist(tmp_path):
    import mlflow  # noqa: F401  # before the fork, so that the processes do start together

    context = multiprocessing.get_context("fork")
    barrier, results = context.Barrier(4), context.Queue()
    workers = [
        context.Process(target=_start, args=(tmp_path / "new", barrier, results)) for _ in range(4)
    ]
    for worker in workers:
        worker.start()
    found = [results.get(timeout=120) for _ in workers]
    for worker in workers:
        worker.join(60)
    assert all(isinstance(run, str) for run in found), found
    client = connect(find(None, tmp_path / "new"))
    experiments = client.search_experiments(filter_string="name = 'crowd'")
    assert len(experiments) == 1
    runs = client.search_runs([experiments[0].experiment_id])
    assert {run.info.run_id for run in runs} == set(found)
    assert len(runs) == 4


def test_a_lock_that_is_never_released_ends_in_a_sentence(store, monkeypatch):
    monkeypatch.setattr(stores, "LOCK_SECONDS", 0.1)
    with store.lock():
        code = (
            "from symo_exp.tracking import store as s; s.LOCK_SECONDS = 0.1\n"
            f"with s.find({store.uri!r}, '.').lock(): pass"
        )
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert "ConfigError" in done.stderr
    assert "by another process" in done.stderr


def test_mlflow_is_imported_only_when_a_store_is_opened():
    code = (
        "import sys\n"
        "from symo_exp.tracking import store, publish, revision\n"
        "store.check(store.find(None, '/tmp'), 1.0)\n"
        "assert not {'mlflow', 'torch', 'lightning'} & set(sys.modules), sorted(sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
