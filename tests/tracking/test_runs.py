"""Runs are opened with their origin, grouped under a parent, and never left RUNNING."""

import os
import subprocess
import sys

from symo_exp.tracking import parent, runs
from symo_exp.tracking.process import PID
from symo_exp.tracking.store import connect, experiment_id


def test_nested_parameters_become_flat():
    nested = {"data": {"n_traj": 8, "box": [1, 2]}, "seed": 0, "f": {"_partial_": True}, "e": {}}
    assert runs.flatten(nested) == {"data.n_traj": 8, "data.box": [1, 2], "seed": 0, "e": {}}


def test_more_parameters_than_one_request_takes(store):
    run_id = runs.open_run(store, "e", name="r")
    runs.log_parameters(store, run_id, {"a": {str(i): i for i in range(250)}})
    params = connect(store).get_run(run_id).data.params
    assert len(params) == 250
    assert params["a.249"] == "249"


def test_a_run_says_where_it_comes_from(store):
    run = connect(store).get_run(runs.open_run(store, "e", name="cartpole-symo"))
    assert run.info.run_name == "cartpole-symo"
    assert run.info.status == "RUNNING"
    assert run.data.tags[PID] == str(os.getpid())


def test_the_run_of_a_dead_process_is_closed_and_that_of_a_living_one_is_not(store):
    code = (
        "import os\n"
        "from symo_exp.tracking import runs, store\n"
        f"print(runs.open_run(store.find({store.uri!r}, '.'), 'e', name='r'), flush=True)\n"
        "os._exit(9)"
    )
    living = runs.open_run(store, "e", name="living")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    dead = done.stdout.strip()
    client = connect(store)
    assert client.get_run(dead).info.status == "RUNNING"

    assert runs.close_stale(store, experiment_id(store, "e")) == [dead]
    closed = client.get_run(dead)
    assert closed.info.status == "KILLED"
    assert "ended without closing" in closed.data.tags[runs.REASON]
    assert client.get_run(living).info.status == "RUNNING"

    runs.reopen_run(store, dead)
    assert client.get_run(dead).info.status == "RUNNING"
    assert runs.REASON not in client.get_run(dead).data.tags
    assert runs.close_stale(store, experiment_id(store, "e")) == []


def test_a_multirun_is_a_parent_with_children(store):
    uri = store.uri
    top = parent.start_parent(
        experiment="e", tracking_uri=uri, name="sweep", parameters={"data.n_traj": "8,16"}
    )
    assert os.environ[runs.PARENT] == top
    child = runs.open_run(store, "e", name="child", parent=runs.parent_from_environment())
    client = connect(store)
    assert client.get_run(child).data.tags["mlflow.parentRunId"] == top
    assert client.get_run(top).data.params == {"data.n_traj": "8,16"}

    if os.fork() == 0:  # a worker must not close its sweep's parent
        parent.end_parent("FAILED")
        os._exit(0)
    os.wait()
    assert client.get_run(top).info.status == "RUNNING"

    parent.end_parent("FAILED", "1 of 2 jobs failed")
    parent.end_parent("FINISHED")
    closed = client.get_run(top)
    assert closed.info.status == "FAILED"
    assert closed.data.tags[runs.REASON] == "1 of 2 jobs failed"
    assert runs.PARENT not in os.environ
    assert runs.parent_from_environment() is None
