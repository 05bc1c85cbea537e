"""A time step differentiated by the adjoint sensitivity method (thesis section 4.2.2)."""

import torch
from torch import Tensor, nn
from torchdiffeq import odeint_adjoint

from symo_exp.models.fields import Field

FIXED_STEP = ("midpoint", "rk4")
"""Methods of which torchdiffeq takes a single step; its other ones choose their steps."""
State = tuple[Tensor, Tensor, Tensor, Tensor]
"""``(q, v, u_k, u_{k+1})``: controls are part of the state, so that they have gradients."""


class _Motion(nn.Module):
    """``d/dt (q, v) = (v, a(q, v, u(t)))`` with a first-order hold of the control."""

    def __init__(self, field: Field, h: float) -> None:
        super().__init__()
        self._field, self._h = field, h

    def forward(self, t: Tensor, state: State) -> State:
        q, v, u, u_next = state
        rate = (u_next - u) / self._h
        still = torch.zeros_like(u)
        return v, self._field(q, v, u + t * rate), still, still


def adjoint_step(
    field: Field, q: Tensor, v: Tensor, u: Tensor, u_next: Tensor, h: float, *, method: str
) -> tuple[Tensor, Tensor]:
    """Return the state after ``h`` by torchdiffeq's fixed-step ``method`` (Chen et al. 2018).

    The gradient solves the adjoint equation with the same method. It is that of the continuous
    problem, inexact for the discrete step; the thesis trains with it.
    """
    times, state = q.new_tensor([0.0, h]), (q, v, u, u_next)
    trained = tuple(p for p in field.parameters() if p.requires_grad)
    q_nodes, v_nodes, *_ = odeint_adjoint(
        _Motion(field, h), state, times, method=method, adjoint_params=trained
    )
    return q_nodes[-1], v_nodes[-1]
