"""Learn the dynamics of mechanical systems from trajectories and compare four ways of doing so."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from symo_exp.trained import load

__all__ = ["load"]


def __getattr__(name: str) -> Any:
    """``symo_exp.load`` on demand: importing the package must not import PyTorch."""
    if name == "load":
        from symo_exp.trained import load

        return load
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
