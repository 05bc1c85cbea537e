"""What a parameter is to an optimiser that treats them by what they are."""

from __future__ import annotations

from collections.abc import Iterable

from torch import Tensor

_ROLE = "symo_exp_role"


def mark(parameters: Iterable[Tensor], role: str) -> None:
    """Say that parameters are "coefficient"s (a physical number, not to be drawn to zero) or
    "late" (best left alone until the others have found their place)."""
    for parameter in parameters:
        setattr(parameter, _ROLE, role)


def is_coefficient(parameter: Tensor) -> bool:
    """Whether a parameter is a physical number."""
    return getattr(parameter, _ROLE, "") == "coefficient"


def is_late(parameter: Tensor) -> bool:
    """Whether a parameter joins last."""
    return getattr(parameter, _ROLE, "") == "late"
