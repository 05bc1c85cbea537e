"""One time step differentiated by the adjoint sensitivity method (thesis section 4.2.2)."""

from jaxtyping import Float
from torch import Tensor, nn
from torchdiffeq import odeint_adjoint

from symo_exp.mechanics.explicit import Acceleration


class _Field(nn.Module):
    """``d/dt (q, v) = (v, a(q, v, u(t)))`` with a first-order hold of the control."""

    def __init__(self, acceleration: Acceleration, u: Tensor, u_next: Tensor, h: float) -> None:
        super().__init__()
        self._acceleration, self._u, self._rate = acceleration, u, (u_next - u) / h

    def forward(self, t: Tensor, state: tuple[Tensor, Tensor]) -> tuple[Tensor, Tensor]:
        q, v = state
        return v, self._acceleration(q, v, self._u + t * self._rate)


def adjoint_step(
    model: nn.Module,
    acceleration: Acceleration,
    q: Float[Tensor, "batch n"],
    v: Float[Tensor, "batch n"],
    u: Float[Tensor, "batch m"],
    u_next: Float[Tensor, "batch m"],
    h: float,
    method: str,
) -> tuple[Float[Tensor, "batch n"], Float[Tensor, "batch n"]]:
    """The state after ``h`` by torchdiffeq's fixed-step ``method`` (Chen et al. 2018).

    The gradient solves the adjoint equation with the same method, so it is that of the
    continuous problem: inexact for the discrete step, but what the thesis trains with.
    """
    field = _Field(acceleration, u, u_next, h)
    times = q.new_tensor([0.0, h])
    parameters = tuple(p for p in model.parameters() if p.requires_grad)
    poses, velocities = odeint_adjoint(
        field, (q, v), times, method=method, adjoint_params=parameters
    )
    return poses[-1], velocities[-1]
