"""The configuration of a run as plain values, and the functions that its files may call."""

from __future__ import annotations

import os
import re
from collections.abc import Collection, Iterator, Mapping
from typing import Any, NamedTuple

from omegaconf import DictConfig, OmegaConf

from symo_exp.errors import ConfigError
from symo_exp.runs.digest import INCIDENTAL, digest

PARTS = "system", "data", "model", "learner", "trainer", "logger"
"""The groups whose classes a run instantiates."""
_ROOTS = {*PARTS, *INCIDENTAL, "seed", "dtype", "start_from"}
"""Settings that the program reads; others have an effect where one of these refers to them."""


class Settings(NamedTuple):
    """The settings of a run, resolved once."""

    values: dict[str, Any]
    """Plain values."""
    references: dict[str, str]
    """By dotted name, of settings that refer to another: the name of that one."""

    def is_reference(self, name: str) -> bool:
        """Return whether a setting, or a node above it, only refers to another."""
        return _is_below(name, self.references)

    def is_read(self, name: str, idle: Collection[str] = ()) -> bool:
        """Return whether a run reads a setting, or any below it, itself or by a reference.

        Args:
            name: Its dotted name.
            idle: Dotted names of settings that have no effect in this run.
        """
        read: set[str] = set()
        found = set(_ROOTS)
        while found - read:
            read |= found
            there = [one for one in self.references if _is_below(one, read)]
            inside = [self.references[one] for one in there if not _is_below(one, idle)]
            found = {word for text in inside for word in re.findall(r"[\w.]+", text)}
        if _is_below(name, idle):
            return False
        return _is_below(name, read) or any(one.startswith(f"{name}.") for one in read)

    def value(self, name: str) -> Any:
        """Return the value of a dotted name, ``None`` where there is none."""
        node: Any = self.values
        for part in name.split("."):
            node = node.get(part) if isinstance(node, Mapping) else None
        return node


def resolve(config: DictConfig) -> Settings:
    """Resolve all but Hydra's own part; a setting without a value is OmegaConf's ``MISSING``."""
    ours = OmegaConf.masked_copy(config, [key for key in map(str, config) if key != "hydra"])
    values: Any = OmegaConf.to_container(ours, resolve=True)
    return Settings(values, dict(references(unresolved(ours))))


def unresolved(config: DictConfig) -> Any:
    """Return a configuration as its files have it, references included."""
    return OmegaConf.to_container(config, resolve=False)


def references(node: Mapping[Any, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Yield the dotted names of settings that refer to others, as ``${NAME}``, and ``NAME``."""
    for key, value in node.items():
        if isinstance(value, str) and "${" in value:
            yield f"{prefix}{key}", value.removeprefix("${").removesuffix("}")
        elif isinstance(value, Mapping):
            yield from references(value, f"{prefix}{key}.")
        elif isinstance(value, list):
            yield from references(dict(enumerate(value)), f"{prefix}{key}.")


def _is_below(name: str, others: Collection[str]) -> bool:
    """Return whether a dotted name is one of others, or that of a node below one of them."""
    return any(f"{name}.".startswith(f"{one}.") for one in others)


def run_folder(*, _root_: DictConfig) -> str:
    """Return the name of a run's folder: method, system and a digest of its settings."""
    choices = _root_.hydra.runtime.choices
    values: Any = {
        key: OmegaConf.to_container(value, resolve=True) if OmegaConf.is_config(value) else value
        for key, value in _root_.items()
        if key != "hydra"
    }
    return f"{choices.model}-{choices.system}-{digest(values)}"


def recorded_columns(kind: str, *, _root_: DictConfig) -> list[str]:
    """Return the names of a recording's coordinates ("q") or inputs ("u").

    They are part of the configuration, so that a trained model is loaded without its data.
    """
    from symo_exp.data.header import header
    from symo_exp.data.naming import names

    data = _root_.data
    if "path" not in data:
        return []
    return list(names(kind, header(data.path, data.get("columns"))))


def mechanism(kind: str, name: str | None) -> dict[str, Any]:
    """Return the description of a MuJoCo file ("model") or Gymnasium environment ("id").

    It is part of the configuration, so that a run needs neither the file nor MuJoCo.
    """
    from symo_exp.systems import mujoco

    if name is None:
        raise ConfigError("system.model has no value yet; give it one: system.model=robot.xml")
    return mujoco.read_mechanism(name) if kind == "model" else mujoco.environment_mechanism(name)


OmegaConf.register_new_resolver("expanded", lambda x: os.path.expanduser(str(x)), replace=True)
OmegaConf.register_new_resolver("mechanism", mechanism, replace=True)
OmegaConf.register_new_resolver("run_folder", run_folder, replace=True)
OmegaConf.register_new_resolver("recorded_columns", recorded_columns, replace=True)
OmegaConf.register_new_resolver(
    "if", lambda condition, then, otherwise: then if condition else otherwise, replace=True
)
