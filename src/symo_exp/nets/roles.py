"""Roles of parameters, by which some optimisers treat them differently."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal

import torch
from torch import Tensor

Role = Literal["coefficient", "late"]


def mark(parameters: Iterable[Tensor], role: Role) -> None:
    """Mark parameters as "coefficient" or "late", and store their present values.

    Coefficients are physical numbers and are not shrunk to zero; late parameters are optimised only
    after the others.
    """
    for parameter in parameters:
        vars(parameter)["symo_exp_role"] = role
        vars(parameter)["symo_exp_start"] = parameter.detach().clone()


def is_coefficient(parameter: Tensor) -> bool:
    """Return whether a parameter is a physical number."""
    return vars(parameter).get("symo_exp_role") == "coefficient"


def is_late(parameter: Tensor) -> bool:
    """Return whether a parameter is optimised after the others."""
    return vars(parameter).get("symo_exp_role") == "late"


def mark_squares(parameter: Tensor, entries: Tensor | None = None) -> None:
    """Mark entries of a parameter, all if left out, whose squares the model depends on."""
    chosen = torch.ones_like(parameter, dtype=torch.bool) if entries is None else entries
    vars(parameter)["symo_exp_squares"] = chosen


def are_squares(parameter: Tensor) -> Tensor:
    """Return which entries of a parameter the model depends on by their squares."""
    none = torch.zeros_like(parameter, dtype=torch.bool)
    found: Tensor = vars(parameter).get("symo_exp_squares", none)
    return found


def start(parameter: Tensor) -> Tensor:
    """Return the value of a parameter when it was marked."""
    kept: Tensor = vars(parameter)["symo_exp_start"]
    return kept.to(parameter)
