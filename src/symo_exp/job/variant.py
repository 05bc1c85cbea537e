"""The settings in which a run differs from the files that ship."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import hydra
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from symo_exp.job.config import MISSING, Settings, references, resolve, unresolved
from symo_exp.runs.digest import INCIDENTAL, relevant
from symo_exp.shell import override_value

TOLD = {"seed", "data.n_traj", "data.noise_std", "system.time_step"}
CHOSEN = ("preset", "system", "model", "integrator")
"""Settings and choices of files that tables have columns for."""


class Differences(NamedTuple):
    """Differences of a run from its preset, system, model and integrator."""

    values: Settings
    chosen: list[str]
    """Its preset, system, model and integrator, as overrides."""
    choices: list[str]
    """Its other choices of files, as overrides."""
    changed: list[str]
    """Names of settings."""
    told: list[str]
    """Names of settings that tables have columns for, where they are not the usual ones."""

    def variant(self) -> str:
        """Return the preset and each choice and setting that is not its own.

        It is empty for what ships, and else like ``"fast, optimizer=lbfgs, net.width=8"``.
        """
        values = dict(relevant(self.values.values))
        preset = [c.removeprefix("preset=") for c in self.chosen if c.startswith("preset=")]
        changed = [
            f"{name}={x:g}" if isinstance(x := values[name], float) else f"{name}={x}"
            for name in self.changed
        ]
        return ", ".join([*(p for p in preset if p != "default"), *self.choices, *changed])

    def alone(self) -> list[str]:
        """Return the overrides that repeat a run of a search without the search."""
        names = [*self.told, *self.changed, "experiment"]
        values = [f"{name}={override_value(self.values.value(name))}" for name in names]
        return [*self.chosen, *self.choices, *values]


def differences(settings: Settings, choices: Mapping[str, Any]) -> Differences:
    """Return the differences of a run; compositions are what takes the time."""
    groups = {g: c for g, c in choices.items() if isinstance(c, str) and "/" not in g}
    chosen = [f"{group}={groups[group]}" for group in CHOSEN if group in groups]
    usual = _composed(chosen)
    same = {*usual.hydra.runtime.choices.items()}
    others = [f"{g}={c}" for g, c in sorted(groups.items() - same) if g not in INCIDENTAL]
    if others:
        usual = _composed([*chosen, *others])
    OmegaConf.set_struct(usual, False)
    required = set(_required(unresolved(usual)))
    given = {n: x for n in TOLD | required if (x := settings.value(n)) is not None}
    told = [
        name
        for name in sorted(TOLD & given.keys())
        if name in required or OmegaConf.select(usual, name, default=None) != given[name]
    ]
    for name, value in given.items():
        OmegaConf.update(usual, name, value)
    _without_functions(usual, settings)
    ours, theirs = dict(relevant(settings.values)), dict(relevant(resolve(usual).values))
    changed = [
        name
        for name, value in sorted(ours.items())
        if name not in TOLD
        and (name in required or theirs.get(name, "nothing") != value)
        and not settings.is_reference(name)
    ]
    return Differences(settings, chosen, others, changed, told)


def _without_functions(usual: DictConfig, settings: Settings) -> None:
    """Replace references that may not be resolvable.

    A function of ``job.config`` may fail with the values that files alone have. Settings that
    refer to the same as those of the run have its values, as they are not compared; others that
    cannot be resolved have none.
    """
    for name, reference in references(unresolved(usual)):
        if settings.references.get(name) == reference:
            OmegaConf.update(usual, name, settings.value(name))
            continue
        try:
            OmegaConf.select(usual, name)
        except OmegaConfBaseException:
            OmegaConf.update(usual, name, MISSING)


def _composed(overrides: list[str]) -> DictConfig:
    return hydra.compose("config", overrides, return_hydra_config=True)


def _required(node: Any, path: str = "") -> Iterator[str]:
    """Yield the dotted names of settings without a default."""
    if node == MISSING:
        yield path
    elif isinstance(node, Mapping):
        for key, value in node.items():
            if key != "hydra":
                yield from _required(value, f"{path}.{key}" if path else str(key))
