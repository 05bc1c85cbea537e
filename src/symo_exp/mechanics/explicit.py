"""Explicit Runge-Kutta steps for second-order systems (thesis section 3.2).

Rotations take the steps of Munthe-Kaas (1998): the method integrates ``φ̇ = J(φ)⁻¹ ω`` in the chart
at the start of a step, which keeps its order.
"""

import math
from collections.abc import Callable

from jaxtyping import Float
from torch import Tensor

from symo_exp.errors import ConfigError
from symo_exp.mechanics.space import FLAT, Space

Acceleration = Callable[[Tensor, Tensor, Tensor], Tensor]
"""``v̇ = a(q, v, u)``."""


class RungeKutta:
    """An explicit Runge-Kutta method given by its Butcher tableau.

    With ``x = (q, v)`` and ``f = (v, a(q, v, u))`` it takes the step
    ``k_i = f(x + h Σ_j A_ij k_j, u(t + c_i h))``, ``x⁺ = x + h Σ_i b_i k_i``.
    The control is linear between the two nodes.

    Args:
        name: Name of the method.
        order: Its order.
        a: Rows of ``A``, strictly lower triangular.
        b: Weights.
        c: Nodes.

    Raises:
        ConfigError: If this is no tableau of an explicit method.
    """

    def __init__(
        self,
        *,
        name: str,
        order: int,
        a: tuple[tuple[float, ...], ...],
        b: tuple[float, ...],
        c: tuple[float, ...],
    ) -> None:
        if not len(a) == len(b) == len(c) or [len(row) for row in a] != list(range(len(a))):
            raise ConfigError(
                f"the tableau of {name} has a={a}, b={b}, c={c}: expected as many rows of a as "
                "entries of b and c, and in row i of a the i weights before its diagonal, from 0 on"
            )
        sums = [*map(sum, a), sum(b)]
        if not all(math.isclose(x, y, abs_tol=1e-9) for x, y in zip(sums, (*c, 1.0), strict=True)):
            raise ConfigError(
                f"the tableau of {name} has sums {sums} of the rows of a and of b: expected the "
                f"entries of c and 1, {[*c, 1.0]}"
            )
        self.name, self.order = name, order
        self._a, self._b, self._c = a, b, c

    def step(
        self,
        acceleration: Acceleration,
        q: Float[Tensor, "batch N"],
        v: Float[Tensor, "batch n"],
        u: Float[Tensor, "batch m"],
        u_next: Float[Tensor, "batch m"],
        h: float,
        space: Space = FLAT,
    ) -> tuple[Float[Tensor, "batch N"], Float[Tensor, "batch n"]]:
        """Return the state one time step ``h`` later."""
        start = space.origin(q)
        velocities: list[Tensor] = []
        accelerations: list[Tensor] = []
        for weights, node in zip(self._a, self._c, strict=True):
            x_stage = _combine(start, h, weights, velocities)
            v_stage = _combine(v, h, weights, accelerations)
            u_stage = u if node == 0.0 else u + node * (u_next - u)
            velocities.append(space.chart_rate(x_stage, v_stage))
            accelerations.append(acceleration(space.point(q, x_stage), v_stage, u_stage))
        end = space.point(q, _combine(start, h, self._b, velocities))
        return end, _combine(v, h, self._b, accelerations)


def _combine(x: Tensor, h: float, weights: tuple[float, ...], slopes: list[Tensor]) -> Tensor:
    for weight, slope in zip(weights, slopes, strict=True):
        if weight != 0.0:
            x = x.add(slope, alpha=h * weight)
    return x


class Midpoint(RungeKutta):
    """The explicit midpoint rule, order 2 (thesis (3.17) with its missing step)."""

    def __init__(self) -> None:
        super().__init__(name="midpoint", order=2, a=((), (1 / 2,)), b=(0.0, 1.0), c=(0.0, 1 / 2))


class RK4(RungeKutta):
    """Kutta's 3/8 rule, order 4, ``rk4`` in torchdiffeq: the method of the thesis' training."""

    def __init__(self) -> None:
        super().__init__(
            name="rk4",
            order=4,
            a=((), (1 / 3,), (-1 / 3, 1.0), (1.0, -1.0, 1.0)),
            b=(1 / 8, 3 / 8, 3 / 8, 1 / 8),
            c=(0.0, 1 / 3, 2 / 3, 1.0),
        )


class ClassicalRK4(RungeKutta):
    """Runge and Kutta's classical rule, order 4."""

    def __init__(self) -> None:
        super().__init__(
            name="classical_rk4",
            order=4,
            a=((), (1 / 2,), (0.0, 1 / 2), (0.0, 0.0, 1.0)),
            b=(1 / 6, 1 / 3, 1 / 3, 1 / 6),
            c=(0.0, 1 / 2, 1 / 2, 1.0),
        )


class DormandPrince5(RungeKutta):
    """The fifth-order method of Dormand and Prince (1980) with a fixed step.

    Its seventh stage serves only the error estimate of an adaptive step, so there are six.
    """

    def __init__(self) -> None:
        super().__init__(
            name="dopri5",
            order=5,
            a=(
                (),
                (1 / 5,),
                (3 / 40, 9 / 40),
                (44 / 45, -56 / 15, 32 / 9),
                (19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729),
                (9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656),
            ),
            b=(35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84),
            c=(0.0, 1 / 5, 3 / 10, 4 / 5, 8 / 9, 1.0),
        )
