"""The configuration of a run as plain values, and the functions that its files may call."""

from __future__ import annotations

from typing import Any

from omegaconf import DictConfig, OmegaConf

from symo_exp.errors import ConfigError
from symo_exp.runs.digest import digest


def plain(config: DictConfig) -> dict[str, Any]:
    """The configuration with every reference resolved."""
    values = OmegaConf.to_container(config, resolve=True, throw_on_missing=True)
    assert isinstance(values, dict)
    return {str(key): value for key, value in values.items() if key != "hydra"}


def run_folder(*, _root_: DictConfig) -> str:
    """The name of a run's folder: what was run, and a digest of what shapes its result."""
    choices = _root_.hydra.runtime.choices
    nodes = {str(key): value for key, value in _root_.items() if key != "hydra"}
    values: Any = {
        key: OmegaConf.to_container(value, resolve=True) if OmegaConf.is_config(value) else value
        for key, value in nodes.items()
    }
    return f"{choices.model}-{choices.system}-{digest(values)}"


def recorded_columns(kind: str, *, _root_: DictConfig) -> list[str]:
    """The names of a recording's coordinates ("q") or inputs ("u"), none without a recording.

    So the configuration of a run is whole, and a trained model is loaded without its data."""
    from symo_exp.data.header import header, names

    data = _root_.data
    if "path" not in data:
        return []
    return list(names(kind, header(data.path, data.get("columns"))))


def mechanism(kind: str, name: str | None) -> dict[str, Any]:
    """What a MuJoCo model says: that of a file ("model") or of a Gymnasium environment ("id").

    It is part of the configuration for the same reason: a run needs neither file nor MuJoCo."""
    from symo_exp.systems import mujoco

    if name is None:
        raise ConfigError("system.model has no value yet; give it one: system.model=robot.xml")
    return mujoco.read_mechanism(name) if kind == "model" else mujoco.environment_mechanism(name)


OmegaConf.register_new_resolver("mechanism", mechanism, replace=True)
OmegaConf.register_new_resolver("run_folder", run_folder, replace=True)
OmegaConf.register_new_resolver("recorded_columns", recorded_columns, replace=True)
OmegaConf.register_new_resolver(
    "if", lambda condition, then, otherwise: then if condition else otherwise, replace=True
)
