"""All systems of this package, found by looking: one module each."""

from __future__ import annotations

import importlib
import inspect
import pkgutil

import symo_exp.systems
from symo_exp.systems.base import System


def systems() -> dict[str, type[System]]:
    """The concrete ``System`` classes of the modules in ``symo_exp.systems``, by class name."""
    found = {}
    for module in pkgutil.iter_modules(symo_exp.systems.__path__):
        if module.name == "environment":  # it asks for this table
            continue
        members = vars(importlib.import_module(f"symo_exp.systems.{module.name}")).values()
        for kind in members:
            concrete = inspect.isclass(kind) and not inspect.isabstract(kind)
            if concrete and issubclass(kind, System):
                found[kind.__name__] = kind
    return found
