"""The gyroscope and the chains of CHNN (Finzi, Wang, Wilson 2020), simulated; errors of models.

python results/rigid/chnn.py simulate gyroscope gyroscope.parquet
python results/rigid/chnn.py errors gyroscope outputs/gyroscope gyroscope.parquet
python results/rigid/chnn.py simulate 2 few.parquet --train 10
"""

from __future__ import annotations

import argparse
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

import symo_exp
from symo_exp.mechanics.space import quaternion
from symo_exp.mechanics.types import Coordinates
from symo_exp.systems.base import LagrangianSystem
from symo_exp.systems.box import SamplingBox
from symo_exp.systems.rigid_body import RigidBody
from symo_exp.systems.simulation import Solver, simulate

NODES, CHUNK = 100, 5
"""Of a motion; of a piece of one to learn from."""
GRAVITY = 9.81
FLOOR = 1e-8
"""Added to relative errors, as in CHNN: that of the start is zero."""


class Case(ABC):
    """A system of CHNN."""

    system: LagrangianSystem

    @abstractmethod
    def starts(self, draw: np.random.Generator, count: int) -> tuple[Tensor, Tensor]:
        """Return configurations and velocities by the makers' law."""

    @abstractmethod
    def points(self, q: Tensor, v: Tensor) -> tuple[Tensor, Tensor]:
        """Return positions and velocities of the system's points, (motions, nodes, entries)."""

    @abstractmethod
    def columns(self, q: Tensor, v: Tensor) -> dict[str, Tensor]:
        """Return the columns of one motion."""


class Gyroscope(Case):
    """A disc on a rod that stands on a pivot, 0.1 kg; 2 s with h = 0.02 s.

    Both are prisms with 32 sides. The second moments over the mass are 100 times those of the
    mesh, as in CHNN. Points: the centre of mass and those one metre from it along three axes.
    """

    prisms = ((0.099539, 0.206854, 0.240289), (0.005044, 0.0, 0.256003))
    """Radius to the corners, lower and upper end [m]."""

    def __init__(self) -> None:
        radius, low, high = np.array(self.prisms).T
        volume = radius**2 * (high - low)  # times 16 sin(π/16)
        share, middle = volume / volume.sum(), (low + high) / 2
        centre = float(share @ middle)
        across = share @ radius**2 * (2 + np.cos(np.pi / 16)) / 12
        along = share @ ((high - low) ** 2 / 12 + (middle - centre) ** 2)
        mass = 0.1
        inertia = 100 * mass * np.array([across + along, across + along, 2 * across])
        self.centre = centre
        self.system = RigidBody(
            time_step=0.02, gravity=(0.0, 0.0, -GRAVITY), mass=mass, centre=(0.0, 0.0, centre),
            inertia=tuple(inertia.tolist()), box=_box(3),
        )  # fmt: skip

    def starts(self, draw: np.random.Generator, count: int) -> tuple[Tensor, Tensor]:
        """Euler angles within ±1.5 rad, spins of about 10 rad/s in both directions."""
        angles, rates = draw.uniform(-1.5, 1.5, (2, count, 3)) * [[[1, 1, 1]], [[3, 0.2, 1]]]
        rates[:, 2] = draw.choice([-1.5, 1.5], count) * (draw.normal(size=count) + 7)
        turn = Rotation.from_euler("ZXZ", angles).as_matrix()
        (_, theta, psi), zero = angles.T, np.zeros(count)
        s, c = np.sin, np.cos
        axes = (s(theta) * s(psi), c(psi), zero, s(theta) * c(psi), -s(psi), zero,
                c(theta), zero, zero + 1)  # fmt: skip
        omega = np.einsum("kij,kj->ki", np.stack(axes, 1).reshape(-1, 3, 3), rates)
        return torch.tensor(turn).flatten(1), torch.tensor(omega)

    def points(self, q: Tensor, v: Tensor) -> tuple[Tensor, Tensor]:
        """Centre of mass, and a metre further along each axis."""
        arms = torch.cat((torch.zeros(3, 1), torch.eye(3)), dim=1).to(q)
        arms[2] += self.centre
        turn = q.unflatten(-1, (3, 3))
        rates = torch.linalg.cross(
            v.unsqueeze(-1).expand(*v.shape, 4), arms.expand(*v.shape, 4), dim=-2
        )
        return (turn @ arms).flatten(2), (turn @ rates).flatten(2)

    def columns(self, q: Tensor, v: Tensor) -> dict[str, Tensor]:
        """The quaternion and the body rates."""
        four = quaternion(q.unflatten(-1, (3, 3)))
        columns = {f"q_R_{a}": x for a, x in zip("wxyz", four.T, strict=True)}
        return columns | {f"v_R_{a}": x for a, x in zip("xyz", v.T, strict=True)}


@dataclass(frozen=True)
class Masses(LagrangianSystem):
    """Point masses on massless rods, absolute angles, 0 hanging."""

    masses: tuple[float, ...] = ()
    lengths: tuple[float, ...] = ()
    time_step: float = field(default=0.03, kw_only=True)

    @property
    def coordinates(self) -> Coordinates:
        """One angle a link."""
        count = len(self.masses)
        return Coordinates(tuple(f"theta_{i + 1}" for i in range(count)), (True,) * count)

    @property
    def input_matrix(self) -> Tensor:
        """None."""
        return torch.zeros(len(self.masses), 1, dtype=torch.float64)

    def _constants(self, q: Tensor) -> tuple[Tensor, Tensor]:
        carried = torch.tensor(self.masses).to(q).flip(0).cumsum(0).flip(0)
        return carried, torch.tensor(self.lengths).to(q)

    def mass_matrix(self, q: Tensor) -> Tensor:
        """``Σ_{k ≥ i, j} m_k l_i l_j cos(θ_i − θ_j)``."""
        carried, length = self._constants(q)
        index = torch.arange(len(length))
        both = carried[torch.maximum(index[:, None], index)] * length[:, None] * length
        return both * (q.unsqueeze(-1) - q.unsqueeze(-2)).cos()

    def potential(self, q: Tensor) -> Tensor:
        """``−Σ g l_i cos θ_i Σ_{k ≥ i} m_k``."""
        carried, length = self._constants(q)
        return -GRAVITY * (carried * length * q.cos()).sum(-1)


class Chain(Case):
    """Point masses on rods in a plane, hanging; 3 s with h = 0.03 s.

    Masses [kg] and lengths [m] are uniform between 0.6 and 1.4, from NumPy's seed 0.
    """

    def __init__(self, links: int) -> None:
        drawn = 0.6 + 0.8 * np.random.RandomState(0).rand(2, links)[:, ::-1]
        masses, lengths = (tuple(x) for x in drawn.tolist())
        self.lengths = torch.tensor(lengths, dtype=torch.float64)
        self.system = Masses(masses=masses, lengths=lengths, box=_box(links, 1))

    def starts(self, draw: np.random.Generator, count: int) -> tuple[Tensor, Tensor]:
        """Normal angles and speeds, perturbed in the plane and projected on the rods."""
        links = len(self.lengths)
        angles, rates = draw.normal(size=(2, count, 1, links))
        place, speed = self.points(torch.tensor(angles), torch.tensor(rates))
        place += 0.2 * torch.tensor(draw.normal(size=place.shape))
        speed = 0.5 * speed + 0.4 * torch.tensor(draw.normal(size=speed.shape))
        apart = torch.diff(
            place.unflatten(2, (links, 2)), dim=2, prepend=place.new_zeros(count, 1, 1, 2)
        )
        q = torch.atan2(apart[..., 0], -apart[..., 1])
        unit = torch.eye(links, dtype=q.dtype).expand(count, -1, -1)
        _, columns = self.points(q.expand(-1, links, -1), unit)  # speeds of unit rates
        v = torch.linalg.lstsq(columns.mT, speed.mT).solution
        return q[:, 0], v[..., 0]

    def points(self, q: Tensor, v: Tensor) -> tuple[Tensor, Tensor]:
        """The masses."""
        length = self.lengths
        place = torch.stack((length * q.sin(), -length * q.cos()), dim=-1)
        speed = torch.stack((length * q.cos() * v, length * q.sin() * v), dim=-1)
        return place.cumsum(2).flatten(2), speed.cumsum(2).flatten(2)

    def columns(self, q: Tensor, v: Tensor) -> dict[str, Tensor]:
        """The angles and their rates."""
        names = self.system.coordinates.names
        columns = {f"q_{name}": x for name, x in zip(names, q.T, strict=True)}
        return columns | {f"v_{name}": x for name, x in zip(names, v.T, strict=True)}


def _box(n: int, inputs: int = 3) -> SamplingBox:
    side = ((-1.0, 1.0),)
    return SamplingBox(q=side * n, v=side * n, u=((0.0, 0.0),) * inputs)


def case_of(name: str) -> Case:
    """Return the gyroscope, or a chain by its number of links."""
    return Gyroscope() if name == "gyroscope" else Chain(int(name))


def draw_motions(case: Case, target: Path, train: int) -> None:
    """Write a table: pieces of five nodes to learn from, whole motions to test on.

    One piece, anywhere in the first 100 nodes, of each of ``train`` motions, and of a hundred for
    validation; a hundred motions of 100 nodes that start where such a piece does.
    """
    draw, rows = np.random.default_rng(0), []
    h = case.system.time_step
    for part, count in (("train", train), ("val", 100), ("test", 100)):
        q0, v0 = case.starts(draw, count)
        u = torch.zeros(count, case.system.input_matrix.shape[1])
        nodes = NODES if part == "test" else CHUNK
        q, v, _ = simulate(case.system, q0, v0, u, NODES - CHUNK + nodes - 1, Solver())
        for k, first in enumerate(CHUNK * draw.integers(NODES // CHUNK, size=count)):
            piece = slice(first, first + nodes)
            columns = {"trajectory": f"{part}{k}", "split": part, "t": h * np.arange(nodes)}
            rows.append(pd.DataFrame(columns | case.columns(q[k, piece], v[k, piece])))
    pd.concat(rows).to_parquet(target, index=False)
    print(f"{target}: {train} pieces of {CHUNK} nodes, a node every {h:g} s")


def errors(case: Case, folder: Path, table: Path) -> None:
    """Print the geometric mean of the relative error of each run in a folder.

    ``|ẑ − z| / |ẑ + z|`` of positions and velocities of the points, over validation pieces and test
    motions, each from the state of its first node.
    """
    rows = pd.read_parquet(table)
    for run in sorted(path.parent for path in folder.glob("*/config.yaml")):
        model = symo_exp.load(run).for_evaluation()
        found = {part: _error(case, model, rows[rows.split == part]) for part in ("val", "test")}
        print(run.name, *(f"{part} {x:.3g}" for part, x in found.items()))


def _error(case: Case, model: symo_exp.DynamicsModel, rows: pd.DataFrame) -> float:
    coordinates = model.coordinates
    nodes = int(rows.groupby("trajectory").size().iloc[0])
    q, v = (
        torch.tensor(rows[[f"{kind}_{n}" for n in names]].to_numpy()).unflatten(0, (-1, nodes))
        for kind, names in (("q", coordinates.measured), ("v", coordinates.names))
    )
    q = coordinates.space.of_quaternions(q)
    path = model.rollout(q[:, 0], v[:, 0], steps=nodes - 1)
    true, found = (torch.cat(case.points(*x), dim=2) for x in ((q, v), (path.q, path.v)))
    ratio = (found - true).norm(dim=2) / (found + true).norm(dim=2) + FLOOR
    return float(torch.trapezoid(ratio.log(), dim=1).div(nodes - 1).mean().exp())


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("what", choices=["simulate", "errors"])
    parser.add_argument("case", type=case_of, help="gyroscope, or a number of links")
    parser.add_argument("first", type=Path)
    parser.add_argument("second", type=Path, nargs="?")
    parser.add_argument("--train", type=int, default=800, help="pieces to learn from")
    given = parser.parse_args()
    if given.what == "simulate":
        draw_motions(given.case, given.first, given.train)
    else:
        errors(given.case, given.first, given.second)
