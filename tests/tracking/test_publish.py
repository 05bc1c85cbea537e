"""MLflow is a view of run folders: publishing is idempotent, nothing is sent twice."""

import errno
import shutil
import time
from types import SimpleNamespace

import pytest

from symo_exp.errors import ConfigError
from symo_exp.job import job
from symo_exp.runs.folder import About, RunFolder
from symo_exp.runs.series import Series
from symo_exp.tracking import publish
from symo_exp.tracking.nowhere import Nowhere
from symo_exp.tracking.publish import MlflowView
from symo_exp.tracking.store import connect, is_away
from tests.tiny import copy_store

PARAMETERS = {"model": "symo", "seed": 3, "data.n_traj": 8}


@pytest.fixture
def view(store):
    return MlflowView(experiment="e", directory=store.database.parent, every_n_epochs=5)


@pytest.fixture
def folder(tmp_path):
    folder = RunFolder(tmp_path / "run")
    folder.describe(About("symo pendulum", PARAMETERS, variant="fast", tags={"git_dirty": "true"}))
    folder.record("running")
    return folder


def grow(folder, epochs, start=0):
    series = Series(folder / "series.csv")
    for epoch in range(start, epochs):
        row = {"train_loss": 1.0 / (epoch + 1)} | ({"val_loss": 2.0} if epoch % 10 == 9 else {})
        series.append(epoch, row)


def finish(folder):
    folder.write_config({"seed": 3})
    folder.write_measures({"test_mse": 1e-7, "integration_mse": float("inf")})
    (folder / "pictures").mkdir(exist_ok=True)
    (folder / "pictures" / "a.png").write_bytes(b"x")
    folder.record("finished", seconds=3.0)


def runs(store):
    client = connect(store)
    experiment = client.get_experiment_by_name("e")
    return client.search_runs([experiment.experiment_id])


def steps(store, name):
    (run,) = runs(store)
    return [m.step for m in connect(store).get_metric_history(run.info.run_id, name)]


def test_a_run_appears_grows_and_is_finished(view, folder, store):
    view.publish(folder)
    (run,) = runs(store)
    assert run.info.status == "RUNNING"
    assert run.info.run_name == "symo pendulum"
    assert run.data.params == {k: str(v) for k, v in PARAMETERS.items()} | {"variant": "fast"}
    assert run.data.tags["git_dirty"] == "true"
    grow(folder, 131)
    view.publish(folder)
    dense, sparse = [*range(publish.DENSE)], [*range(publish.DENSE + 4, 131, 5)]
    assert steps(store, "train_loss") == dense + sparse
    assert not view.is_published(folder)
    grow(folder, 134, start=131)
    finish(folder)
    view.publish(folder)
    (run,) = runs(store)
    assert run.info.status == "FINISHED"
    assert steps(store, "train_loss") == [*dense, *sparse, 133]
    assert steps(store, "val_loss") == [*range(9, 131, 10)]
    assert run.data.metrics["test_mse"] == 1e-7
    client = connect(store)
    names = {f.path for f in client.list_artifacts(run.info.run_id)}
    assert names == {"config.yaml", "series.csv", "metrics.json", "pictures"}
    assert view.is_published(folder)


@pytest.mark.parametrize("forget", [False, True])
def test_publishing_again_sends_nothing_twice(forget, view, folder, store):
    """Another process knows nothing of the first; one whose folder forgot neither."""
    grow(folder, 20)
    view.publish(folder)
    grow(folder, 30, start=20)
    finish(folder)
    for _ in range(3):
        other = MlflowView(experiment="e", directory=store.database.parent)
        other.publish(folder)
        if forget:
            folder.mark_published(None)
    assert steps(store, "train_loss") == list(range(30))
    assert steps(store, "test_mse") == [0]


def test_measures_that_are_computed_again_replace_the_former(view, folder, store):
    finish(folder)
    view.publish(folder)
    folder.write_measures({"test_mse": 2e-7})
    folder.mark_published(None)
    MlflowView(experiment="e", directory=store.database.parent).publish(folder)
    (run,) = runs(store)
    assert run.data.metrics["test_mse"] == 2e-7


def test_a_run_that_was_killed_and_goes_on_is_one_run(view, folder, store):
    grow(folder, 20)
    view.publish(folder)
    Series(folder / "series.csv").cut(12)  # as its checkpoint has it
    grow(folder, 30, start=12)
    folder.describe(About("symo pendulum", PARAMETERS))
    other = MlflowView(experiment="e", directory=store.database.parent)
    other.publish(folder)
    assert steps(store, "train_loss") == list(range(30))


@pytest.mark.parametrize(
    ("status", "told"),
    [("failed", "FAILED"), ("refused", "FAILED"), ("interrupted", "KILLED"),
     ("waiting", "SCHEDULED")],
)  # fmt: skip
def test_status_and_reason_are_published(status, told, view, folder, store):
    folder.record(status, "a reason")
    view.publish(folder)
    (run,) = runs(store)
    assert (run.info.status, run.data.tags["reason"]) == (told, "a reason")
    folder.mark_published(None)
    folder.record("running")
    view.publish(folder)
    (run,) = runs(store)
    assert run.info.status == "RUNNING"
    assert "reason" not in run.data.tags


def test_a_sweep_is_the_parent_of_its_runs(view, tmp_path, store):
    sweep, job = RunFolder(tmp_path / "sweep"), RunFolder(tmp_path / "job")
    sweep.describe(About("seed=0,1", {"jobs": 2}))
    job.describe(About("job", PARAMETERS, sweep=sweep.about().identity))
    for folder in (sweep, job):
        folder.record("running")
        view.publish(folder)
    by_name = {run.info.run_name: run for run in runs(store)}
    parent = by_name["seed=0,1"].info.run_id
    assert by_name["job"].data.tags["mlflow.parentRunId"] == parent
    assert "mlflow.parentRunId" not in by_name["seed=0,1"].data.tags


def test_the_dead_are_closed_and_the_living_are_not(view, folder, tmp_path, store):
    living = RunFolder(tmp_path / "living")
    living.describe(About("living", PARAMETERS))
    living.record("running")
    view.publish(living)
    view.publish(folder)
    with living.alone():
        MlflowView(experiment="e", directory=store.database.parent).close_dead()
    found = {run.info.run_name: run.info.status for run in runs(store)}
    assert found == {"living": "RUNNING", "symo pendulum": "FAILED"}
    assert folder.outcome().status == "failed"


def test_a_folder_that_is_gone_is_left_alone(view, folder, store):
    view.publish(folder)
    shutil.rmtree(folder.path)
    view.close_dead()
    assert [run.info.status for run in runs(store)] == ["RUNNING"]


def test_a_store_that_is_away_says_so_soon(folder):
    away = MlflowView(tracking_uri="http://127.0.0.1:9", timeout=0.5)
    start = time.monotonic()
    with pytest.raises(ConfigError) as caught:
        away.publish(folder)
    assert time.monotonic() - start < 3.0
    assert is_away(caught.value)
    assert not folder.published()


def test_another_store_gets_everything(view, folder, tmp_path, database):
    grow(folder, 3)
    finish(folder)
    view.publish(folder)
    (tmp_path / "other").mkdir()
    copy_store(database, tmp_path / "other")
    other = MlflowView(experiment="e", directory=tmp_path / "other" / "mlruns")
    assert not other.is_published(folder)
    other.publish(folder)
    assert other.is_published(folder)
    assert len(steps(other.store, "train_loss")) == 3


def test_a_store_that_was_deleted_gets_everything_again(view, folder, store, tmp_path):
    grow(folder, 3)
    finish(folder)
    folder.mark_published({"store": str(store), "run_id": "of the one before"})
    assert not view.is_published(folder)
    view.publish(folder)
    assert view.is_published(folder)
    assert len(steps(store, "train_loss")) == 3
    store.database.rename(tmp_path / "elsewhere.db")
    assert not view.is_published(folder)


def test_names_that_mlflow_refuses_are_sent_with_other_letters(view, folder, store):
    told = "error [m], of θ"
    folder.describe(About("symo pendulum", {**PARAMETERS, f"data.columns.{told}": 1}))
    for epochs in (2, 3):
        Series(folder / "series.csv").append(epochs, {"loss (mean)": 1.0})
        view.publish(folder)
    finish(folder)
    folder.write_measures({told: 2.0})
    folder.write_parameters([{"name": "a/b [kg]", "value": 3.0, "standard_deviation": 0.5}])
    view.publish(folder)
    (run,) = runs(store)
    assert run.data.params["data.columns.error _m__ of θ"] == "1"
    assert run.data.metrics == {
        "loss _mean_": 1.0, "error _m__ of θ": 2.0,
        "parameter/a_b _kg_": 3.0, "parameter_deviation/a_b _kg_": 0.5,
    }  # fmt: skip
    assert steps(store, "loss _mean_") == [2, 3]


def test_a_batch_is_not_larger_than_it_may_be(view, folder, store, monkeypatch):
    monkeypatch.setattr(publish, "BATCH", 7)
    grow(folder, 30)
    view.publish(folder)
    assert steps(store, "train_loss") == list(range(30))


def test_nowhere_is_always_up_to_date(folder):
    assert Nowhere().is_published(folder)


@pytest.mark.parametrize(("inside", "said"), [(True, "cannot be written"), (False, "unavailable")])
def test_a_folder_that_cannot_be_written_is_told_from_a_store_that_is_away(
    inside, said, folder, tmp_path, caplog
):
    file = folder / ".published.json" if inside else tmp_path / "mlflow.db"

    def refuse(_):
        raise PermissionError(errno.EACCES, "Permission denied", str(file))

    job.publish(SimpleNamespace(publish=refuse), folder)
    (line,) = caplog.messages
    assert said in line
    assert "Permission denied" in line
