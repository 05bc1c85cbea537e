"""The settings in which a run differs from the files that ship."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any, NamedTuple

import hydra
from hydra.core.global_hydra import GlobalHydra

from symo_exp.job.config import Settings, references, unresolved
from symo_exp.runs.digest import INCIDENTAL, relevant
from symo_exp.shell import override_value, text_value

TOLD = {"seed", "data.n_traj", "data.noise_std", "system.time_step"}
CHOSEN = ("preset", "system", "model", "integrator")
"""Settings and choices of files that tables have columns for."""


class Differences(NamedTuple):
    """Differences of a run from its preset, system, model and integrator."""

    variant: str
    """The preset and each choice and setting that is not its own.

    It is empty for what ships, and else like ``"fast, optimizer=lbfgs, net.width=8"``.
    """
    words: list[str]
    """Overrides that repeat a run of a search without the search."""


def differences(settings: Settings, choices: Mapping[str, Any]) -> Differences:
    """Return the differences of a run."""
    groups = {g: c for g, c in choices.items() if isinstance(c, str) and "/" not in g}
    chosen = [f"{group}={groups[group]}" for group in CHOSEN if group in groups]
    usual, _ = _shipped(*chosen)
    others = [f"{g}={c}" for g, c in sorted(groups.items() - usual.items()) if g not in INCIDENTAL]
    _, files = _shipped(*chosen, *others)
    theirs = dict(relevant(files)) | {n: settings.value(other) for n, other in references(files)}
    ours = dict(relevant(settings.values))
    different = [
        name
        for name in sorted(ours)
        if theirs.get(name, "nothing") != ours[name] and not settings.is_reference(name)
    ]
    changed = [name for name in different if name not in TOLD]
    preset = groups.get("preset", "default")
    variant = [preset] * (preset != "default") + others
    variant += [
        f"{name}={f'{x:g}' if isinstance(x := ours[name], float) else override_value(x)}"
        for name in changed
    ]
    code = ["code"] * (settings.values["code"] is not None)
    names = [*(n for n in different if n in TOLD), *changed, *code, "experiment"]
    values = ((name, settings.value(name)) for name in names)
    words = [f"{n}={text_value(x) if isinstance(x, str) else override_value(x)}" for n, x in values]
    return Differences(", ".join(variant), [*chosen, *others, *words])


def _shipped(*choices: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the choices and the unresolved settings of files alone."""
    sources = GlobalHydra.instance().config_loader().get_sources()
    return _composed(choices, tuple(source.path for source in sources))


@lru_cache(maxsize=64)
def _composed(choices: tuple[str, ...], _: tuple[str, ...]) -> tuple[dict[str, Any], Any]:
    """Compose, which takes a second; runs of a search have few combinations of choices."""
    values = unresolved(hydra.compose("config", list(choices), return_hydra_config=True))
    return values.pop("hydra")["runtime"]["choices"], values
