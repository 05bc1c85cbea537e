"""A residual network: no mechanics and no integrator, a floor of effort."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from symo_exp.mechanics.types import Coordinates, Windows
from symo_exp.models.flows import Flow, Step
from symo_exp.models.learner import Learner
from symo_exp.models.objectives import StateError
from symo_exp.nets.embedding import Embedding
from symo_exp.nets.mlp import MLP


class ResidualFlow(Flow):
    """``(Δq, Δv) = h (v + MLP₁, MLP₂)`` of ``(s(q), v, u, u_next)``: a network for the change."""

    reads_velocity, branch_free, lagrangian = True, True, None

    def __init__(
        self,
        *,
        angular: tuple[bool, ...],
        input_matrix: Tensor,
        time_step: float,
        width: int,
        depth: int,
    ) -> None:
        super().__init__(time_step)
        n, m = input_matrix.shape
        matrix = input_matrix.to(torch.get_default_dtype())
        self.register_buffer("input_matrix", matrix, persistent=False)
        self.embedding = Embedding(angular=angular)
        inputs = self.embedding.size + n + 2 * m
        self.net = MLP(inputs=inputs, outputs=2 * n, width=width, depth=depth)

    def step(self, q: Tensor, v: Tensor, u: Tensor, u_next: Tensor) -> Step:
        h, found = self.time_step, self.net(torch.cat((self.embedding(q).x, v, u, u_next), dim=1))
        drift, kick = found.chunk(2, dim=1)
        converged = torch.ones(q.shape[0], dtype=torch.bool, device=q.device)
        state = q + h * (v + drift), v + h * kick
        return Step(*state, converged, torch.zeros_like(converged, dtype=torch.int64))

    def initial_velocity(self, windows: Windows) -> Tensor:
        return windows.v


class ResidualNetwork(Learner):
    """``x_{k+1} = x_k + h (v + MLP₁, MLP₂)`` of state and controls; trained on the error of the
    next state."""

    def __init__(
        self,
        *,
        coordinates: Coordinates,
        input_matrix: Tensor,
        time_step: float,
        width: int,
        depth: int = 2,
        **base: Any,
    ) -> None:
        flow = ResidualFlow(
            angular=coordinates.angular,
            input_matrix=input_matrix,
            time_step=time_step,
            width=width,
            depth=depth,
        )
        super().__init__(flow, StateError(), coordinates=coordinates, **base)
