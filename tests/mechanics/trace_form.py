"""The discrete Lagrangian of Lee, Leok and McClamroch (2007), an oracle for a body on a pivot.

The velocity is ``(F − I)/h`` with ``F = R₀ᵀ R₁``, and the potential is taken at the nodes. With
``J_d = ½ tr(J) I − J`` and torques ``M`` in body axes

    p⁻ = vee(F J_d − J_d Fᵀ)/h − h/2 M₀        p⁺ = vee(J_d F − Fᵀ J_d)/h + h/2 M₁
"""

from __future__ import annotations

import torch
from torch import Tensor

from symo_exp.mechanics.lagrangian import matvec
from symo_exp.mechanics.rigid_body import RigidBodyLagrangian
from symo_exp.mechanics.space import cross

ITERATIONS = 5


def momenta(
    body: RigidBodyLagrangian, q0: Tensor, q1: Tensor, h: float, turn: Tensor | None = None
) -> tuple[Tensor, Tensor]:
    """Return ``p⁻`` and ``p⁺`` of an interval, in body axes at its ends; ``turn`` is ``F``."""
    if turn is None:
        turn = q0.unflatten(1, (3, 3)).mT @ q1.unflatten(1, (3, 3))
    inertia = body.mass_matrix(q0)
    trace = inertia.diagonal(dim1=1, dim2=2).sum(1)[:, None, None]
    discrete = 0.5 * trace * torch.eye(3).to(q0) - inertia
    torques = [body.gradients(q, torch.zeros_like(q[:, :3])).q for q in (q0, q1)]
    before = vee(turn @ discrete - discrete @ turn.mT) / h - 0.5 * h * torques[0]
    after = vee(discrete @ turn - turn.mT @ discrete) / h + 0.5 * h * torques[1]
    return before, after


def step(body: RigidBodyLagrangian, q: Tensor, p: Tensor, h: float) -> tuple[Tensor, Tensor]:
    """Return configuration and momentum one step later.

    ``F = (I + [c]) (I − [c])⁻¹`` with ``a + a × c + c (aᵀ c) − 2 J c = 0``, ``a = h (p + h/2 M)``,
    by Newton's method.
    """
    inertia = body.mass_matrix(q)
    a = h * (p + 0.5 * h * body.gradients(q, torch.zeros_like(p)).q)
    c, one = 0.5 * torch.linalg.solve(inertia, a), torch.eye(3).to(q)
    for _ in range(ITERATIONS):
        along = (a * c).sum(1, keepdim=True)
        error = a + torch.linalg.cross(a, c) + c * along - 2.0 * matvec(inertia, c)
        slope = cross(a) + along.unsqueeze(2) * one + c.unsqueeze(2) * a.unsqueeze(1)
        c = c - torch.linalg.solve(slope - 2.0 * inertia, error)
    turn = (one + cross(c)) @ torch.linalg.inv(one - cross(c))
    there = (q.unflatten(1, (3, 3)) @ turn).flatten(1)
    return there, momenta(body, q, there, h, turn)[1]


def vee(x: Tensor) -> Tensor:
    """Return the vector of antisymmetric matrices."""
    return torch.stack((x[:, 2, 1], x[:, 0, 2], x[:, 1, 0]), dim=1)
