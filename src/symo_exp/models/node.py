"""NODE: a neural ordinary differential equation of second order (thesis section 4.3.1)."""

from typing import Literal

from torch import Tensor

from symo_exp.mechanics.explicit import RungeKutta
from symo_exp.mechanics.types import Coordinates
from symo_exp.models.base import DynamicsModel
from symo_exp.models.fields import MakesNetwork, NetworkAcceleration
from symo_exp.models.flows import ExplicitFlow
from symo_exp.models.objectives import StateError


class NODE(DynamicsModel):
    """The equation ``v̇ = net(s(q), v, u)`` in a Runge-Kutta method.

    It is trained on the error of the next state.

    Args:
        net: Factory of the network, called with the numbers of its inputs and outputs.
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
        net: MakesNetwork,
        *,
        coordinates: Coordinates,
        input_matrix: Tensor,
        time_step: float,
        integrator: RungeKutta,
        rollout_integrator: RungeKutta | None = None,
        sensitivity: Literal["direct", "adjoint"] = "direct",
        evaluation_dtype: Literal["float32", "float64"] = "float64",
    ) -> None:
        field = NetworkAcceleration(net, coordinates=coordinates, input_matrix=input_matrix)
        super().__init__(
            ExplicitFlow(field, integrator, time_step, sensitivity, rollout_integrator),
            coordinates=coordinates,
            objective=StateError(),
            evaluation_dtype=evaluation_dtype,
        )
