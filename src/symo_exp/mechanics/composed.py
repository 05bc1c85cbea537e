"""The midpoint rule in equal parts of a time step (Marsden and West 2001, section 2.5.1).

The motion over a time step is piecewise linear, with a corner where two parts meet. The discrete
Lagrangian is stationary in these corners, so that each part is a step of the midpoint rule:

    L_d(q₀, q₁) = ext_x  Σᵢ L_mid(xᵢ₋₁, xᵢ)        x₀ = q₀, x_s = q₁, in steps of h/s

It is a Galerkin integrator (``mechanics.galerkin``) with hat functions as bubbles and the middles
of the parts as points.
"""

from __future__ import annotations

import torch
from typing_extensions import override

from symo_exp.checks import whole_number
from symo_exp.mechanics.galerkin import MOST_UPDATES, TOLERANCE, Basis, GalerkinIntegrator
from symo_exp.mechanics.variational import VariationalIntegrator, VariationalMidpoint


class ComposedMidpoint(GalerkinIntegrator):
    """The midpoint rule in ``parts`` equal parts of each time step, order 2.

    Args:
        parts: Number of parts.
        tolerance: Bound on the last update of the corners, relative to the displacement.
        max_iterations: Bound on the number of updates.
    """

    def __init__(
        self, *, parts: int, tolerance: float = TOLERANCE, max_iterations: int = MOST_UPDATES
    ) -> None:
        super().__init__(hats(whole_number("parts", parts)), tolerance, max_iterations)


class RefinedMidpoint(VariationalMidpoint):
    """The midpoint rule in training, and in ``parts`` equal parts of each time step in predictions.

    Where dry friction stops a machine, velocities of the midpoint rule alternate about zero instead
    of vanishing, if the time step is long. Recorded configurations have no such motion, so that the
    parameters learned are right, and predictions need the shorter steps only.

    Args:
        parts: Number of parts.
    """

    has_geodesic = False

    def __init__(self, *, parts: int) -> None:
        self._parts = whole_number("parts", parts)

    @override
    def of_rollouts(self) -> VariationalIntegrator:
        return ComposedMidpoint(parts=self._parts)


def hats(parts: int) -> Basis:
    """Return hat functions as bubbles, with the middles of equal parts of the interval."""
    part = torch.arange(parts, dtype=torch.float64)
    corner = part[1:].unsqueeze(-1)
    rises, falls = (part == corner - 1).double(), (part == corner).double()
    tau, b = (part + 0.5) / parts, torch.full_like(part, 1.0 / parts)
    return Basis(tau, b, 0.5 * (rises + falls), parts * (rises - falls), order=2)
