"""Rigid bodies: data of SE3HamDL as a table, and the errors of trained models on them.

python rigid.py convert se3hamdl_pendulum.npz pendulum.parquet
python rigid.py errors outputs/pendulum pendulum.parquet
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import pandas as pd
import torch

import symo_exp
from symo_exp.mechanics.space import angle, quaternion

FLAT = {13: 0, 22: 3}
"""Positions of a row of the pendulum (R, ω, u) and of the quadrotor (x, R, v, ω, u)."""
HELD_OUT = 8
"""Every so many-th motion of the training data is for validation."""
OUTLIER = 3.0
"""Errors of motions over the median from which they are left out."""
GROUND = 0.03
"""Height below which a quadrotor touches the ground [m]; such motions are left out."""


def convert(source: Path, target: Path) -> None:
    """Write the arrays of SE3HamDL as a table of recordings."""
    arrays = np.load(source)
    h = float(arrays["t"][1] - arrays["t"][0])
    parts = []
    for name, split in (("x", "train"), ("test_x", "test")):
        inputs, nodes, motions, width = arrays[name].shape
        flat = FLAT[width]
        rows = arrays[name].transpose(0, 2, 1, 3).reshape(inputs * motions, nodes, width)
        for k, motion in enumerate(rows):
            if flat and motion[:, 2].min() < GROUND:
                continue
            x, turn = motion[:, :flat], motion[:, flat : flat + 9].reshape(-1, 3, 3)
            rates = motion[:, flat + 9 : 2 * flat + 12]
            v = np.einsum("kij,kj->ki", turn, rates[:, :flat]) if flat else rates[:, :0]
            q = quaternion(torch.tensor(turn)).numpy()
            part = "val" if split == "train" and k % HELD_OUT == 0 else split
            columns = {"trajectory": f"{split}{k}", "split": part, "t": h * np.arange(nodes)}
            columns |= {f"q_{a}": x[:, i] for i, a in enumerate("xyz"[:flat])}
            columns |= {f"q_R_{a}": q[:, i] for i, a in enumerate("wxyz")}
            columns |= {f"v_{a}": v[:, i] for i, a in enumerate("xyz"[:flat])}
            columns |= {f"v_R_{a}": rates[:, flat + i] for i, a in enumerate("xyz")}
            columns |= {f"u_{i}": u for i, u in enumerate(motion[:, 2 * flat + 12 :].T)}
            parts.append(pd.DataFrame(columns))
    pd.concat(parts).to_parquet(target, index=False)
    print(f"{target}: {len(parts)} motions, a node every {h:.6g} s")


def errors(folder: Path, table: Path) -> None:
    """Print the error of each run in a folder on the test and the validation motions.

    It is that of LieFVIN and SE3HamDL: over windows of five nodes, each from the recorded state of
    its first one, the mean squared error of body rates and input (four numbers, the input without
    an error) plus the mean squared angle between rotations. A quadrotor's recorded velocities are
    differences of the configurations one step before: that configuration is where it starts.
    """
    for run in sorted(path.parent for path in folder.glob("*/config.yaml")):
        model = symo_exp.load(run).for_evaluation()
        found = {part: float(errors_of(model, table, part).mean()) for part in ("val", "test")}
        print(run.name, *(f"{part} {value:.3g}" for part, value in found.items()))


def clean(folder: Path, table: Path, target: Path) -> None:
    """Write the table without the training and validation motions that a run fits badly.

    Those are the ones whose error is above OUTLIER times the median: contacts and resets.
    """
    run = sorted(path.parent for path in folder.glob("*/config.yaml"))[-1]
    model, rows = symo_exp.load(run).for_evaluation(), pd.read_parquet(table)
    dropped: set[str] = set()
    for part in ("train", "val"):
        found = errors_of(model, table, part)
        names = rows[rows.split == part].trajectory.drop_duplicates().to_numpy()
        dropped |= set(names[(found > OUTLIER * found.median()).numpy()])
    rows[~rows.trajectory.isin(dropped)].to_parquet(target, index=False)
    print(f"{target}: {len(dropped)} motions left out")


def errors_of(
    model: symo_exp.DynamicsModel, table: Path, part: str, nodes: int = 5
) -> torch.Tensor:
    """Return the errors of the windows of a part, in the order of the table."""
    rows = pd.read_parquet(table)
    rows = rows[rows.split == part]
    names, space = model.coordinates, model.flow.space
    count = rows.groupby("trajectory").size().iloc[0]
    fields = (
        [f"q_{n}" for n in names.measured],
        [f"v_{n}" for n in names.names],
        [c for c in rows if c.startswith("u_")],
    )
    q, v, u = (torch.tensor(rows[list(f)].to_numpy()).unflatten(0, (-1, count)) for f in fields)
    q = space.of_quaternions(q)
    q, v, u = (
        x.unfold(1, nodes, 1).movedim(3, 2).flatten(0, 1) if count > nodes else x for x in (q, v, u)
    )
    h, backward = model.time_step, bool(names.flat)
    if backward:  # v_k = (q_k − q_{k−1}) / h
        before = space.retract(q[:, 0], -h * v[:, 0])
        flow = model.flow
        forces = flow.forces(u[:, 0], u[:, 0])
        start = flow.decode(q[:, 0], flow.discrete.momentum(before, q[:, 0], forces))
        path = model.rollout(q[:, 0], start, u)
        rates = space.difference(path.q[:, :-1], path.q[:, 1:]) / h
        rates = torch.cat((v[:, :1], rates), dim=1)
    else:
        path = model.rollout(q[:, 0], v[:, 0], u)
        rates = path.v
    turned = angle(space.rotation_matrices(q)[:, :, 0], space.rotation_matrices(path.q)[:, :, 0])
    rate_error = (rates - v)[..., -3:].square().sum(-1) / 4
    return (rate_error + turned.square()).mean(1)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("what", choices=["convert", "errors", "clean"])
    parser.add_argument("first", type=Path)
    parser.add_argument("second", type=Path)
    parser.add_argument("--to", type=Path, help="the table that clean writes")
    given = parser.parse_args()
    if given.what == "clean":
        clean(given.first, given.second, given.to)
    else:
        (convert if given.what == "convert" else errors)(given.first, given.second)
