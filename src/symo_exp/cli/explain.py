"""Errors of Hydra as one line with the closest names."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import hydra
from hydra.core.config_loader import ConfigLoader
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

from symo_exp.errors import ConfigError, one_line
from symo_exp.job.checks import closest, unknown_key
from symo_exp.shell import install_command
from symo_exp.shipped import CONF

BAD_INPUT = (
    ConfigError, HydraException, OmegaConfBaseException, YAMLError, RecursionError, ValueError,
)  # fmt: skip
"""What is raised of a command or a file that cannot be."""
EXTRAS = {"submitit": ("submitit_slurm", "cluster"), "optuna": ("optuna", "optuna")}
"""By the beginning of a choice: the choice that is there when its extra is installed, and which."""


def explained(error: BaseException, overrides: Sequence[str]) -> ConfigError:
    """Return the error of a command in terms of the override that caused it."""
    if isinstance(error, ConfigError):
        return error
    if isinstance(error, RecursionError):
        return ConfigError("a file of the configuration refers to itself")
    if isinstance(error, UnicodeDecodeError):
        return ConfigError(f"a file of the configuration is no UTF-8 text: {error}")
    try:
        with hydra.initialize_config_dir(str(CONF), version_base="1.3"):
            loader = GlobalHydra.instance().config_loader()
            return blamed(error, overrides, loader)
    except (HydraException, OmegaConfBaseException):
        return ConfigError(one_line(error))


def blamed(error: BaseException, overrides: Sequence[str], loader: ConfigLoader) -> ConfigError:
    """Return the error of the first override that names no choice or setting, else ``error``."""
    if isinstance(error, ConfigError):
        return error
    try:
        _check(OverridesParser.create().parse_overrides(list(overrides)), loader)
    except ConfigError as found:
        return found
    except (HydraException, OmegaConfBaseException):
        pass  # of that error there is nothing better to say
    return ConfigError(one_line(error))


def _check(overrides: Sequence[Override], loader: ConfigLoader) -> None:
    names = {o.key_or_group for o in overrides}
    groups = {name: [] if "." in name else loader.get_group_options(name) for name in names}
    choices = [o for o in overrides if groups[o.key_or_group] and not o.is_sweep_override()]
    for override in overrides:
        if override.key_or_group == "pair":
            value = str(next(iter(_values(override))))
            model, _, integrator = value.rpartition("_")
            meant = f"model={model or 'NAME'} integrator={integrator or 'NAME'}"
            raise ConfigError(f"pair={value} is not a setting; write {meant}")
        if options := groups[override.key_or_group]:
            for value in _values(override):
                _check_choice(override.key_or_group, value, options)
    known = hydra.compose("config", [str(o.input_line) for o in choices])
    for override in overrides:
        name = override.key_or_group
        new = override.is_add() or override.is_force_add() or override.is_delete()
        if not new and not groups[name] and not name.startswith("hydra"):
            _check_key(name, known, loader.list_groups(""))


def _values(override: Override) -> list[Any]:
    if override.is_sweep_override():
        return [*override.sweep_string_iterator()]
    value = override.value()
    return value if isinstance(value, list) else [value]


def _check_choice(group: str, value: Any, options: Sequence[str]) -> None:
    value = "null" if value is None else str(value)
    for beginning, (needed, extra) in EXTRAS.items():
        if group.startswith("hydra/") and value.startswith(beginning) and needed not in options:
            raise ConfigError(f"{group}={value} needs more: {install_command(extra)}")
    if value in options:
        return
    meant = closest(value, options)
    hint = f"; did you mean {meant[0]}?" if meant else ""
    raise ConfigError(f"{group}={value} is not a choice; possible: {', '.join(options)}{hint}")


def _check_key(name: str, known: DictConfig, groups: Sequence[str]) -> None:
    node: Any = known
    parts = name.split(".")
    for depth, part in enumerate(parts):
        if not isinstance(node, DictConfig) or not (
            part in node or OmegaConf.is_missing(node, part)
        ):
            siblings = [str(key) for key in node] if isinstance(node, DictConfig) else []
            top = list(groups) if depth == 0 else []
            raise unknown_key(".".join(parts[: depth + 1]), siblings + top, _names(known))
        node = None if OmegaConf.is_missing(node, part) else node[part]


def _names(config: DictConfig, path: str = "") -> Iterator[str]:
    """Yield the dotted names of all settings, each where it is written."""
    for key in map(str, config):
        name = f"{path}.{key}" if path else key
        yield name
        if not OmegaConf.is_missing(config, key) and not OmegaConf.is_interpolation(config, key):
            value = config[key]
            if isinstance(value, DictConfig):
                yield from _names(value, name)
