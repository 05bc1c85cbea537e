"""Samples that the methods learn from: windows of three nodes, or stretches of many."""

from __future__ import annotations

from collections.abc import Sequence

import torch

from symo_exp.mechanics.types import Stretches, Trajectory, Windows

NODES = 3
"""Nodes of a window; shorter trajectories have none."""


def cut_windows(trajectories: Sequence[Trajectory]) -> Windows:
    """Return all windows of three consecutive nodes, T − 2 of a trajectory of T nodes."""
    return Windows(*(torch.cat(fields) for fields in zip(*map(_cut, trajectories), strict=True)))


def _cut(trajectory: Trajectory) -> Windows:
    q, v, u = trajectory
    return Windows(
        q_prev=q[:-2], q=q[1:-1], q_next=q[2:], v=v[1:-1], v_next=v[2:],
        u_prev=u[:-2], u=u[1:-1], u_next=u[2:],
    )  # fmt: skip


def cut_stretches(trajectories: Sequence[Trajectory], steps: int, stride: int) -> Stretches:
    """Return stretches of so many steps, which begin every ``stride`` nodes of each trajectory.

    Trajectories that are shorter have none.
    """
    long = [one for one in trajectories if len(one.q) > steps]
    first = trajectories[0]
    none = [x.new_empty(0, steps + 1, x.shape[1]) for x in (first.q, first.u)]
    each = [[x.unfold(0, steps + 1, stride).mT for x in (one.q, one.u)] for one in long]
    q, u = (torch.cat(parts) for parts in zip(none, *each, strict=True))
    n = first.v.shape[1]
    unknown, ones = q.new_full((len(q), 2 * n), torch.nan), q.new_ones(*q.shape[:2], n)
    return Stretches(q, u, unknown, ones)
