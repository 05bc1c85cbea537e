"""Windows of three nodes, the samples that the methods learn from."""

from __future__ import annotations

from collections.abc import Sequence

import torch

from symo_exp.mechanics.types import Trajectory, Windows


def cut_windows(trajectories: Sequence[Trajectory]) -> Windows:
    """Return all windows of three consecutive nodes, T − 2 of a trajectory of T nodes."""
    return Windows(*(torch.cat(fields) for fields in zip(*map(_cut, trajectories), strict=True)))


def _cut(trajectory: Trajectory) -> Windows:
    q, v, u = trajectory
    return Windows(
        q_prev=q[:-2], q=q[1:-1], q_next=q[2:], v=v[1:-1], v_next=v[2:],
        u_prev=u[:-2], u=u[1:-1], u_next=u[2:],
    )  # fmt: skip
