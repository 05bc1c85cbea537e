"""A learned Lagrangian whose derivatives are well scaled enough for finite differences."""

from typing import Any

import torch

from symo_exp.nets.structured_lagrangian import StructuredLagrangian


def learned_lagrangian(
    angular: tuple[bool, ...], *, width: int = 10, **kind: Any
) -> StructuredLagrangian:
    """Random weights, float64, and an inertia away from singular."""
    torch.manual_seed(len(angular))
    lagrangian = StructuredLagrangian(
        angular=angular, width=width, initial_inertia=None, **kind
    ).double()
    with torch.no_grad():
        if lagrangian.skip is not None:
            lagrangian.skip += 0.2 * torch.randn_like(lagrangian.skip)
        lagrangian.net.biases[-1][: len(angular)] += 1.5
    return lagrangian
