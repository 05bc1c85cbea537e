"""Change of phase space volume along motions; symplectic maps conserve it."""

from __future__ import annotations

from functools import partial

import torch
from jaxtyping import Float
from torch import Tensor

from symo_exp.evaluation.rollouts import along
from symo_exp.mechanics.lagrangian import Lagrangian, jacobian
from symo_exp.models.base import DynamicsModel


def log_volume(
    model: DynamicsModel,
    lagrangian: Lagrangian,
    q: Float[Tensor, "trajectories nodes N"],
    v: Float[Tensor, "trajectories nodes n"],
    u: Float[Tensor, "trajectories nodes m"],
) -> Float[Tensor, "trajectories nodes"]:
    """Return ``log det ∂(q_k, p_k)/∂(q_0, p_0)`` along motions of the model.

    ``p = H(q) v`` is the model's. The result is the logarithm of how a small volume around the
    start, an area for one degree of freedom, has grown until node ``k``: the sum over the steps of
    ``log |det|`` of their derivatives.
    """
    ends = (x.to(model.input_matrix) for x in (q[:, :-1], v[:, :-1], u[:, :-1], u[:, 1:]))
    grown = along(partial(_one_step, model), *ends)
    log_mass = torch.logdet(lagrangian.mass_matrix(q.flatten(0, 1))).view(q.shape[:2])
    steps = grown.cpu() + log_mass.diff(dim=1)
    return torch.cat((torch.zeros_like(log_mass[:, :1]), steps.cumsum(1)), dim=1)


def _one_step(model: DynamicsModel, q: Tensor, v: Tensor, u: Tensor, u_next: Tensor) -> Tensor:
    """``log |det ∂(q', v')/∂(q, v)|`` of one step."""
    space = model.coordinates.space
    with torch.enable_grad():
        state = torch.cat((space.origin(q), v), dim=1).requires_grad_()
        place, velocity = state.chunk(2, dim=1)
        step = model.step(space.point(q, place), velocity, u, u_next)
        after = space.chart(step.q.detach(), step.q)
        derivatives = jacobian(torch.cat((after, step.v), dim=1), state)
    return torch.linalg.slogdet(derivatives).logabsdet
