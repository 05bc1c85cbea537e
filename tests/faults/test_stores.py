"""Finished runs are kept when a store is damaged, unreachable, or reachable again."""

import shutil
import sqlite3

import pytest

from symo_exp.runs.folder import RunFolder
from tests.faults.commands import Command, go, stored
from tests.tiny import TINY

WORDS = [*TINY, "model=node", "pictures=false"]
LONG = [*WORDS, "trainer.max_epochs=400", "trainer.compile=false", "trainer.checkpoint_every=0"]


def one_line(code, said, *, exit_code, words):
    assert code == exit_code, said
    lines = [line for line in said.splitlines() if line.startswith("symo_exp")]
    assert len(lines) == 1, said
    assert words in lines[0]
    assert "Traceback" not in said


@pytest.mark.slow
@pytest.mark.parametrize("sweep", [[], ["-m", "seed=0"]], ids=["run", "sweep"])
def test_a_store_of_a_newer_mlflow_is_refused_before_training(sweep, store, tmp_path):
    with sqlite3.connect(store.database) as database:
        database.execute("update alembic_version set version_num = 'from_the_future'")
    one_line(*go(tmp_path, *WORDS, *sweep), exit_code=2, words="cannot be opened")
    assert not [*tmp_path.rglob("*.ckpt")]


@pytest.mark.slow
def test_a_deleted_folder_of_artifacts_is_made_again(store, tmp_path):
    command = Command(tmp_path, *LONG)
    command.wait_for(lambda: [*tmp_path.rglob("last.ckpt")])
    shutil.rmtree(tmp_path / "mlruns" / "artifacts", ignore_errors=True)
    assert command.wait() == 0, command.said
    assert [*tmp_path.glob("mlruns/artifacts/**/config.yaml")]


@pytest.mark.slow
def test_a_run_is_finished_without_its_store_and_published_later(store, tmp_path):
    """The run is finished all the same, and told when the store is back."""
    command = Command(tmp_path, *LONG)
    command.wait_for(lambda: [*tmp_path.rglob("last.ckpt")])
    away = store.database.with_suffix(".away")
    store.database.rename(away)
    store.database.mkdir()
    assert command.wait() == 0, command.said
    assert "is uploaded when the command is given again" in command.said
    (run,) = map(RunFolder, tmp_path.glob("outputs/default/node-*"))
    assert not run.published()

    code, said = go(tmp_path, *LONG)  # still away
    assert code == 0, said
    assert "is uploaded when the command is given again" in said
    assert not run.published()

    store.database.rmdir()
    away.rename(store.database)
    code, said = go(tmp_path, *LONG)
    assert code == 0, said
    assert run.published()
    client, (run,) = stored(tmp_path)
    assert run.info.status == "FINISHED"
    steps = [row.step for row in client.get_metric_history(run.info.run_id, "train_loss")]
    assert steps == [*range(100), *range(104, 400, 5)]
    assert "test_mse" in run.data.metrics
    assert {f.path for f in client.list_artifacts(run.info.run_id)} >= {
        "config.yaml",
        "checkpoints",
    }
