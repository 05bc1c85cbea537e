"""L-NODE: a neural ordinary differential equation through the Euler-Lagrange equations."""

from typing import Literal

from torch import Tensor

from symo_exp.mechanics.explicit import RungeKutta
from symo_exp.mechanics.types import Coordinates
from symo_exp.models.base import DynamicsModel
from symo_exp.models.fields import EulerLagrangeAcceleration
from symo_exp.models.flows import ExplicitFlow
from symo_exp.models.learned import (
    MakesDissipation,
    MakesLagrangian,
    MakesSprings,
    learned_lagrangian,
)
from symo_exp.models.objectives import StateError


class LNODE(DynamicsModel):
    """The Euler-Lagrange equation of a learned Lagrangian in a Runge-Kutta method.

    The equation is ``v̇ = H⁻¹ (B u − Ḣ v + ℒ_q)`` (thesis section 4.3.4). It is trained on the
    error of the next state.

    Args:
        lagrangian: Factory of the Lagrangian.
        dissipation: Factory of its dissipation; without one energy is conserved.
        springs: Factory of springs beside it.
        coordinates: Coordinates of the system.
        input_matrix: ``B`` (n, m) of the generalised force ``F = B u``.
        time_step: Time step [s].
        integrator: Runge-Kutta method of steps.
        rollout_integrator: That of rollouts; the same if left out.
        sensitivity: Whether gradients are those of the step or of the adjoint equation.
        evaluation_dtype: Precision of the copy for evaluation.
    """

    def __init__(
        self,
        lagrangian: MakesLagrangian,
        *,
        coordinates: Coordinates,
        input_matrix: Tensor,
        time_step: float,
        integrator: RungeKutta,
        dissipation: MakesDissipation | None = None,
        springs: MakesSprings | None = None,
        rollout_integrator: RungeKutta | None = None,
        sensitivity: Literal["direct", "adjoint"] = "direct",
        evaluation_dtype: Literal["float32", "float64"] = "float64",
    ) -> None:
        field = EulerLagrangeAcceleration(
            learned_lagrangian(coordinates, lagrangian, dissipation, springs), input_matrix
        )
        super().__init__(
            ExplicitFlow(field, integrator, time_step, sensitivity, rollout_integrator),
            coordinates=coordinates,
            objective=StateError(),
            evaluation_dtype=evaluation_dtype,
        )
