"""A residual network without mechanics or an integrator, as a baseline."""

from __future__ import annotations

from typing import Literal

import torch
from torch import Tensor
from typing_extensions import override

from symo_exp.mechanics.scaled import Scale
from symo_exp.mechanics.types import Coordinates
from symo_exp.mechanics.units import SI
from symo_exp.models.base import DynamicsModel
from symo_exp.models.fields import MakesNetwork
from symo_exp.models.flows import Flow, Step
from symo_exp.models.objectives import StateError
from symo_exp.nets.embedding import features_of


class ResidualFlow(Flow):
    """``(Δq, Δv) = h (v + net₁, net₂)`` of ``(s(q), v, u, u_next)``.

    The numbers of the network are in the units of the coordinates.

    Args:
        net: Factory of the network, called with the numbers of its inputs and outputs.
        coordinates: Coordinates of the system.
        input_matrix: ``B`` (n, m) of the generalised force ``F = B u``.
        time_step: Time step [s].
    """

    reads_velocity, branch_free, lagrangian = True, True, None

    def __init__(
        self,
        net: MakesNetwork,
        *,
        coordinates: Coordinates,
        input_matrix: Tensor,
        time_step: float,
    ) -> None:
        super().__init__(time_step)
        n, m = input_matrix.shape
        matrix = input_matrix.to(torch.get_default_dtype())
        self.register_buffer("input_matrix", matrix, persistent=False)
        self.space, self.embedding = coordinates.space, features_of(coordinates)
        self.net = net(inputs=self.embedding.size + n + 2 * m, outputs=2 * n)
        self.scale = None if coordinates.units == SI else Scale(coordinates)

    @override
    def step(self, q: Tensor, v: Tensor, u: Tensor, u_next: Tensor) -> Step:
        h, (place, pace) = self.time_step, (q, v)
        if self.scale is not None:
            place, pace = self.scale.inside(q, v)
            u, u_next = (self.scale.inputs(x, self.input_matrix) for x in (u, u_next))
        found = self.net(torch.cat((self.embedding(place).x, pace, u, u_next), dim=1))
        drift, kick = found.chunk(2, dim=1)
        if self.scale is not None:
            drift, kick = self.scale.outside(drift, 1), self.scale.outside(kick, 2)
        converged = torch.ones(q.shape[0], dtype=torch.bool, device=q.device)
        state = self.space.retract(q, h * (v + drift)), v + h * kick
        return Step(*state, converged, torch.zeros_like(converged, dtype=torch.int64))


class ResidualNetwork(DynamicsModel):
    """A network for the change of the state over a step, trained on the error of the next state.

    Args:
        net: Factory of the network, called with the numbers of its inputs and outputs.
        coordinates: Coordinates of the system.
        input_matrix: ``B`` (n, m) of the generalised force ``F = B u``.
        time_step: Time step [s].
        evaluation_dtype: Precision of the copy for evaluation.
    """

    def __init__(
        self,
        net: MakesNetwork,
        *,
        coordinates: Coordinates,
        input_matrix: Tensor,
        time_step: float,
        evaluation_dtype: Literal["float32", "float64"] = "float64",
    ) -> None:
        flow = ResidualFlow(
            net, coordinates=coordinates, input_matrix=input_matrix, time_step=time_step
        )
        super().__init__(
            flow,
            coordinates=coordinates,
            objective=StateError(),
            evaluation_dtype=evaluation_dtype,
        )
