"""Systems whose files in ``conf/system`` are complete."""

from __future__ import annotations

import pkgutil
from typing import Any

import yaml

from symo_exp.shipped import CONF
from symo_exp.systems.base import LagrangianSystem


def systems() -> dict[str, type[LagrangianSystem]]:
    """Return the class of each by the name of its file."""
    files = sorted((CONF / "system").glob("*.yaml"))
    names = [file.stem for file in files if "${mechanism:" not in file.read_text("utf-8")]
    kinds = {name: pkgutil.resolve_name(_settings(name)["_target_"]) for name in names}
    return {name: kind for name, kind in kinds.items() if issubclass(kind, LagrangianSystem)}


def system(name: str, **changes: Any) -> LagrangianSystem:
    """Return the system of a file, with some fields changed."""
    settings = _settings(name) | changes
    made: LagrangianSystem = pkgutil.resolve_name(settings.pop("_target_"))(**settings)
    return made


def _settings(name: str) -> dict[str, Any]:
    text = (CONF / "system" / f"{name}.yaml").read_text(encoding="utf-8")
    settings: dict[str, Any] = yaml.safe_load(text)["system"]
    return settings
