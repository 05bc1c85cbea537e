"""Trajectories cut into the samples that the methods learn from."""

from __future__ import annotations

from torch import Tensor

from symo_exp.mechanics.types import Trajectories, Windows


def windows(trajectories: Trajectories) -> Windows:
    """All windows of three consecutive nodes: T nodes give T − 2, one trajectory after another."""
    count = trajectories.q.shape[1] - 2

    def at(field: Tensor, node: int) -> Tensor:
        return field[:, node : node + count].flatten(0, 1)

    q, v, u = trajectories
    return Windows(
        q_prev=at(q, 0),
        q=at(q, 1),
        q_next=at(q, 2),
        v=at(v, 1),
        v_next=at(v, 2),
        u_prev=at(u, 0),
        u=at(u, 1),
        u_next=at(u, 2),
    )
