"""What the settings of a run are beyond what tables have columns for; kept with the run."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Set
from typing import Any, NamedTuple

from omegaconf import DictConfig, OmegaConf

from symo_exp.runs.digest import INCIDENTAL, relevant
from symo_exp.shell import override_value

TOLD = {"seed", "data.n_traj", "data.noise_std", "system.time_step"}
CHOSEN = ("preset", "system", "model", "integrator")
"""Settings and choices of files that tables have columns for."""

Compose = Callable[[list[str]], DictConfig]
"""Overrides to a configuration, Hydra's own part included."""


class Differences(NamedTuple):
    """What of a run is not as its preset, system, model and integrator have it."""

    choices: list[str]
    settings: dict[str, Any]
    told: list[str]
    """Settings that tables have columns for, where they are not the usual ones."""


def variant(config: DictConfig, choices: Mapping[str, Any], compose: Compose) -> str:
    """Return the preset and each choice and setting that is not its own.

    It is empty for what ships, and else like ``"fast, optimizer=lbfgs, net.width=8"``.
    """
    found = _differences(config, choices, compose)
    preset = choices.get("preset", "default")
    settings = [
        f"{name}={value:g}" if isinstance(value, float) else f"{name}={value}"
        for name, value in found.settings.items()
    ]
    return ", ".join([*([] if preset == "default" else [str(preset)]), *found.choices, *settings])


def alone(config: DictConfig, choices: Mapping[str, Any], compose: Compose) -> list[str]:
    """Return the overrides that repeat a run of a search without the search."""
    found = _differences(config, choices, compose)
    chosen = [f"{group}={choices[group]}" for group in CHOSEN if group in choices]
    plain = OmegaConf.create(_plain(config))
    values = [
        f"{name}={override_value(_value(plain, name))}"
        for name in [*found.told, *found.settings, "experiment"]
    ]
    return [*chosen, *found.choices, *values]


def _differences(config: DictConfig, choices: Mapping[str, Any], compose: Compose) -> Differences:
    told = [f"{group}={choices[group]}" for group in CHOSEN if group in choices]
    groups = {
        group: choice
        for group, choice in choices.items()
        if isinstance(choice, str) and "/" not in group and group not in INCIDENTAL
    }
    usual = compose(told)
    usual_choices = usual.hydra.runtime.choices
    others = [f"{g}={c}" for g, c in sorted(groups.items()) if usual_choices.get(g) != c]
    if others:
        usual = compose([*told, *others])
    OmegaConf.set_struct(usual, False)
    required = set(_required(OmegaConf.to_container(usual, resolve=False)))
    ours = {name: OmegaConf.select(config, name, default=None) for name in TOLD | required}
    given = {name: value for name, value in ours.items() if value is not None}
    other = [
        name
        for name in sorted(TOLD & given.keys())
        if name in required or OmegaConf.select(usual, name, default=None) != given[name]
    ]
    for name, value in given.items():
        OmegaConf.update(usual, name, value)
    return Differences(others, _changed(config, usual, required), other)


def _required(node: Any, path: str = "") -> Iterator[str]:
    """Yield the dotted names of settings without a default, ``???`` in their files."""
    if node == "???":
        yield path
    elif isinstance(node, Mapping):
        for key, value in node.items():
            if key != "hydra":
                yield from _required(value, f"{path}.{key}" if path else str(key))


def _changed(config: DictConfig, usual: DictConfig, required: Set[str]) -> dict[str, Any]:
    """Return the required settings and those whose values are not the usual ones."""
    ours, theirs = (dict(relevant(_plain(one))) for one in (config, usual))
    return {
        name: value
        for name, value in sorted(ours.items())
        if name not in TOLD
        and (name in required or theirs.get(name, "nothing") != value)
        and not _follows(config, name)
    }


def _value(config: DictConfig, name: str) -> Any:
    value = OmegaConf.select(config, name)
    return OmegaConf.to_object(value) if OmegaConf.is_config(value) else value


def _plain(config: DictConfig) -> dict[str, Any]:
    keys = [key for key in map(str, config) if key != "hydra"]
    values = OmegaConf.to_container(OmegaConf.masked_copy(config, keys), resolve=True)
    assert isinstance(values, dict)
    return {str(key): value for key, value in values.items()}


def _follows(config: DictConfig, name: str) -> bool:
    """Whether a setting, or a node above it, only refers to another, where it is told."""
    parts = name.split(".")
    for depth in range(len(parts)):
        parent = OmegaConf.select(config, ".".join(parts[:depth])) if depth else config
        if isinstance(parent, DictConfig) and OmegaConf.is_interpolation(parent, parts[depth]):
            return True
    return False
