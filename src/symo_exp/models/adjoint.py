"""A time step differentiated by the adjoint sensitivity method (thesis section 4.2.2)."""

from torch import Tensor, nn
from torchdiffeq import odeint_adjoint

from symo_exp.models.fields import Field

FIXED_STEP = ("midpoint", "rk4")
"""Methods of which torchdiffeq takes a single step; its other ones choose their steps."""


class _Motion(nn.Module):
    """``d/dt (q, v) = (v, a(q, v, u(t)))`` with a first-order hold of the control."""

    def __init__(self, field: Field, u: Tensor, u_next: Tensor, h: float) -> None:
        super().__init__()
        self._field, self._u, self._rate = field, u, (u_next - u) / h

    def forward(self, t: Tensor, state: tuple[Tensor, Tensor]) -> tuple[Tensor, Tensor]:
        q, v = state
        return v, self._field(q, v, self._u + t * self._rate)


def adjoint_step(
    field: Field, q: Tensor, v: Tensor, u: Tensor, u_next: Tensor, h: float, *, method: str
) -> tuple[Tensor, Tensor]:
    """Return the state after ``h`` by torchdiffeq's fixed-step ``method`` (Chen et al. 2018).

    The gradient solves the adjoint equation with the same method. It is that of the continuous
    problem, inexact for the discrete step; the thesis trains with it.
    """
    motion, times = _Motion(field, u, u_next, h), q.new_tensor([0.0, h])
    trained = tuple(p for p in field.parameters() if p.requires_grad)
    q_nodes, v_nodes = odeint_adjoint(motion, (q, v), times, method=method, adjoint_params=trained)
    return q_nodes[-1], v_nodes[-1]
