"""Torques of a real arm of six joints from its motion: rivals and the package's rigid bodies.

python results/rivals/inverse_dynamics.py tx40.parquet [--test]

The arm is a Stäubli TX40 whose motor 6 also turns with joint 5. Every method reads the angles and
their derivatives by the same zero-phase filter. Settings are those with the smallest mean over
joints of the relative error on ``val``; ``--test`` measures the chosen ones on ``test``, fitted to
``train`` and then to ``train`` and ``val``. The error of a joint is ``mean (u − û)² / mean u²``.
"""

import argparse
import itertools
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
import pandas as pd
import pinocchio
import torch
from scipy.signal import butter, filtfilt
from torch import Tensor, nn

from symo_exp.mechanics.lagrangian import Lagrangian, matvec, solve, vecmat
from symo_exp.mechanics.types import Coordinates
from symo_exp.nets.affine import Linearised, parameter_jacobian, repeated
from symo_exp.nets.rigid_chain import RigidChain
from symo_exp.nets.structured_lagrangian import StructuredLagrangian
from symo_exp.optim.levenberg_marquardt import LevenbergMarquardt

RATE = 0.005  # s between the rows of the recording
AXES = [[0, 0, 1], [0, 1, 0], [0, 1, 0], [0, 0, 1], [0, 1, 0], [0, 0, 1]]
PLACES = [[0, 0, 0], [0, 0.035, 0], [0, 0, 0.225], [0, 0, 0.225], [0, 0, 0], [0, 0, 0.065]]
DRIVES = torch.cat((torch.eye(6), torch.tensor([[0.0, 0, 0, 0, 1, 1]]))).double()
"""Velocities of the drives from those of the joints: each joint, and the gears of motor 6."""


class Samples(NamedTuple):
    """Angles, their derivatives, torques."""

    q: Tensor
    v: Tensor
    a: Tensor
    u: Tensor

    def rows(self, rows: slice) -> "Samples":
        return Samples(*(x[rows] for x in self))


def samples(table: pd.DataFrame, part: str, cutoff: float) -> Samples:
    rows = table[table.split == part]
    q, u = (rows[[f"{x}_{i}" for i in range(1, 7)]].to_numpy() for x in "qu")
    q = filtfilt(*butter(4, 2.0 * RATE * cutoff), q, axis=0, padlen=60)
    v = np.gradient(q, RATE, axis=0)
    fields = q, v, np.gradient(v, RATE, axis=0), u
    return Samples(*(torch.tensor(x.copy(), dtype=torch.float64) for x in fields))


def errors(predicted: Tensor, u: Tensor) -> Tensor:
    return (predicted - u).square().mean(0) / u.square().mean(0)


Model = Callable[[Samples], Tensor]


def linear(train: Samples, *, rest: float, squares: bool) -> Model:
    """Least squares of base parameters: Pinocchio's regressor with columns for the drives.

    Armature, viscous and dry friction of each row of ``DRIVES``, an offset of each joint, with
    ``squares`` also ``v |v|``. Joints are weighted by their residuals.
    """
    arm, joint = pinocchio.Model(), 0
    for i in range(6):
        place = pinocchio.SE3(np.eye(3), np.array(PLACES[i], dtype=float))
        axis = np.array(AXES[i], dtype=float)
        joint = arm.addJoint(joint, pinocchio.JointModelRevoluteUnaligned(axis), place, str(i))
    data = arm.createData()

    def columns(x: Samples) -> Tensor:
        rows = zip(x.q.numpy(), x.v.numpy(), x.a.numpy(), strict=True)
        bodies = [pinocchio.computeJointTorqueRegressor(arm, data, *row).copy() for row in rows]
        w = x.v @ DRIVES.T
        drives = [x.a @ DRIVES.T, w, torch.tanh(w / rest), *([w * w.abs()] if squares else [])]
        parts = [y.unsqueeze(1) * DRIVES.T for y in drives]
        own = torch.eye(6).double().expand(len(w), 6, 6)
        return torch.cat((torch.tensor(np.array(bodies)), *parts, own), dim=2)

    matrix, weight = columns(train), 1.0 / train.u.std(0)
    for _ in range(4):
        left = (weight.view(6, 1) * matrix).flatten(0, 1)
        size = left.norm(dim=0).clamp_min(1e-12)
        right = (weight * train.u).flatten()
        found = torch.linalg.lstsq(left / size, right, rcond=1e-6, driver="gelsd")[0] / size
        weight = 1.0 / (matrix @ found - train.u).std(0)
    return lambda x: columns(x) @ found


def network(train: Samples, *, width: int, decay: float) -> Model:
    """Two hidden layers that read sines, cosines, velocities and accelerations; AdamW."""

    def inputs(x: Samples) -> Tensor:
        speeds = torch.cat((x.v / train.v.std(0), x.a / train.a.std(0)), dim=1)
        return torch.cat((x.q.sin(), x.q.cos(), speeds), dim=1)

    scale = train.u.std(0)
    hidden = nn.Sequential(nn.Linear(24, width), nn.Tanh(), nn.Linear(width, width), nn.Tanh())
    net = nn.Sequential(hidden, nn.Linear(width, 6)).double()
    optimizer = torch.optim.AdamW(net.parameters(), lr=3e-3, weight_decay=decay)
    z, target = inputs(train), train.u / scale
    for _ in range(1500):
        optimizer.zero_grad()
        (net(z) - target).square().mean().backward()
        optimizer.step()
    return lambda x: (scale * net(inputs(x))).detach()


class Drives(nn.Module):
    """Inertia and friction of the drives: each row has coefficients, squares of parameters.

    Viscous and dry friction, with ``squares`` also ``v |v|`` of either sign.
    """

    def __init__(self, *, rest: float, squares: bool) -> None:
        super().__init__()
        self.rest = rest
        self.roots = nn.Parameter(torch.full((21,), 0.1, dtype=torch.float64))
        self.bend = nn.Parameter(torch.zeros(7, dtype=torch.float64)) if squares else None

    def forward(self, x: Samples) -> Tensor:
        squares = repeated(self.roots, len(x.q)).square()
        rotors, viscous, dry = squares.unflatten(1, (3, 7)).unbind(1)
        w = x.v @ DRIVES.T
        turned = rotors * (x.a @ DRIVES.T) + viscous * w + dry * torch.tanh(w / self.rest)
        if self.bend is not None:
            turned = turned + repeated(self.bend, len(x.q)) * w * w.abs()
        return vecmat(turned, DRIVES)


class Arm(nn.Module):
    """``d/dt ∂ℒ/∂v − ∂ℒ/∂q`` and the drives; fitted to torques, or to accelerations."""

    def __init__(
        self, lagrangian: nn.Module, drives: Drives, train: Samples, *, by_torque: bool
    ) -> None:
        super().__init__()
        self.lagrangian, self.drives, self.by_torque = lagrangian, drives, by_torque
        self.weight = 1.0 / (train.u if by_torque else train.a).std(0)

    def as_forces(self, x: Samples) -> None:
        return None

    def torque(self, x: Samples) -> tuple[Tensor, Tensor]:
        """Return the torques, and the inertia of the bodies."""
        assert isinstance(self.lagrangian, Lagrangian)
        rates = self.lagrangian.rates(x.q, x.v)
        moved = matvec(rates.mass, x.a) + rates.mass_rate_v - rates.q
        return moved + self.drives(x), rates.mass

    def residuals(self, x: Samples) -> Tensor:
        torque, mass = self.torque(x)
        if self.by_torque:
            return self.weight * (torque - x.u)
        rotors = repeated(self.drives.roots, len(x.q))[:, :7].square()
        mass = mass + torch.einsum("bk,ki,kj->bij", rotors, DRIVES, DRIVES)
        return self.weight * solve(mass, torque - x.u)

    def linearised(self, x: Samples, parameters: list[Tensor]) -> Linearised:
        return parameter_jacobian(lambda: self.residuals(x), parameters)


def fitted(arm: Arm, train: Samples, epochs: int) -> Model:
    """Levenberg-Marquardt; torques are weighted by their residuals in the second half."""
    free = [
        p for name, p in arm.named_parameters() if name.split(".")[-1] not in ("axes", "places")
    ]
    for _ in range(2):
        optimizer = LevenbergMarquardt(free)
        for _ in range(epochs // 2):
            optimizer.epoch(arm, [train])
        if arm.by_torque:
            arm.weight = 1.0 / (arm.torque(train)[0] - train.u).std(0).detach()
    return lambda x: arm.torque(x)[0].detach()


def rigid(train: Samples, *, rest: float, squares: bool) -> Model:
    """Rigid bodies with the known axes and places, whose inertias are all possible."""
    coordinates = Coordinates(tuple("abcdef"), (True,) * 6)
    bodies = RigidChain(coordinates=coordinates, axes=AXES).double()
    with torch.no_grad():
        bodies.axes.copy_(torch.tensor(AXES).flatten())
        bodies.places.copy_(torch.tensor(PLACES).flatten())
        bodies.rotors.zero_()  # those of the drives take their place
    arm = Arm(bodies, Drives(rest=rest, squares=squares), train, by_torque=True)
    return fitted(arm, train, 40)


def lagrangian(train: Samples, *, width: int, epochs: int, squares: bool, by_torque: bool) -> Model:
    """The network of L-NODE, on accelerations as in L-NODE or on torques as in DeLaN."""
    net = StructuredLagrangian(angular=(True,) * 6, width=width).double()
    arm = Arm(net, Drives(rest=0.05, squares=squares), train, by_torque=by_torque)
    return fitted(arm, train, epochs)


def candidates() -> Iterator[tuple[str, Callable[..., Model], dict[str, list[object]]]]:
    rests: list[object] = [0.02, 0.05, 0.1]
    yield "linear, FIGAROH's columns", linear, {"rest": rests, "squares": [False]}
    yield "linear, also v |v|", linear, {"rest": rests, "squares": [True]}
    yield "rigid bodies", rigid, {"rest": rests, "squares": [False]}
    yield "rigid bodies, also v |v|", rigid, {"rest": rests, "squares": [True]}
    nets: dict[str, list[object]] = {"width": [6, 12], "epochs": [20, 80], "squares": [True]}
    yield "L-NODE's network on accelerations", lagrangian, {**nets, "by_torque": [False]}
    yield "L-NODE's network on torques", lagrangian, {**nets, "by_torque": [True]}
    yield "network", network, {"width": [16, 64], "decay": [0.1, 1.0]}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("path")
    parser.add_argument("--test", action="store_true", help="measure the chosen settings on test")
    parser.add_argument("--only", default="", help="methods whose names begin with this")
    given = parser.parse_args()
    torch.set_num_threads(1)
    table = pd.read_parquet(given.path)
    for name, fit, grid in candidates():
        if not name.startswith(given.only):
            continue
        best: tuple[float, float, dict[str, object]] | None = None
        cutoffs = (20.0, 40.0) if fit in (linear, rigid) else (40.0,)
        for cutoff, *values in itertools.product(cutoffs, *grid.values()):
            settings = dict(zip(grid, values, strict=True))
            torch.manual_seed(0)
            model = fit(samples(table, "train", cutoff), **settings)
            val = samples(table, "val", cutoff)
            found = errors(model(val), val.u)
            shown = " ".join(f"{x:.4f}" for x in found)
            print(
                f"  {name}, {cutoff:g} Hz, {settings}: val {found.mean():.4f} ({shown})", flush=True
            )
            error = float(found.mean().nan_to_num(torch.inf))  # not the best, even as the first
            if best is None or error < best[0]:
                best = error, cutoff, settings
        assert best is not None
        error, cutoff, settings = best
        cells = [name, f"{error:.4f}", f"{cutoff:g} Hz, {settings}"]
        for learned in (table, table.replace({"split": {"val": "train"}})) if given.test else ():
            torch.manual_seed(0)
            model = fit(samples(learned, "train", cutoff), **settings)
            test = samples(table, "test", cutoff)
            found = errors(model(test), test.u)
            cells += [f"{found.mean():.3f}", *(f"{x:.3f}" for x in found)]
        print("| " + " | ".join(cells) + " |", flush=True)
