"""The planner of the examples: its result is a minimum; and the example as it is typed."""

import os
import subprocess
import sys

import pytest
import torch

from examples.planning import HOLD, Planner
from symo_exp.models.flows import Rollout
from tests.pages import ROOT

EXAMPLE = ROOT / "examples" / "swing_up.py"


class Pendulum:
    """A pendulum in units of its own, ``q̈ = u − sin q``, by Euler's symplectic steps."""

    time_step = 0.1
    input_matrix = torch.ones(1, 1, dtype=torch.float64)

    def rollout(self, q, v, u):
        nodes = [(q, v)]
        for k in range(u.shape[1] - 1):
            v = v + self.time_step * (u[:, k] - torch.sin(q))
            q = q + self.time_step * v
            nodes.append((q, v))
        q, v = (torch.stack(x, dim=1) for x in zip(*nodes, strict=True))
        return Rollout(q, v, torch.ones(q.shape[:2], dtype=torch.bool)[:, 1:])

    def linearize(self, q, v, u=None):
        h, bend = self.time_step, torch.cos(q)
        rows = (1 - h * h * bend, h * torch.ones_like(q)), (-h * bend, torch.ones_like(q))
        a = torch.stack([torch.cat(row, dim=-1) for row in rows], dim=-2)
        b = torch.tensor([[h * h], [h]], dtype=torch.float64).expand(*q.shape[:-1], 2, 1)
        return a, b


def planner(limit):
    start, goal, running = torch.tensor([[0.0, 0.0], [1.0, 0.0], [1.0, 0.1]]).double()
    return Planner(Pendulum(), start, goal, steps=40, limit=limit, running=running, effort=0.1)


def cost(planned, u, final):
    """Of inputs from the start, computed apart."""
    u = u.repeat_interleave(HOLD, dim=0)
    path = Pendulum().rollout(
        planned.start[None, :1], planned.start[None, 1:], u[None, [*range(40), 39]]
    )
    off = torch.cat((path.q, path.v), dim=2)[0] - planned.goal
    running = (off[:-1] ** 2 @ planned.running.diagonal()).sum()
    return running + (planned.effort * u**2).sum() + off[-1] @ final @ off[-1]


@pytest.mark.parametrize("limit", [100.0, 1.0])
def test_no_other_input_in_the_limits_costs_less(limit):
    planned, final = planner(limit), torch.diag(torch.tensor([10.0, 10.0])).double()
    found = planned.improve(None, final, 100)
    held = found.u[::HOLD]
    least = cost(planned, held, final)
    torch.testing.assert_close(torch.tensor(found.cost).double(), least)
    assert (held.abs() <= limit).all()
    assert (held.abs() == limit).any() == (limit == 1.0)
    for t in range(len(held)):
        for change in (-0.02, 0.02):
            other = held.clone()
            other[t] = (other[t] + change).clamp(-limit, limit)
            assert cost(planned, other, final) >= least - 1e-9


def test_gains_bring_a_disturbed_motion_back_to_the_plan_and_hold_it():
    planned = planner(100.0)
    hold, value = planned.hold()
    found = planned.improve(None, value, 100)
    x = found.x[0] + torch.tensor([0.2, -0.2])
    for k, gain in enumerate(planned.follow(found, value)):
        u = found.u[k] - gain @ (x - found.x[k])
        path = Pendulum().rollout(x[None, :1], x[None, 1:], u.expand(1, 2, 1))
        x = torch.cat((path.q, path.v), dim=2)[0, 1]
    assert (x - found.x[-1]).norm() < 0.02
    a, b = Pendulum().linearize(planned.goal[:1], planned.goal[1:])
    assert torch.linalg.eigvals(a - b @ hold).abs().max() < 1


@pytest.mark.slow
def test_the_cartpole_swings_up(tmp_path):
    words = ["--system", "cartpole", "--seed", "0", "--animation", "up.webp"]
    done = subprocess.run(
        [sys.executable, str(EXAMPLE), *words], cwd=tmp_path, capture_output=True, text=True,
        env=os.environ,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "cartpole symo seed 0: upright from" in done.stdout.splitlines()[-1]
    assert (tmp_path / "up.webp").stat().st_size > 10_000
