"""The settings in which a run differs from the files that ship."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

from omegaconf import DictConfig, OmegaConf

from symo_exp.job.config import MISSING, Settings, resolve, unresolved
from symo_exp.runs.digest import INCIDENTAL, relevant
from symo_exp.shell import override_value

TOLD = {"seed", "data.n_traj", "data.noise_std", "system.time_step"}
CHOSEN = ("preset", "system", "model", "integrator")
"""Settings and choices of files that tables have columns for."""

Compose = Callable[[list[str]], DictConfig]
"""Overrides to a configuration, Hydra's own part included."""


class Differences(NamedTuple):
    """Differences of a run from its preset, system, model and integrator."""

    choices: list[str]
    settings: list[str]
    told: list[str]
    """Settings that tables have columns for, where they are not the usual ones."""


def variant(found: Differences, settings: Settings, choices: Mapping[str, Any]) -> str:
    """Return the preset and each choice and setting that is not its own.

    It is empty for what ships, and else like ``"fast, optimizer=lbfgs, net.width=8"``.
    """
    preset = choices.get("preset", "default")
    values = dict(relevant(settings.values))
    changed = [
        f"{name}={values[name]:g}" if isinstance(values[name], float) else f"{name}={values[name]}"
        for name in found.settings
    ]
    return ", ".join([*([] if preset == "default" else [str(preset)]), *found.choices, *changed])


def alone(found: Differences, settings: Settings, choices: Mapping[str, Any]) -> list[str]:
    """Return the overrides that repeat a run of a search without the search."""
    chosen = [f"{group}={choices[group]}" for group in CHOSEN if group in choices]
    values = [
        f"{name}={override_value(settings.value(name))}"
        for name in [*found.told, *found.settings, "experiment"]
    ]
    return [*chosen, *found.choices, *values]


def differences(settings: Settings, choices: Mapping[str, Any], compose: Compose) -> Differences:
    """Return the differences of a run; compositions are what takes the time."""
    chosen = [f"{group}={choices[group]}" for group in CHOSEN if group in choices]
    groups = {
        group: choice
        for group, choice in choices.items()
        if isinstance(choice, str) and "/" not in group and group not in INCIDENTAL
    }
    usual = compose(chosen)
    usual_choices = usual.hydra.runtime.choices
    others = [f"{g}={c}" for g, c in sorted(groups.items()) if usual_choices.get(g) != c]
    if others:
        usual = compose([*chosen, *others])
    OmegaConf.set_struct(usual, False)
    required = set(_required(unresolved(usual)))
    given = {name: settings.value(name) for name in TOLD | required}
    given = {name: value for name, value in given.items() if value is not None}
    told = [
        name
        for name in sorted(TOLD & given.keys())
        if name in required or OmegaConf.select(usual, name, default=None) != given[name]
    ]
    for name, value in given.items():
        OmegaConf.update(usual, name, value)
    ours, theirs = dict(relevant(settings.values)), dict(relevant(resolve(usual).values))
    changed = [
        name
        for name, value in sorted(ours.items())
        if name not in TOLD
        and (name in required or theirs.get(name, "nothing") != value)
        and not settings.is_reference(name)
    ]
    return Differences(others, changed, told)


def _required(node: Any, path: str = "") -> Iterator[str]:
    """Yield the dotted names of settings without a default."""
    if node == MISSING:
        yield path
    elif isinstance(node, Mapping):
        for key, value in node.items():
            if key != "hydra":
                yield from _required(value, f"{path}.{key}" if path else str(key))
