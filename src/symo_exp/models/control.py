"""Derivatives of a flow, and the control behind a motion."""

from __future__ import annotations

import copy
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from symo_exp.mechanics.lagrangian import jacobian, matvec, solve
from symo_exp.mechanics.roots import relative, rounding
from symo_exp.models.flows import ExplicitFlow, Flow, Step

MOST_UPDATES = 20


class Linear(NamedTuple):
    """``δx_{k+1} = A δx_k + B δu``, the state being ``x = (q, v)``."""

    A: Float[Tensor, "batch 2n 2n"]
    B: Float[Tensor, "batch 2n m"]


def linearize(flow: Flow, q: Tensor, v: Tensor, u: Tensor) -> tuple[Step, Linear]:
    """Return one step under a held control, and its derivatives in state and control.

    This takes one forward pass, and one backward pass for each of the 2n rows. Derivatives are
    ``nan`` where no root was found.
    """
    n, m, space = v.shape[1], u.shape[1], flow.space
    if isinstance(flow, ExplicitFlow):  # derivatives of the step itself, however it is trained
        flow = copy.copy(flow)
        flow.sensitivity = "direct"
    with torch.enable_grad():
        x = torch.cat((space.origin(q), v, u), dim=1).detach().requires_grad_()
        at, v, u = x.split((n, n, m), dim=1)
        step = flow.step(space.point(q.detach(), at), v, u, u)
        by_x = jacobian(torch.cat((space.chart(step.q.detach(), step.q), step.v), dim=1), x)
    by_x = by_x.where(step.converged[:, None, None], torch.nan)
    return Step(*(y.detach() for y in step)), Linear(*by_x.split((2 * n, m), dim=2))


@torch.no_grad()
def inverse_dynamics(flow: Flow, q_prev: Tensor, q: Tensor, q_next: Tensor) -> Tensor:
    """Return the control (batch, m), held over both steps, behind three configurations.

    A motion from ``q_prev`` has a velocity there and a control: ``v`` is such that it passes
    through ``q``, ``u`` such that it comes as near to ``q_next`` as it can, in the units of the
    coordinates. Both follow by the Gauss-Newton method from ``v = (q − q_prev) / h``, ``u = 0``:
    with ``J_v``, ``J_u`` and ``K_v``, ``K_u`` the derivatives of the first and the second
    configuration

        dv = −J_v⁻¹ (r + J_u du)        min ‖s + K_v dv + K_u du‖ over du

    Rows that do not converge are ``nan``.
    """
    (n, m), space = flow.input_matrix.shape, flow.space
    v, u = space.difference(q_prev, q) / flow.time_step, q.new_zeros(len(q), m)
    least = rounding(space.origin(q), flow.sizes)
    still = torch.zeros_like(v)
    for _ in range(MOST_UPDATES if m else 0):
        first, (a, b) = linearize(flow, q_prev, v, u)
        second, (c, d) = linearize(flow, first.q, first.v, u)
        by_v, by_u = c @ a[:, :, n:], c @ b + d
        off = space.difference(first.q, q)
        shift = solve(a[:, :n, n:], off)
        slope = torch.linalg.solve_ex(a[:, :n, n:], b[:, :n])[0]
        to_go = space.difference(second.q, q_next) - matvec(by_v[:, :n], shift)
        reach = relative((by_u[:, :n] - by_v[:, :n] @ slope).mT, flow.sizes).mT
        # Rows that are not finite stay so by ``to_go``; ``pinv`` refuses the batch for one of them.
        inverse = torch.linalg.pinv(reach.nan_to_num(0.0, 0.0, 0.0))
        du = matvec(inverse, relative(to_go, flow.sizes))
        dv = shift - matvec(slope, du)
        u, v = u + du, v + dv
        still = matvec(by_u[:, :n], du).abs() + off.abs()
        if m >= n:  # q_next can be reached: nothing has converged before
            still = still + to_go.abs()
        if not (still > least).any():
            break
    return u.where((still <= 1e3 * least).all(1, keepdim=True), torch.nan)
