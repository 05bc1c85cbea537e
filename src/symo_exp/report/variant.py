"""What a run's settings are beyond what its tables and figures already say of it.

Two runs belong to one cell of a table only if they differ in the seed alone. Everything that a
figure has no axis for is the run's variant: its preset, and each setting that is not the one of
the files that ship.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Mapping
from typing import Any

import yaml

from symo_exp.configuration import CONF
from symo_exp.configuration.references import followed

TOLD = {
    "model", "system", "integrator", "pair", "preset", "seed", "data.n_traj", "data.noise_std",
    "system.time_step",
}  # fmt: skip
"""Settings that are columns of their own."""
INCIDENTAL = (
    "experiment", "output_dir", "pictures", "logger", "study", "resume",
    "data.cache_dir", "trainer.progress", "trainer.checkpoint_every",
)  # fmt: skip
"""Settings, or groups of them, that change no number."""


def variant(parameters: Mapping[str, str]) -> str:
    """``""`` for the defaults, else ``"preset"`` or ``"preset, key=value"`` and so on."""
    preset = parameters.get("preset", "default")
    groups = [name for name in parameters if name in _defaults("config")]
    expected = _expected(tuple(sorted((group, parameters[group]) for group in groups)))
    expected = {name: value for name, value in expected.items() if name in parameters}
    settings = {name: _number(x) for name, x in parameters.items() if name not in groups}
    changed = [
        f"{name}={parameters[name]}"
        for name, value in sorted(followed(expected, settings).items())
        if not _same(parameters[name], value)
    ]
    return ", ".join([*([] if preset == "default" else [preset]), *changed])


@functools.lru_cache(maxsize=1024)
def _expected(choices: tuple[tuple[str, str], ...]) -> dict[str, Any]:
    """The values that follow from the choices of files, those that can be told, by name."""
    chosen = dict(choices)
    values = dict(_flat(_load("config")))
    for group, choice in chosen.items():
        values |= {f"{group}.{name}": x for name, x in _flat(_load(f"{group}/{choice}"))}
    defaults = _defaults("config")
    for group in ("system", "preset"):  # files that set what belongs to others
        path = f"{group}/{chosen.get(group, '')}"
        values |= dict(_flat(_load(path)))
        defaults |= _defaults(path)
    values |= defaults
    return {
        name: value
        for name, value in values.items()
        if name not in TOLD and not name.startswith(INCIDENTAL)
    }


@functools.cache
def _load(path: str) -> dict[str, Any]:
    file = CONF / f"{path}.yaml"
    if not file.is_file():  # of somebody's own, outside of what ships
        return {}
    return yaml.safe_load(file.read_text(encoding="utf-8")) or {}


def _defaults(path: str) -> dict[str, str]:
    """The choices that a file makes: of its own groups, or over those made before it."""
    entries = [e for e in _load(path).get("defaults", []) if isinstance(e, dict)]
    pairs = [
        (str(g).removeprefix("override ").lstrip("/"), c) for e in entries for g, c in e.items()
    ]
    return {group: choice for group, choice in pairs if not group.startswith("hydra")}


def _flat(node: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Dotted names and values, without what belongs to Hydra."""
    for key, value in node.items():
        if key in ("defaults", "hydra", "_partial_"):
            continue
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def _same(told: str, expected: Any) -> bool:
    """MLflow keeps words: ``1e-4`` and ``0.0001``, ``null`` and ``None`` are the same."""
    return told == str(expected) or _number(told) == _number(str(expected))


def _number(word: str) -> float | str:
    try:
        return float(word)
    except ValueError:
        return word
