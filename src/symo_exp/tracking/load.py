"""Trained models from run folders and MLflow runs."""

from __future__ import annotations

import logging
import os
import re
import shutil
import tempfile
from pathlib import Path

import torch

from symo_exp import code as own
from symo_exp.checks import path_text
from symo_exp.errors import ConfigError, first_line
from symo_exp.models.base import DynamicsModel
from symo_exp.runs.folder import CHECKPOINT, CONFIG, OUTCOME, POSTERIOR, RunFolder
from symo_exp.runs.load import from_folder
from symo_exp.tracking.store import connect_existing, find

log = logging.getLogger(__name__)

RUN_ID = re.compile(r"[0-9a-f]{32}")
RUN = "a run, its folder or the id of an MLflow run"


def load(
    run: str | os.PathLike[str],
    tracking_uri: str | None = None,
    *,
    directory: str | Path = "mlruns",
    dtype: torch.dtype | None = None,
    device: str | torch.device = "cpu",
    code: str | os.PathLike[str] | None = None,
) -> DynamicsModel:
    """Load the trained model of a run, in evaluation mode.

    If the run has not finished, this is the model of its last checkpoint, and a warning is logged.

    The model predicts batches: configurations ``q`` (B, n), velocities ``v`` (B, n) and inputs
    ``u`` (B, m) in SI units, one time step ``model.time_step`` apart; or single ones, without B:

    * ``model.rollout(q0, v0, u)`` with ``u`` (B, T+1, m) at every node, or ``steps=T`` without
      input, gives ``q`` and ``v`` (B, T+1, n) and ``converged`` (B, T);
    * ``symo_exp.compile_rollout(model)`` makes rollouts three to ten times faster after about a
      minute of compiling, for instance in predictive control;
    * ``model.step(q, v, u, u_next)`` is one time step;
    * ``model.energy(q, v)``, ``mass_matrix(q)``, ``potential(q)``, ``momentum(q, v)``, where the
      method learns a Lagrangian;
    * ``model.for_evaluation()`` is a float64 copy with converged roots, which the measures use.

    Args:
        run: A run, its folder or the id of an MLflow run.
        tracking_uri: Where runs are tracked, for an id; see ``conf/logger/mlflow.yaml``.
        directory: The folder of the default SQLite store, for an id.
        dtype: ``torch.float32`` or ``torch.float64``; ``None``: that of the training.
        device: Where the model is kept.
        code: A folder with the user's own classes of a system or a method.

    Raises:
        ConfigError: For a run that cannot be found or read.
    """
    own.add(code)
    run = path_text("load", run, RUN)
    folder = Path(run).expanduser()
    if folder.is_dir():
        model, outcome = from_folder(folder, dtype, device), RunFolder(folder).outcome()
        if outcome.status != "finished" and (folder / OUTCOME).exists():  # the store has none
            told = "%s has the status %r: this is the model of its last checkpoint"
            log.warning(told, folder, outcome.status)
        return model
    if not RUN_ID.fullmatch(run):
        raise ConfigError(f"{run!r} is neither a run folder nor the id of an MLflow run")
    with tempfile.TemporaryDirectory(prefix="symo_exp-") as copy:
        _download(run, tracking_uri, directory, copy)
        return from_folder(Path(copy), dtype, device)


def model_of(
    subject: DynamicsModel | str | os.PathLike[str], user: str, besides: str = ""
) -> DynamicsModel:
    """Return a model that is given, or that of a run.

    Args:
        subject: A model, a run, its folder or the id of an MLflow run.
        user: The function that takes it, for the error.
        besides: Other arguments that it takes, for the error.

    Raises:
        ConfigError: If it is none of these.
    """
    if isinstance(subject, DynamicsModel):
        return subject
    return load(path_text(user, subject, f"{besides}a model, {RUN}"))


def _download(run_id: str, tracking_uri: str | None, directory: str | Path, target: str) -> None:
    store = find(tracking_uri, directory)
    client = connect_existing(store, "give tracking_uri or directory")
    try:
        client.get_run(run_id)
        trained = client.list_artifacts(run_id, str(Path(CHECKPOINT).parent))
        there = {file.path for file in client.list_artifacts(run_id)}
        names = [CONFIG, *([CHECKPOINT] if trained else []), *({POSTERIOR} & there)]
        for name in names:
            (Path(target) / name).parent.mkdir(exist_ok=True)
            copy = client.download_artifacts(run_id, name, target)
            shutil.move(copy, Path(target) / name)  # stores differ in the folders they make
    except Exception as error:
        told = f"run {run_id} in {store} has no model: {first_line(error)}"
        raise ConfigError(told) from error
