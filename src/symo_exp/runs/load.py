"""The trained model and the recordings of a run folder."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
import yaml

from symo_exp import code
from symo_exp.errors import ConfigError, first_line, place_in_code, shortened
from symo_exp.files import UnsoundError, read_state
from symo_exp.models.base import DynamicsModel
from symo_exp.models.inference import leaves_inference_mode
from symo_exp.models.uncertainty import ModelPosterior
from symo_exp.runs import before
from symo_exp.runs.folder import (
    BEST,
    CHECKPOINT,
    CHECKPOINTS,
    CONFIG,
    POSTERIOR,
    PREVIOUS,
    RunFolder,
)
from symo_exp.runs.instances import arguments_of, instance_of

log = logging.getLogger(__name__)

if TYPE_CHECKING:
    from symo_exp.data.base import Splits


@leaves_inference_mode
def from_folder(
    folder: Path, dtype: torch.dtype | None = None, device: str | torch.device = "cpu"
) -> DynamicsModel:
    """Return the model in evaluation mode; ``dtype`` is that of the training unless given."""
    if dtype not in (None, torch.float32, torch.float64):
        raise ConfigError(f"dtype={dtype}: expected torch.float32 or torch.float64")
    require_run(folder)
    config = _read_config(folder / CONFIG)
    plan = before.model_settings(config["model"])
    _check([config["system"], plan], folder)
    system, model = _built(config["system"], plan, folder)
    if model.learns:
        _set_weights(model, folder)
    try:
        model.to(device=device, dtype=dtype)
    except (RuntimeError, AssertionError, TypeError) as error:  # PyTorch without such a device
        raise ConfigError(f"device={device} cannot be used: {first_line(error)}") from None
    model.system = system
    model.posterior = _read_posterior(folder / POSTERIOR)
    model.input_matrix.copy_(system.input_matrix)  # it is not trained: not rounded either
    return model.eval()


def copy_weights(model: DynamicsModel, folder: Path) -> None:
    """Give a model the weights of a run, in the model's own precision.

    Args:
        model: The model.
        folder: Folder of the run, whose model has parameters of the same names and shapes.
    """
    require_run(folder)
    weights = before.model_weights(_read_weights(folder))
    if misfit := _misfit(weights, model):
        raise ConfigError(
            f"{folder} is a run of a model with other parameters: {misfit}; give the settings of "
            "its model"
        )
    model.load_state_dict(weights)


def divided_recordings(run: RunFolder) -> Splits:
    """Return the recordings of a run, divided as its configuration says."""
    config = run.config()
    splits: Splits = instance_of(config["data"], system=instance_of(config["system"])).load()
    return splits


def require_run(folder: Path) -> None:
    """Refuse a folder that is not that of a run; the error names the best run or all runs in it."""
    if (folder / CONFIG).is_file():
        return
    reason = f"it has no {CONFIG}" if folder.is_dir() else "it does not exist"
    if (folder / BEST / CONFIG).is_file():
        reason += f"; it is the folder of a search, whose best run is {folder / BEST}"
    elif runs := sorted(path.parent.name for path in folder.glob(f"*/{CONFIG}")):
        verb = "has" if len(runs) == 1 else "have"
        reason += f", but {shortened(', '.join(runs))} in it {verb} one"
    raise ConfigError(f"{folder} is not a run folder: {reason}")


def _built(
    system: Mapping[str, Any], model: Mapping[str, Any], folder: Path
) -> tuple[Any, DynamicsModel]:
    """Return the system and the model of a configuration, maybe of another version."""
    try:
        found = instance_of(system)
        return found, instance_of(model, **arguments_of(found))
    except ConfigError:  # of another kind, such as a package that is missing
        raise
    except Exception as error:
        raise ConfigError(
            f"{folder / CONFIG} does not fit this version of symo_exp: {first_line(error)}"
            f"{place_in_code(error)}"
        ) from error


def _set_weights(model: DynamicsModel, folder: Path) -> None:
    weights = before.model_weights(_read_weights(folder))
    if misfit := _misfit(weights, model):
        raise ConfigError(f"the checkpoint in {folder} does not fit its config.yaml: {misfit}")
    model.to(next(value.dtype for value in weights.values() if value.is_floating_point()))
    model.load_state_dict(weights)


def _misfit(weights: Mapping[str, torch.Tensor], model: DynamicsModel) -> str:
    """Return the first parameter that stored weights have otherwise than a model, in words."""
    own = model.state_dict()
    for name in sorted(weights.keys() | own.keys()):
        there, here = (tuple(x[name].shape) if name in x else "missing" for x in (weights, own))
        if there != here:
            return f"{name} is {there} there and {here} here"
    return ""


def _read_config(path: Path) -> Mapping[str, Any]:
    try:
        config = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, yaml.YAMLError) as error:
        raise ConfigError(f"{path} cannot be read: {error}") from None
    for part in ("system", "model"):
        if not isinstance(config, dict) or not isinstance(config.get(part), dict):
            raise ConfigError(f"{path} is not the configuration of a run: it has no {part}")
    return config


def _read_posterior(path: Path) -> ModelPosterior | None:
    if not path.exists():
        return None
    try:
        return ModelPosterior.of_state(read_state(path))
    except Exception as error:  # damaged in any way, or not ours
        raise ConfigError(f"{path} is not a readable posterior: {first_line(error)}") from None


def _read_weights(folder: Path) -> dict[str, torch.Tensor]:
    """Return the weights of the last checkpoint, else those of the one before, with a warning."""
    last, previous = folder / CHECKPOINT, folder / CHECKPOINTS / PREVIOUS
    if not last.exists() and not previous.exists():
        raise ConfigError(f"{last} does not exist: has the run been trained?")
    try:
        return _weights_of(last)
    except UnsoundError as error:
        reason = str(error)
    try:
        weights = _weights_of(previous)
    except UnsoundError:
        advice = "resume=false with the command of the run trains it again"
        raise ConfigError(f"{last} is not a readable checkpoint: {reason}; {advice}") from None
    log.warning(
        "%s is not used: %s; this is the model of the checkpoint before, %s, to which the measures "
        "of the run do not belong", last, reason, previous,
    )  # fmt: skip
    return weights


def _weights_of(checkpoint: Path) -> dict[str, torch.Tensor]:
    try:
        state = read_state(checkpoint)
    except FileNotFoundError:
        raise UnsoundError("it does not exist") from None
    except OSError as error:
        raise UnsoundError(f"it cannot be read ({error.strerror})") from None
    weights = state.get("state_dict") if isinstance(state, dict) else None
    if not isinstance(weights, dict) or not any(
        isinstance(value, torch.Tensor) and value.is_floating_point() for value in weights.values()
    ):
        raise UnsoundError("it contains no weights")
    return weights


def _check(node: Any, folder: Path) -> None:
    """Refuse a configuration that would do more than build a system and a model.

    Interpolations could stand for anything; a run's configuration is resolved and has none.
    """
    if isinstance(node, Mapping):
        if "_target_" in node:
            code.locate(node["_target_"], f"{folder}: _target_", code.MODELS)
        node = list(node.values())
    if isinstance(node, str) and "${" in node:
        raise ConfigError(f"{folder} contains an unresolved setting, {node!r}")
    if isinstance(node, list):
        for value in node:
            _check(value, folder)
