"""Description, dataset and views of runs in MLflow."""

import json

import pytest
from mlflow import MlflowClient
from mlflow.exceptions import MlflowException
from mlflow.protos.databricks_pb2 import BAD_REQUEST

from symo_exp.runs.folder import About, RunFolder
from symo_exp.shell import python_command
from symo_exp.tracking.page import COMMAND, NOTE, RESULT, VIEW, pages
from symo_exp.tracking.publish import MlflowView
from symo_exp.tracking.store import Store, connect, experiment_id

PARAMETERS = {"model": "symo", "system": "pendulum", "data.n_traj": 8, "seed": 3}


@pytest.fixture
def view(store):
    return MlflowView(experiment="e", directory=store.database.parent)


def published(view, tmp_path, name="run", *, status="finished", measures=(), **about):
    folder = RunFolder(tmp_path / name)
    folder.path.mkdir(exist_ok=True)
    folder.describe(About("a name", **{"parameters": PARAMETERS, **about}))
    folder.record("running")
    view.publish(folder)
    folder.write_config({})
    folder.write_measures(dict(measures))
    folder.record(status, "" if status == "finished" else "out of memory")
    view.publish(folder)
    run = folder.published()["run_id"]
    return connect(view.store).get_run(run)


def test_the_description_has_the_command_and_what_came_of_it(view, tmp_path):
    tags = {COMMAND: "python -m symo_exp model=symo"}
    measures = {"test_mse": 8.85e-6, "integration_mse": 0.5, "lr": 0.1}
    run = published(view, tmp_path, measures=measures, tags=tags)
    command, results = run.data.tags[NOTE].split("\n\n")
    assert command == "`python -m symo_exp model=symo`"
    assert "test_mse 8.85e-06" in results
    assert "integration_mse 0.5" in results
    assert "lr" not in results
    run = published(view, tmp_path, "failed", status="failed", tags=tags)
    assert run.data.tags[NOTE].split("\n\n") == [command, "out of memory"]
    sweep = {"jobs": 2}
    run = published(view, tmp_path, "sweep", parameters=sweep, tags={RESULT: "Smallest: that."})
    assert run.data.tags[NOTE] == "Smallest: that."
    assert not run.inputs.dataset_inputs


def test_runs_on_the_same_data_have_the_same_dataset(view, tmp_path):
    files, many = ["a/b.csv", "c/d (1).csv"], [f"{i}.csv" for i in range(1000)]
    variants = ({}, {"model": "node"}, {"seed": 4}, {"data.n_traj": 16}, {"data.path": files},
                {"data.path": many}, {"data.path": "a/b.csv"})  # fmt: skip
    datasets = []
    for i, other in enumerate(variants):
        run = published(view, tmp_path, str(i), parameters=PARAMETERS | other)
        (given,) = run.inputs.dataset_inputs
        assert {tag.key: tag.value for tag in given.tags} == {"mlflow.data.context": "training"}
        datasets.append(given.dataset)
    digests = [dataset.digest for dataset in datasets]
    assert digests[0] == digests[1]
    assert len(set(digests)) == len(digests) - 1
    names = [dataset.name for dataset in datasets]
    assert names[3:5] == ["pendulum simulated", "b.csv, d (1).csv"]
    assert names[5].startswith("0.csv, 1.csv")
    assert names[6] == "b.csv"
    assert json.loads(datasets[0].profile)["trajectories"] == "8"


def test_a_dataset_that_another_process_creates_at_the_same_moment_is_taken(
    view, tmp_path, monkeypatch
):
    """MLflow lets the slower of two processes fail."""
    send, failures = MlflowClient.log_inputs, [MlflowException("UNIQUE constraint", BAD_REQUEST)]

    def slower(*arguments, **words):
        send(*arguments, **words)
        if failures:
            raise failures.pop()

    monkeypatch.setattr(MlflowClient, "log_inputs", slower)
    assert published(view, tmp_path).inputs.dataset_inputs
    assert not failures


def test_the_page_is_that_of_training_with_the_view_of_the_last_sweep(view, store):
    experiment = experiment_id(store, "e")
    plain = f"http://127.0.0.1:5000/#/experiments/{experiment}/runs?workflowType=machine_learning"
    serve = python_command("mlflow", "server", "--backend-store-uri", store.uri)
    assert view.page() == f"{serve}, then {plain}"
    view.show(["model", "data.n_traj"])
    shared = f"{plain}&viewStateShareKey=symo_exp"
    assert view.page().endswith(shared)
    assert f"e: {shared}" in pages(store, "http://127.0.0.1:5000")
    shown = json.loads(connect(store).get_experiment(experiment).tags[VIEW])
    assert shown["selectedColumns"][:3] == [
        "params.`model`", "params.`data.n_traj`", "metrics.`test_mse`",
    ]  # fmt: skip
    found = connect(store).search_runs([experiment], shown["searchFilter"])
    assert found == []  # it is a filter


def test_a_store_that_is_away_has_no_page():
    away = MlflowView(tracking_uri="http://127.0.0.1:9", timeout=0.5)
    away.show(["model"])
    assert away.page() == ""


def test_a_server_has_a_page_of_its_own(monkeypatch):
    from symo_exp.tracking import page

    monkeypatch.setattr(page, "runs_at", lambda store, base, experiment: f"{base} {experiment}")
    assert page.page(Store("http://host:5", None, None), "7") == "http://host:5 7"
