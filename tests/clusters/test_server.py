"""Many writers: eight runs at once, logged by an MLflow server to PostgreSQL."""

import importlib.util
import os
import tempfile
import urllib.request
from pathlib import Path

import pytest

from symo_exp.runs.folder import RunFolder
from symo_exp.tracking.store import connect, find
from tests.clusters.server import Server, UnavailableError, free_ports
from tests.faults.commands import Command, go
from tests.tiny import TINY

pytestmark = pytest.mark.server

EPOCHS = 6000  # for longer than all eight jobs need to start
WORDS = [
    *TINY, "model=node", f"trainer.max_epochs={EPOCHS}", "trainer.validate_every=20",
    "trainer.compile=false", "pictures=false", "logger.flush_seconds=0.5",
]  # fmt: skip


@pytest.fixture
def folder():
    """A folder that the user of PostgreSQL can read, whatever pytest makes of its own ones."""
    with tempfile.TemporaryDirectory(prefix="symo_exp-server-") as name:
        os.chmod(name, 0o755)
        yield Path(name)


@pytest.fixture
def server(folder):
    if importlib.util.find_spec("psycopg2") is None:
        pytest.skip("psycopg2 is not installed: pip install 'symo_exp[server]'")
    (port,) = free_ports(1)
    there = Server(folder, host="127.0.0.1", port=port, workers=1)
    try:
        there.start()
    except UnavailableError as error:
        if "PostgreSQL" in str(error):
            pytest.skip(str(error))
        raise
    yield there
    there.stop()


def series(client, run):
    """Steps of each series, as often as they were told."""
    names = client.get_run(run).data.metrics
    return {name: sorted(m.step for m in client.get_metric_history(run, name)) for name in names}


def test_eight_jobs_lose_nothing_in_a_restart_of_the_server(server, tmp_path):
    """No value is lost, none is there twice, and every run is closed."""
    words = [*WORDS, f"logger.tracking_uri={server.address}", "data.seed=0"]
    commands = [Command(tmp_path, *words, f"seed={seed}") for seed in range(8)]
    client = connect(find(server.address, tmp_path))

    def told():
        found = client.get_experiment_by_name("default")
        runs = client.search_runs([found.experiment_id]) if found else []
        return [run for run in runs if "train_loss" in run.data.metrics]

    commands[0].wait_for(lambda: len(told()) == 8, timeout=300.0)
    server.stop()
    alive = sum(command.process.is_alive() for command in commands)
    assert alive == 8
    server.start()
    for command in commands:
        assert command.wait() == 0, command.said
    for seed in range(8):  # what a run could not tell when it ended, it tells now
        code, said = go(tmp_path, *words, f"seed={seed}")
        assert code == 0, said
        assert "finished already" in said
    folders = [*map(RunFolder, tmp_path.glob("outputs/default/node-*"))]
    assert len(folders) == 8

    assert len(client.search_runs([client.get_experiment_by_name("default").experiment_id])) == 8
    kept = [*range(100), *range(104, EPOCHS, 5)]
    for folder in folders:
        run = folder.published()["run_id"]
        assert client.get_run(run).info.status == "FINISHED"
        found = series(client, run)
        assert found["train_loss"] == kept
        assert all(len(steps) == len(set(steps)) for steps in found.values())
        assert {f.path for f in client.list_artifacts(run)} >= {"config.yaml", "checkpoints"}


def test_logged_values_are_there_after_a_restart(server):
    client = connect(find(server.address, "."))
    experiment = client.create_experiment("one")
    server.stop()
    with pytest.raises(OSError, match="refused"):
        urllib.request.urlopen(f"{server.address}/health")
    server.start()
    assert client.get_experiment(experiment).name == "one"
