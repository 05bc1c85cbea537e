"""What is measured: systems (only their shape matters), weights and windows, equal for everybody.

Everything is made in float64 from a seed; each implementation casts it to its own precision, so
that all of them see the same weights and the same data.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

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


CASES = {
    case.name: case
    for case in (
        Case("pendulum", (True,), ((1.0,),), 0.1, 128, 2 * math.pi),
        Case("acrobot", (True, True), ((0.0,), (1.0,)), 0.05, 256, 3.14),
        Case("cartpole", (False, True), ((1.0,), (0.0,)), 0.05, 256, 3.0),
    )
}


def chain(n: int, width: int = 256) -> Case:
    """A chain of n pendulums driven at the first joint: cost against the number of coordinates."""
    matrix = tuple((1.0 if i == 0 else 0.0,) for i in range(n))
    return Case(f"chain{n}", (True,) * n, matrix, 0.05, width, 2.0)


class Layer(NamedTuple):
    """One affine map: weight (out, in), bias (out)."""

    weight: Tensor
    bias: Tensor


class Windows(NamedTuple):
    """N samples of three consecutive nodes, h apart: q, v (N, n), u (N, m)."""

    q_prev: Tensor
    q: Tensor
    q_next: Tensor
    v: Tensor
    v_next: Tensor
    u_prev: Tensor
    u: Tensor
    u_next: Tensor

    def to(self, dtype: torch.dtype) -> Windows:
        """The same windows in another precision."""
        return Windows(*(x.to(dtype) for x in self))

    def rows(self, index: slice | Tensor) -> Windows:
        """A selection of the samples."""
        return Windows(*(x[index] for x in self))


def initial_weights(case: Case, method: str, seed: int = 0) -> list[Layer]:
    """Xavier-uniform with tanh gain, zero biases: the weights that training starts with."""
    generator = torch.Generator().manual_seed(seed)
    sizes = case.layer_sizes(method)
    layers = []
    for fan_in, fan_out in zip(sizes, sizes[1:], strict=False):
        bound = 5 / 3 * math.sqrt(6 / (fan_in + fan_out))
        uniform = torch.rand(fan_out, fan_in, generator=generator, dtype=torch.float64)
        layers.append(Layer((2 * uniform - 1) * bound, torch.zeros(fan_out, dtype=torch.float64)))
    return layers


def random_windows(
    case: Case, count: int, seed: int = 0, *, hold_input: bool = True, acceleration: float = 3.0
) -> Windows:
    """Plausible windows: parabolic motion through random states, |v'| up to `acceleration`.

    With `hold_input` the input is constant over a window, as in the protocol; without it, three
    independent inputs (which tell apart their weights in the discrete force).
    """
    generator = torch.Generator().manual_seed(seed + 1)

    def uniform(columns: int, bound: float) -> Tensor:
        return (
            2 * torch.rand(count, columns, generator=generator, dtype=torch.float64) - 1
        ) * bound

    h = case.time_step
    position_bound = torch.tensor([math.pi if a else 0.5 for a in case.angular])
    q = uniform(case.n, 1.0) * position_bound
    v, a = uniform(case.n, case.speed), uniform(case.n, acceleration)
    inputs = [uniform(case.n_inputs, 2.0) for _ in range(3)]
    if hold_input:
        inputs = inputs[:1] * 3
    return Windows(
        q - h * v + h**2 / 2 * a, q, q + h * v + h**2 / 2 * a, v, v + h * a, *inputs
    )
