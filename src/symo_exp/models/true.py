"""The truth as a model: its error is that of the integrator alone, a floor of learning.

Flows of a Lagrangian that is handed in, without an objective. Two classes, since a variational
integrator and a Runge-Kutta method, be they both called midpoint, are different maps with
different floors. ``width`` is that of a net, which a system sets for all models; there is none.
"""

from typing import Any

from symo_exp.mechanics.lagrangian import Lagrangian
from symo_exp.models.base import LagrangianOde, VariationalModel


class TrueVariational(VariationalModel):
    """A given Lagrangian in a variational integrator: what SyMo and E2E-SyMo would best be."""

    def __init__(self, *, lagrangian: Any, width: int | None = None, **base: Any) -> None:
        super().__init__(_of(lagrangian), **base)


class TrueOde(LagrangianOde):
    """A given Lagrangian in a Runge-Kutta method: what L-NODE, and NODE, would best be."""

    def __init__(self, *, lagrangian: Any, width: int | None = None, **base: Any) -> None:
        super().__init__(_of(lagrangian), **base)


def _of(given: Any) -> Lagrangian:
    """A Lagrangian, or that of a system, which knows its friction."""
    found: Lagrangian = getattr(given, "lagrangian", given)
    return found
