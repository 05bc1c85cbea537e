"""True systems as models: their error is that of the integrator, a floor of learning.

There are two classes because a variational integrator and a Runge-Kutta method are different maps
with different floors, even where both are called midpoint.
"""

from typing import Any, Literal

from torch import Tensor

from symo_exp.mechanics.explicit import RungeKutta
from symo_exp.mechanics.lagrangian import Lagrangian
from symo_exp.mechanics.roots import RootFinder
from symo_exp.mechanics.types import Coordinates
from symo_exp.mechanics.variational import VariationalIntegrator
from symo_exp.models.base import DynamicsModel
from symo_exp.models.fields import EulerLagrangeAcceleration
from symo_exp.models.flows import ExplicitFlow, VariationalFlow


class TrueVariational(DynamicsModel):
    """A given Lagrangian in a variational integrator, the floor of SyMo and E2E-SyMo.

    Args:
        lagrangian: A Lagrangian, or a system with one.
        coordinates: Coordinates of the system.
        input_matrix: ``B`` (n, m) of the generalised force ``F = B u``.
        time_step: Time step [s].
        integrator: Variational integrator.
        root: Root finder of steps.
        evaluation_root: That of the copy for evaluation; ``root`` if left out.
        rollout_root: That of rollouts; ``evaluation_root`` if left out.
        evaluation_dtype: Precision of the copy for evaluation.
    """

    def __init__(
        self,
        lagrangian: Any,
        *,
        coordinates: Coordinates,
        input_matrix: Tensor,
        time_step: float,
        integrator: VariationalIntegrator,
        root: RootFinder,
        evaluation_root: RootFinder | None = None,
        rollout_root: RootFinder | None = None,
        evaluation_dtype: Literal["float32", "float64"] = "float64",
    ) -> None:
        flow = VariationalFlow(
            _of(lagrangian),
            integrator,
            time_step,
            input_matrix,
            root=root,
            evaluation_root=evaluation_root,
            rollout_root=rollout_root,
        )
        super().__init__(flow, coordinates=coordinates, evaluation_dtype=evaluation_dtype)


class TrueOde(DynamicsModel):
    """A given Lagrangian in a Runge-Kutta method, the floor of NODE and L-NODE.

    Args:
        lagrangian: A Lagrangian, or a system with one.
        coordinates: Coordinates of the system.
        input_matrix: ``B`` (n, m) of the generalised force ``F = B u``.
        time_step: Time step [s].
        integrator: Runge-Kutta method of steps.
        rollout_integrator: That of rollouts; the same if left out.
        evaluation_dtype: Precision of the copy for evaluation.
    """

    def __init__(
        self,
        lagrangian: Any,
        *,
        coordinates: Coordinates,
        input_matrix: Tensor,
        time_step: float,
        integrator: RungeKutta,
        rollout_integrator: RungeKutta | None = None,
        evaluation_dtype: Literal["float32", "float64"] = "float64",
    ) -> None:
        field = EulerLagrangeAcceleration(_of(lagrangian), input_matrix)
        super().__init__(
            ExplicitFlow(field, integrator, time_step, rollout_integrator=rollout_integrator),
            coordinates=coordinates,
            evaluation_dtype=evaluation_dtype,
        )


def _of(given: Any) -> Lagrangian:
    """Return a Lagrangian, or that of a system, which includes its friction."""
    found: Lagrangian = getattr(given, "lagrangian", given)
    return found
