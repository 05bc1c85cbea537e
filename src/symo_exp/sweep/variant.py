"""What the settings of a run are beyond what tables have columns for; kept with the run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from omegaconf import DictConfig, OmegaConf

from symo_exp.runs.digest import INCIDENTAL, relevant

TOLD = {"seed", "data.n_traj", "data.noise_std", "system.time_step"}
CHOSEN = ("preset", "system", "model", "integrator")
"""Settings and choices of files that tables have columns for."""

Compose = Callable[[list[str]], DictConfig]
"""Overrides to a configuration, Hydra's own part included."""


def variant(config: DictConfig, choices: Mapping[str, Any], compose: Compose) -> str:
    """``""`` for what ships, else the preset and each choice and setting that is not its:
    ``"fast, optimizer=lbfgs, model.width=8"``."""
    told = [f"{group}={choices[group]}" for group in CHOSEN if group in choices]
    groups = {
        group: choice
        for group, choice in choices.items()
        if isinstance(choice, str) and "/" not in group and group not in {*INCIDENTAL, "pair"}
    }
    usual = compose(told)
    usual_choices = usual.hydra.runtime.choices
    others = [f"{g}={c}" for g, c in sorted(groups.items()) if usual_choices.get(g) != c]
    if others:
        usual = compose([*told, *others])
    OmegaConf.set_struct(usual, False)
    for name in TOLD:
        value = OmegaConf.select(config, name, default=None)
        if value is not None:
            OmegaConf.update(usual, name, value)
    preset = choices.get("preset", "default")
    return ", ".join(
        [*([] if preset == "default" else [str(preset)]), *others, *_changed(config, usual)]
    )


def _changed(config: DictConfig, usual: DictConfig) -> list[str]:
    """The settings whose values are not the usual ones, each where it is written."""
    ours, theirs = (dict(relevant(_plain(one))) for one in (config, usual))
    return [
        f"{name}={value:g}" if isinstance(value, float) else f"{name}={value}"
        for name, value in sorted(ours.items())
        if name not in TOLD and theirs.get(name, "nothing") != value and not _follows(config, name)
    ]


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
