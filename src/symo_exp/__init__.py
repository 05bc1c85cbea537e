"""Learn the dynamics of mechanical systems from trajectories and compare four ways of doing so."""

from __future__ import annotations

import importlib
import os
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from symo_exp.compile import compile_rollout
    from symo_exp.tracking.load import load
    from symo_exp.use.environments import environment
    from symo_exp.use.export import export
    from symo_exp.use.run import Run, run

_HOMES = {
    "compile_rollout": "symo_exp.compile",
    "Run": "symo_exp.use.run",
    "environment": "symo_exp.use.environments",
    "export": "symo_exp.use.export",
    "run": "symo_exp.use.run",
    "load": "symo_exp.tracking.load",
}
__all__ = ["Run", "__version__", "compile_rollout", "environment", "export", "load", "run"]

if os.environ.get("SYMO_EXP_AVX512") == "1":  # before PyTorch is imported
    from symo_exp.avx512 import use_avx512

    use_avx512()


def __getattr__(name: str) -> Any:
    """Import public names on demand: importing the package must not import PyTorch."""
    if name == "__version__":
        from importlib.metadata import version

        return version("symo_exp")
    if name in _HOMES:
        return getattr(importlib.import_module(_HOMES[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
