"""Benchmark cases: systems (only their shape matters), weights and windows, equal for all.

Everything is made in float64 from a seed; each implementation casts it to its own precision, so
that all of them see the same weights and the same data.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import NamedTuple

import torch
from torch import Tensor

from symo_exp.mechanics.explicit import RK4
from symo_exp.mechanics.types import Windows
from symo_exp.systems.base import LagrangianSystem
from symo_exp.systems.table import system

METHODS = ("e2e_symo", "l_node", "symo", "node")


@dataclass(frozen=True)
class Case:
    """Shape of a learning problem.

    angular: which of the n coordinates are angles; input_matrix: B as n rows of m columns;
    time_step: h [s]; speed: the largest velocity of the random windows [unit/s].
    """

    name: str
    angular: tuple[bool, ...]
    input_matrix: tuple[tuple[float, ...], ...]
    time_step: float
    width: int
    speed: float

    @property
    def n(self) -> int:
        """Number of coordinates."""
        return len(self.angular)

    @property
    def n_inputs(self) -> int:
        """Number of inputs m."""
        return len(self.input_matrix[0])

    @property
    def n_features(self) -> int:
        """Length of s(q) = (r, cos phi, sin phi)."""
        return self.n + sum(self.angular)

    def layer_sizes(self, method: str) -> tuple[int, int, int, int]:
        """Sizes of the MLP, input to output: of (diag L, lower L, V)(s), or of v'(s, v, u)."""
        if method == "node":
            return self.n_features + self.n + self.n_inputs, self.width, self.width, self.n
        return self.n_features, self.width, self.width, self.n * (self.n + 1) // 2 + 1


def _case(system: LagrangianSystem, width: int, speed: float) -> Case:
    """The shape of one of the project's systems."""
    name = type(system).__name__.lower()
    matrix = tuple(tuple(row) for row in system.input_matrix.tolist())
    return Case(name, system.coordinates.angular, matrix, system.time_step, width, speed)


SYSTEMS: dict[str, LagrangianSystem] = {
    name: system(name) for name in ("pendulum", "acrobot", "cartpole")
}

CASES = {
    "pendulum": _case(SYSTEMS["pendulum"], 128, 2 * math.pi),
    "acrobot": _case(SYSTEMS["acrobot"], 256, 3.14),
    "cartpole": _case(SYSTEMS["cartpole"], 256, 3.0),
}


TRAINING_ROWS = 1024
"""32 trajectories, as the published tables have them."""


def training_batch(name: str, count: int) -> Windows:
    """Some of the windows that `project.trained_weights` has seen; fresh ones where more are asked
    for."""
    return system_windows(name, max(count, TRAINING_ROWS)).rows(slice(count))


def chain(n: int, width: int = 256) -> Case:
    """The shape of a chain of n pendulums, driven at the first: cost against coordinates."""
    matrix = tuple((1.0 if i == 0 else 0.0,) for i in range(n))
    return Case(f"chain{n}", (True,) * n, matrix, 0.05, width, 1.0)


class Layer(NamedTuple):
    """One affine map: weight (out, in), bias (out)."""

    weight: Tensor
    bias: Tensor


def layers_of(parameters: Iterable[Tensor]) -> list[Layer]:
    """Copies of [weight, bias, weight, ...] as layers."""
    flat = [p.detach().double() for p in parameters]
    return [Layer(*pair) for pair in zip(flat[::2], flat[1::2], strict=True)]


def initial_weights(case: Case, method: str) -> list[Layer]:
    """Xavier-uniform with tanh gain, zero biases: where the text of the thesis starts."""
    generator = torch.Generator().manual_seed(0)
    sizes = case.layer_sizes(method)
    layers = []
    for fan_in, fan_out in pairwise(sizes):
        bound = 5 / 3 * math.sqrt(6 / (fan_in + fan_out))
        uniform = torch.rand(fan_out, fan_in, generator=generator, dtype=torch.float64)
        layers.append(Layer((2 * uniform - 1) * bound, torch.zeros(fan_out, dtype=torch.float64)))
    return layers


def random_windows(case: Case, count: int, *, hold_input: bool = True) -> Windows:
    """Plausible windows: parabolic motion through random states, |v'| up to 3.

    With `hold_input` the input is constant over a window, as in the protocol; without it, three
    independent inputs (which tell apart their weights in the discrete force).
    """
    generator = torch.Generator().manual_seed(1)

    def uniform(columns: int, bound: float) -> Tensor:
        return (
            2 * torch.rand(count, columns, generator=generator, dtype=torch.float64) - 1
        ) * bound

    h = case.time_step
    position_bound = torch.tensor([math.pi if a else 0.5 for a in case.angular])
    q = uniform(case.n, 1.0) * position_bound
    v, a = uniform(case.n, case.speed), uniform(case.n, 3.0)
    inputs = [uniform(case.n_inputs, 2.0) for _ in range(3)]
    if hold_input:
        inputs = inputs[:1] * 3
    return Windows(q - h * v + h**2 / 2 * a, q, q + h * v + h**2 / 2 * a, v, v + h * a, *inputs)


def calm_weights(case: Case, method: str) -> list[Layer]:
    """Initial weights with the output layer a tenth and the diagonal of L near 1.3.

    Then H is well conditioned for any number of coordinates, and every root is found.
    """
    *hidden, last = initial_weights(case, method)
    bias = last.bias.clone()
    if method != "node":
        bias[: case.n] = 1.0
    return [*hidden, Layer(0.1 * last.weight, bias)]


@cache
def system_windows(name: str, count: int) -> Windows:
    """Shuffled windows of simulated trajectories, 34 nodes each, the input held along each."""
    system = SYSTEMS[name]
    generator = torch.Generator().manual_seed(0)
    trajectories = max(16, -(-count // 32))

    def start(box: tuple[tuple[float, float], ...]) -> Tensor:
        low, high = torch.tensor(box, dtype=torch.float64).T
        unit = torch.rand(trajectories, len(low), generator=generator, dtype=torch.float64)
        return low + (high - low) * unit

    box, fine = system.box, 20
    h = system.time_step / fine
    q, v, u = start(box.q), start(box.v), start(box.u)
    configurations, velocities = [q], [v]
    for _ in range(33):
        for _ in range(fine):
            q, v = RK4().step(system.acceleration, q.detach(), v.detach(), u, u, h)
        configurations.append(q)
        velocities.append(v)
    q, v = torch.stack(configurations, 1), torch.stack(velocities, 1)
    held = u.unsqueeze(1).expand(-1, 32, -1)
    fields = (q[:, :-2], q[:, 1:-1], q[:, 2:], v[:, 1:-1], v[:, 2:], held, held, held)
    order = torch.randperm(trajectories * 32, generator=generator)[:count]
    return Windows(*(x.detach().flatten(0, 1)[order] for x in fields))
