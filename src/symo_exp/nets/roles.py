"""What a parameter is to an optimiser that treats them by what they are."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal

from torch import Tensor

Role = Literal["coefficient", "late"]


def mark(parameters: Iterable[Tensor], role: Role) -> None:
    """Say that parameters are "coefficient"s (physical numbers, not to be drawn to zero) or "late"
    (best left alone until the others have found their place). Their present values are kept."""
    for parameter in parameters:
        vars(parameter)["symo_exp_role"] = role
        vars(parameter)["symo_exp_start"] = parameter.detach().clone()


def is_coefficient(parameter: Tensor) -> bool:
    """Whether a parameter is a physical number."""
    return vars(parameter).get("symo_exp_role") == "coefficient"


def is_late(parameter: Tensor) -> bool:
    """Whether a parameter joins last."""
    return vars(parameter).get("symo_exp_role") == "late"


def start(parameter: Tensor) -> Tensor:
    """The value that a marked parameter had."""
    kept: Tensor = vars(parameter)["symo_exp_start"]
    return kept.to(parameter)
