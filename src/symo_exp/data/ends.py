"""Motions that end where a coordinate leaves its range."""

from __future__ import annotations

from collections.abc import Sequence

import torch

from symo_exp.data.base import Splits, stacked, usable
from symo_exp.mechanics.types import Trajectories, Trajectory
from symo_exp.systems.box import Range


def ended(splits: Splits, ends: Sequence[Range]) -> tuple[Splits, str]:
    """Return trajectories up to the first node beyond a range, and a line with how many were cut.

    Unforced ones are cut to the common length that keeps the most nodes.

    Args:
        splits: The trajectories.
        ends: Range of each coordinate.

    Raises:
        ConfigError: If no unforced trajectory keeps three nodes.
    """
    given = {"train": splits.train, "val": splits.val, "test": splits.test}
    parts = {name: [_ended(one, ends) for one in part] for name, part in given.items()}
    rollouts = [_ended(one, ends) for one in splits.integration.each()]
    counts = ", ".join(
        f"{sum(len(a.q) < len(b.q) for a, b in zip(part, given[name], strict=True))} of "
        f"{len(part)} {name}"
        for name, part in parts.items()
    )
    kept = _together(usable("integration", rollouts))
    left = len(rollouts) - len(kept.q)
    line = (
        f"motions that a joint limit ends: {counts}; of {len(rollouts)} long rollouts "
        f"{left} left out, the others over {kept.q.shape[1] - 2} steps"
    )
    return Splits(**parts, integration=kept), line


def _ended(trajectory: Trajectory, ends: Sequence[Range]) -> Trajectory:
    low, high = torch.tensor(ends, dtype=trajectory.q.dtype).T
    inside = ((trajectory.q >= low) & (trajectory.q <= high)).all(-1)
    nodes = int(inside.long().cumprod(0).sum())
    return Trajectory(*(field[:nodes] for field in trajectory))


def _together(trajectories: Sequence[Trajectory]) -> Trajectories:
    """Return trajectories of one length, which keeps the most nodes in all."""
    lengths = torch.tensor([len(one.q) for one in trajectories])
    nodes = max(lengths.unique().tolist(), key=lambda x: x * int((lengths >= x).sum()))
    return stacked([one for one in trajectories if len(one.q) >= nodes], nodes)
