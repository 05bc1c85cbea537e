"""Rigid bodies: published data as tables, and the errors of trained models on them.

python results/rigid/rigid.py simulate liefvin.npz
python results/rigid/rigid.py convert liefvin.npz liefvin.parquet
python results/rigid/rigid.py errors outputs/liefvin liefvin.npz --nodes 10
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
import torch
from scipy.integrate import solve_ivp
from torch import Tensor

import symo_exp
from symo_exp.mechanics.space import Space, quaternion, rotation_vector

FLAT = {13: 0, 22: 3}
"""Positions of a row of the pendulum (R, ω, u) and of the quadrotor (x, R, v, ω, u)."""
HELD_OUT = 8
"""Every so many-th motion of the training data is for validation."""
GROUND = 0.03
"""Height below which a quadrotor touches the ground [m]; such motions are left out."""


class Motions(NamedTuple):
    """Recorded motions; velocities of positions are in world axes."""

    x: Tensor
    """(motions, nodes, 0 or 3) positions [m]."""
    turn: Tensor
    """(motions, nodes, 3, 3) rotations."""
    v: Tensor
    """(motions, nodes, 0 or 3) velocities [m/s]."""
    w: Tensor
    """(motions, nodes, 3) body rates [rad/s]."""
    u: Tensor
    """(motions, nodes, m) inputs: a torque [N m], or a thrust [N] and three torques [mN m]."""


def simulate(target: Path) -> None:
    """Write motions of LieFVIN's pendulum, in the layout of SE3HamDL's arrays.

    ``θ̈ = −15 sin θ + 3 u``, 20 nodes with h = 0.02 s, from θ within ±π and θ̇ within ±1 rad/s, five
    constant torques each; 64 starts to train and 64 to test.
    """
    draw, t = np.random.default_rng(0), 0.02 * np.arange(20)
    arrays = {}
    for name in ("x", "test_x"):
        starts = draw.uniform([-np.pi, -1.0], [np.pi, 1.0], (64, 2))
        arrays[name] = np.array(
            [[_pendulum(t, start, u) for start in starts] for u in (0.0, -1.0, 1.0, -2.0, 2.0)]
        ).transpose(0, 2, 1, 3)
    np.savez(target, t=t, **arrays)


def _pendulum(t: np.ndarray, start: np.ndarray, u: float) -> np.ndarray:
    def slope(_: float, y: np.ndarray) -> tuple[float, float]:
        return y[1], -15.0 * np.sin(y[0]) + 3.0 * u

    found = solve_ivp(slope, t[[0, -1]], start, "DOP853", t, rtol=1e-12, atol=1e-12)
    theta, rate = found.y
    zero, one, c, s = 0.0 * t, 1.0 + 0.0 * t, np.cos(theta), np.sin(theta)
    return np.stack((c, -s, zero, s, c, zero, zero, zero, one, zero, zero, rate, u * one), axis=1)


def read(source: Path) -> tuple[dict[str, Motions], float]:
    """Return the motions of an archive by part, train, val and test, and the time step [s]."""
    arrays = np.load(source)
    t = arrays["t"]
    found = {}
    for name, part in (("x", "train"), ("test_x", "test")):
        inputs, nodes, motions, width = arrays[name].shape
        flat = FLAT[width]
        rows = torch.tensor(arrays[name].transpose(0, 2, 1, 3).reshape(-1, nodes, width))
        sizes = (flat, 9, flat, 3, width - 12 - 2 * flat)
        x, turn, v, w, u = rows.split(sizes, dim=-1)
        turn = turn.unflatten(-1, (3, 3))
        if flat:
            v = (turn @ v.unsqueeze(-1)).squeeze(-1)
            u = torch.cat((u[..., :1], 1e3 * u[..., 1:]), dim=-1)
        which = torch.arange(inputs * motions)
        on = x[..., 2].amin(1) >= GROUND if flat else which >= 0
        held = (which % HELD_OUT == 0) & (part == "train")
        parts = {part: on & ~held} | ({"val": on & held} if part == "train" else {})
        for each, mask in parts.items():
            found[each] = Motions(*(y[mask] for y in (x, turn, v, w, u)))
    return found, float(t[1] - t[0])


def convert(source: Path, target: Path) -> None:
    """Write an archive as a table of recordings."""
    found, h = read(source)
    parts = []
    for part, motions in found.items():
        x, turn, v, w, u = motions
        q = quaternion(turn)
        if x.shape[-1]:
            u = wrench(u, w, h)
        for k in range(len(x)):
            columns = {"trajectory": f"{part}{k}", "split": part, "t": h * np.arange(x.shape[1])}
            columns |= {f"q_{a}": y for a, y in zip("xyz", x[k].T, strict=False)}
            columns |= {f"q_R_{a}": y for a, y in zip("wxyz", q[k].T, strict=True)}
            columns |= {f"v_{a}": y for a, y in zip("xyz", v[k].T, strict=False)}
            columns |= {f"v_R_{a}": y for a, y in zip("xyz", w[k].T, strict=True)}
            columns |= {f"u_{i}": y for i, y in enumerate(u[k].T)}
            parts.append(pd.DataFrame(columns))
    pd.concat(parts).to_parquet(target, index=False)
    print(f"{target}: {len(parts)} motions, a node every {h:.6g} s")


def wrench(u: Tensor, w: Tensor, h: float) -> Tensor:
    """Return a quadrotor's force [N] and torque [mN m] in the body axes of each node.

    PyBullet turns them with the attitude of the node before, ``R exp(−h ω)``.
    """
    turn = _rotation(-h * w)
    force = turn[..., 2] * u[..., :1]
    return torch.cat((force, (turn @ u[..., 1:].unsqueeze(-1)).squeeze(-1)), dim=-1)


def _rotation(phi: Tensor) -> Tensor:
    return Space(rotations=1).of_vector(phi).unflatten(-1, (3, 3))


def errors(folder: Path, source: Path, nodes: int) -> None:
    """Print the error of each run in a folder on the validation and the test motions."""
    found, h = read(source)
    for run in sorted(path.parent for path in folder.glob("*/config.yaml")):
        model = symo_exp.load(run).for_evaluation()
        of = quadrotor_errors if found["test"].x.shape[-1] else pendulum_errors
        means = {part: of(model, found[part], h, nodes).mean(0) for part in ("val", "test")}
        parts = (f"{part} {float(x.sum()):.3g} ({', '.join(f'{y:.2g}' for y in x)})"
                 for part, x in means.items())  # fmt: skip
        print(run.name, *parts)


def pendulum_errors(
    model: symo_exp.DynamicsModel, motions: Motions, _: float, nodes: int
) -> Tensor:
    """Return the errors of rates and input, and of the rotation, (windows, 2).

    Those of LieFVIN and SE3HamDL: over windows, each from the recorded rotation and body rates of
    its first node, the mean squared error of rates and input (four numbers, the input without an
    error) and the mean squared angle.
    """
    turn, w, u = (
        y.unfold(1, nodes, 1).movedim(-1, 2).flatten(0, 1)
        for y in (motions.turn.flatten(2), motions.w, motions.u)
    )
    path = model.rollout(turn[:, 0], w[:, 0], u)
    rate = (path.v - w)[:, 1:].square().sum(-1).mean(1) / 4
    start, end = turn.unflatten(-1, (3, 3)), path.q.unflatten(-1, (3, 3))
    turned = rotation_vector(start.mT @ end)[:, 1:].square().sum(-1)
    return torch.stack((rate, turned.mean(1)), dim=1)


def quadrotor_errors(
    model: symo_exp.DynamicsModel, motions: Motions, h: float, nodes: int
) -> Tensor:
    """Return the errors of position, velocity, body rates and rotation, (motions, 4).

    Those of SE3HamDL: from the recorded state of the first node, mean squared errors over three
    components each, velocities in body axes, and the mean squared angle. Recorded velocities are
    differences backwards: the state is a pair of configurations.
    """
    x, turn, v, w, u = (y[:, :nodes] for y in motions)
    flow, at, rate = model.flow, torch.cat((x[:, 0], turn[:, 0].flatten(1)), dim=1), w[:, 0]
    last = torch.cat((x[:, 0] - h * v[:, 0], (turn[:, 0] @ _rotation(-h * rate)).flatten(1)), dim=1)
    errors = []
    for k in range(1, nodes):
        control = wrench(u[:, 0], rate, h)  # also for the next node, to second order in h
        start = flow.decode(at, flow.discrete.momentum(last, at, flow.forces(control, control)))
        both = control.unsqueeze(1).expand(-1, 2, -1)
        last, at = at, model.rollout(at, start, both).q[:, 1]
        step = flow.space.difference(last, at) / h
        velocity, rate = step[:, :3], step[:, 3:]
        now = at[:, 3:].unflatten(-1, (3, 3))
        in_body = _in_body(now, velocity) - _in_body(turn[:, k], v[:, k])
        apart = (at[:, :3] - x[:, k], in_body, rate - w[:, k])
        squares = [y.square().mean(1) for y in apart]
        turned = rotation_vector(turn[:, k].mT @ now).square().sum(-1)
        errors.append(torch.stack((*squares, turned), dim=1))
    return torch.stack(errors).mean(0)


def _in_body(turn: Tensor, v: Tensor) -> Tensor:
    return (v.unsqueeze(-2) @ turn).squeeze(-2)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("what", choices=["simulate", "convert", "errors"])
    parser.add_argument("first", type=Path)
    parser.add_argument("second", type=Path, nargs="?")
    parser.add_argument("--nodes", type=int, default=5, help="of a window, with its first one")
    given = parser.parse_args()
    if given.what == "simulate":
        simulate(given.first)
    elif given.what == "convert":
        convert(given.first, given.second)
    else:
        errors(given.first, given.second, given.nodes)
