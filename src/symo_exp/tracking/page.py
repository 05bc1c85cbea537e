"""Description, dataset and addresses of runs in MLflow."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from symo_exp.errors import shortened
from symo_exp.runs.outcome import About, Outcome, recording_names
from symo_exp.shell import python_command
from symo_exp.shipped import in_checkout
from symo_exp.tracking.store import Store, connect, is_away

if TYPE_CHECKING:
    from mlflow.entities import Run

NOTE = "mlflow.note.content"
COMMAND, RESULT = "symo_exp.command", "symo_exp.result"
"""Tags: what was typed, and what came of it in a sentence."""
RESULTS = "train_mse", "test_mse", "integration_mse", "energy_mse", "inertia_mse", "rmse_2s"
"""The measures of a description."""
VIEW = "mlflow.sharedViewState.symo_exp"
LONGEST = 500
"""Characters of the name of a dataset, which MLflow allows."""
LOCAL = "http://127.0.0.1:5000"
"""Address of MLflow's server for a store that is a file."""


def description(about: About, outcome: Outcome, measures: Mapping[str, float]) -> str:
    """Return the command and its result."""
    shown = [f"{name} {measures[name]:.3g}" for name in RESULTS if name in measures]
    result = about.tags.get(RESULT) or (", ".join(shown) + "." if shown else outcome.reason)
    command = f"`{about.tags[COMMAND]}`" if COMMAND in about.tags else ""
    return "\n\n".join(filter(None, (command, result)))


def send_dataset(store: Store, run: Run, parameters: Mapping[str, Any]) -> None:
    """Send what the run was trained on as MLflow's dataset; the same data have one digest."""
    from mlflow.entities import Dataset, DatasetInput, InputTag
    from mlflow.exceptions import MlflowException

    told = {
        key: str(value) for key, value in parameters.items()
        if key.startswith(("data", "system", "draws")) or key == "seed"
    }  # fmt: skip
    if "system" not in told or (run.inputs and run.inputs.dataset_inputs):
        return
    source = json.dumps(told, sort_keys=True)
    size = {"trajectories": told.get("data.n_traj"), "noise_std": told.get("data.noise_std")}
    name = f"{told['system']} simulated"
    if "data.path" in told:
        name = shortened(recording_names(told["data.path"]), LONGEST)
    dataset = Dataset(
        name=name, digest=hashlib.sha256(source.encode()).hexdigest()[:8],
        source_type="symo_exp", source=source, profile=json.dumps(size),
    )  # fmt: skip
    given = [DatasetInput(dataset, [InputTag("mlflow.data.context", "training")])]
    client, run_id = connect(store), str(run.info.run_id)
    try:
        client.log_inputs(run_id, datasets=given)
    except MlflowException as error:
        if is_away(error):
            raise
        client.log_inputs(run_id, datasets=given)  # another process has just created the dataset


def show(store: Store, experiment: str, varied: Sequence[str]) -> None:
    """Give the experiment a view of its runs, the smallest test error first.

    The runs are not folded into their sweeps, and columns show what was varied and measured.
    MLflow keeps shared views in this form without documenting it; another release may ignore it
    and show its own view.
    """
    columns = [f"params.`{name}`" for name in varied]
    columns += [f"metrics.`{name}`" for name in RESULTS[1:]]
    # a sweep has no system; sorted by anything but time, runs are not folded into theirs
    view = {
        "searchFilter": "params.system != ''", "selectedColumns": columns,
        "orderByKey": "metrics.`test_mse`", "orderByAsc": True,
    }  # fmt: skip
    connect(store).set_experiment_tag(experiment, VIEW, json.dumps(view))


def page(store: Store, experiment: str) -> str:
    """Return the address of an experiment's runs, and what serves it."""
    if store.database is None:
        return runs_at(store, store.uri if store.uri.startswith("http") else LOCAL, experiment)
    ours = Path("mlruns/mlflow.db").absolute() == store.database and in_checkout()
    by_hand = python_command("mlflow", "server", "--backend-store-uri", store.uri)
    serve = "make ui" if ours else by_hand
    return f"{serve}, then {runs_at(store, LOCAL, experiment)}"


def pages(store: Store, base: str) -> list[str]:
    """Return a line per experiment: its name and the page of its runs."""
    found = connect(store).search_experiments()
    return [f"{one.name}: {runs_at(store, base, one.experiment_id)}" for one in found]


def runs_at(store: Store, base: str, experiment: str) -> str:
    """Return the address of the runs in MLflow's view for training."""
    shared = VIEW in connect(store).get_experiment(experiment).tags
    view = f"&viewStateShareKey={VIEW.rpartition('.')[2]}" if shared else ""
    return f"{base}/#/experiments/{experiment}/runs?workflowType=machine_learning{view}"
