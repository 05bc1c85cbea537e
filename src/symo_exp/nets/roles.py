"""Roles of parameters, by which some optimisers treat them differently."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal

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


def start(parameter: Tensor) -> Tensor:
    """Return the value of a parameter when it was marked."""
    kept: Tensor = vars(parameter)["symo_exp_start"]
    return kept.to(parameter)
