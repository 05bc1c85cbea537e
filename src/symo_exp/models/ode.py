"""Methods that learn an ordinary differential equation (thesis sections 4.2 and 4.3)."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, Literal

import torch
from jaxtyping import Float
from torch import Tensor

from symo_exp.mechanics.explicit import RungeKutta
from symo_exp.mechanics.types import Windows
from symo_exp.models.adjoint import adjoint_step
from symo_exp.models.base import DynamicsModel, Step


class OdeModel(DynamicsModel):
    """``v̇ = a(q, v, u)`` integrated over one time step by an explicit Runge-Kutta method.

    The residuals of a sample are the errors of pose and velocity at its last node.
    """

    reads_velocity = True

    def __init__(
        self,
        *,
        integrator: RungeKutta,
        sensitivity: Literal["direct", "adjoint"] = "direct",
        **base: Any,
    ) -> None:
        """``sensitivity="adjoint"`` differentiates as the thesis does, by torchdiffeq's adjoint."""
        super().__init__(**base)
        if sensitivity not in ("direct", "adjoint"):
            raise ValueError(f"sensitivity must be direct or adjoint, got {sensitivity}")
        self.integrator, self.sensitivity = integrator, sensitivity

    @property
    def can_be_compiled(self) -> bool:
        return self.sensitivity == "direct"

    @abstractmethod
    def acceleration(
        self,
        q: Float[Tensor, "batch n"],
        v: Float[Tensor, "batch n"],
        u: Float[Tensor, "batch m"],
    ) -> Float[Tensor, "batch n"]:
        """The learned acceleration ``v̇`` at a state and control."""

    def residuals(self, windows: Windows) -> Tensor:
        q, v = self._integrate(windows.q, windows.v, windows.u, windows.u_next)
        return torch.cat((q - windows.q_next, v - windows.v_next), dim=1)

    def initial_velocity(self, windows: Windows) -> Tensor:
        """The measured velocity."""
        return windows.v

    def step(
        self, q: Tensor, v: Tensor, u: Tensor | None = None, u_next: Tensor | None = None
    ) -> Step:
        if u is None:
            u = q.new_zeros(len(q), self.input_matrix.shape[1])
        q_next, v_next = self._integrate(q, v, u, u if u_next is None else u_next)
        explicit = torch.zeros(len(q), dtype=torch.int64, device=q.device)
        return Step(q_next, v_next, torch.ones_like(explicit, dtype=torch.bool), explicit)

    def _integrate(self, q: Tensor, v: Tensor, u: Tensor, u_next: Tensor) -> tuple[Tensor, Tensor]:
        if self.sensitivity == "adjoint" and torch.is_grad_enabled():
            name, h = self.integrator.name, self.time_step
            return adjoint_step(self, self.acceleration, q, v, u, u_next, h, name)
        return self.integrator.step(self.acceleration, q, v, u, u_next, self.time_step)
