"""A learned Lagrangian whose derivatives are well scaled enough for finite differences."""

import torch

from symo_exp.nets.structured_lagrangian import StructuredLagrangian


def learned_lagrangian(angular: tuple[bool, ...], *, width: int = 10) -> StructuredLagrangian:
    """Random weights, float64, and an inertia away from singular."""
    torch.manual_seed(len(angular))
    lagrangian = StructuredLagrangian(angular=angular, width=width, initial_inertia=None).double()
    with torch.no_grad():
        lagrangian.net.biases[-1][: len(angular)] += 1.5
    return lagrangian
