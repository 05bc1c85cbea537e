"""A trained run is a thing one can use: three lines give its model back.

import symo_exp
model = symo_exp.load("outputs/default/…")  # or the id of an MLflow run
path = model.rollout(q0, v0, u)
"""

from __future__ import annotations

import pkgutil
import re
import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import hydra.utils
import torch
import yaml

from symo_exp.errors import ConfigError
from symo_exp.models.base import DynamicsModel
from symo_exp.tracking import artifacts
from symo_exp.tracking.store import check, connect, find

RUN_ID = re.compile(r"[0-9a-f]{32}")
HOMES = ("symo_exp.systems.", "symo_exp.models.", "symo_exp.mechanics.", "symo_exp.nets.")
"""Where the classes of a model come from. A run folder is data: it must not run anything else."""


def load(
    run: str | Path,
    tracking_uri: str | None = None,
    *,
    directory: str | Path = "mlruns",
    dtype: torch.dtype | None = None,
    device: str | torch.device = "cpu",
) -> DynamicsModel:
    """The trained model of a run folder or of an MLflow run id, in evaluation mode.

    ``tracking_uri`` and ``directory`` say where runs are tracked (see ``conf/logger/mlflow.yaml``)
    and matter only for a run id. ``dtype`` is that of the training unless given.

    The model predicts batches: poses ``q`` (B, n) and velocities ``v`` (B, n) in SI units, inputs
    ``u`` (B, m), one time step ``model.time_step`` apart:

    * ``model.rollout(q0, v0, u)`` with ``u`` (B, T+1, m) at every node, or ``steps=T`` without
      input, gives ``q`` and ``v`` (B, T+1, n) and ``converged`` (B, T);
    * ``model.compile_rollout()`` makes rollouts three to ten times faster, for a minute of
      compiling once; worth it where they are needed again and again, as in predictive control;
    * ``model.step(q, v, u, u_next)`` is one step of it;
    * ``model.energy(q, v)``, ``mass_matrix(q)``, ``potential(q)``, ``momentum(q, v)``, where the
      method learns a Lagrangian;
    * ``model.for_evaluation()`` is a float64 copy with converged roots, which the measures use.
    """
    folder = Path(run)
    if folder.is_dir():
        return _from_folder(folder, dtype, device)
    if not RUN_ID.fullmatch(str(run)):
        raise ConfigError(f"{str(run)!r} is neither a run folder nor the id of an MLflow run")
    with tempfile.TemporaryDirectory(prefix="symo_exp-") as copy:
        _download(str(run), tracking_uri, directory, copy)
        return _from_folder(Path(copy), dtype, device)


def _download(run_id: str, tracking_uri: str | None, directory: str | Path, target: str) -> None:
    store = find(tracking_uri, directory)
    if store.database is not None and not store.database.exists():
        raise ConfigError(f"no tracking store at {store.database}: give tracking_uri or directory")
    check(store, timeout=5.0)
    client = connect(store)
    try:
        client.get_run(run_id)
        trained = client.list_artifacts(run_id, str(Path(artifacts.CHECKPOINT).parent))
        for name in (artifacts.CONFIG, artifacts.CHECKPOINT) if trained else (artifacts.CONFIG,):
            (Path(target) / name).parent.mkdir(exist_ok=True)
            copy = client.download_artifacts(run_id, name, target)
            shutil.move(copy, Path(target) / name)  # stores differ in the folders they make
    except Exception as error:
        reason = next(iter(str(error).splitlines()), type(error).__name__)
        raise ConfigError(f"run {run_id} in {store} gives no model: {reason}") from error


def _from_folder(
    folder: Path, dtype: torch.dtype | None, device: str | torch.device
) -> DynamicsModel:
    config = _read_config(folder / artifacts.CONFIG)
    # an optimizer and its schedule belong to the training
    plan = {k: v for k, v in config["model"].items() if k not in ("optimizer", "scheduler")}
    _check([config["system"], plan], folder)
    system = hydra.utils.instantiate(config["system"])
    build = hydra.utils.instantiate({**plan, "_partial_": True})
    model: DynamicsModel = build(
        coordinates=system.coordinates,
        input_matrix=system.input_matrix,
        time_step=system.time_step,
    )
    if model.learns:
        _set_weights(model, folder)
    model.to(device=device, dtype=dtype)
    model.input_matrix.copy_(system.input_matrix)  # it is not trained: not rounded either
    return model.eval()


def _set_weights(model: DynamicsModel, folder: Path) -> None:
    weights = _read_weights(folder / artifacts.CHECKPOINT)
    model.to(next(value.dtype for value in weights.values() if value.is_floating_point()))
    try:
        model.load_state_dict(weights)
    except RuntimeError as error:
        raise ConfigError(
            f"the checkpoint in {folder} does not fit its config.yaml: "
            + " ".join(str(error).split())[:300]
        ) from None


def _read_config(path: Path) -> Mapping[str, Any]:
    try:
        config = yaml.safe_load(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ConfigError(f"{path.parent} is no run folder: it has no {path.name}") from None
    except (OSError, ValueError, yaml.YAMLError) as error:
        raise ConfigError(f"{path} cannot be read: {' '.join(str(error).split())}") from None
    for part in ("system", "model"):
        if not isinstance(config, dict) or not isinstance(config.get(part), dict):
            raise ConfigError(f"{path} is no configuration of a run: it describes no {part}")
    return config


def _read_weights(path: Path) -> dict[str, torch.Tensor]:
    if not path.exists():
        raise ConfigError(f"{path} does not exist: has the run been trained?")
    try:
        weights = torch.load(path, map_location="cpu", weights_only=True)["state_dict"]
    except Exception as error:  # damaged in any way, or not ours
        reason = next(iter(str(error).splitlines()), "")
        raise ConfigError(f"{path} is no readable checkpoint: {reason}") from None
    if not isinstance(weights, dict) or not any(
        isinstance(value, torch.Tensor) and value.is_floating_point() for value in weights.values()
    ):
        raise ConfigError(f"{path} holds no weights")
    return weights


def _check(node: Any, folder: Path) -> None:
    """Refuse a configuration that would do more than build a system and a model.

    Interpolations could stand for anything; a run's configuration is resolved and has none.
    """
    if isinstance(node, Mapping):
        if "_target_" in node:
            _check_target(node["_target_"], folder)
        node = list(node.values())
    if isinstance(node, str) and "${" in node:
        raise ConfigError(f"{folder} holds an unresolved setting, {node!r}")
    if isinstance(node, list):
        for value in node:
            _check(value, folder)


def _check_target(target: object, folder: Path) -> None:
    """Refuse all but classes of systems and models.

    The name alone proves nothing: ``symo_exp.systems.x.os.system`` begins well, too.
    """
    if isinstance(target, str) and target.startswith(HOMES):
        try:
            made = pkgutil.resolve_name(target)
        except (ImportError, AttributeError, ValueError):
            raise ConfigError(f"{folder} needs {target}, which this version has not") from None
        if isinstance(made, type) and made.__module__.startswith(HOMES):
            return
    raise ConfigError(f"{folder} asks for {target!r}, which is no class of a system or a model")
