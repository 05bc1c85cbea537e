"""The solver of the published data: SciPy's ``solve_ivp`` from node to node."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Float
from scipy.integrate import RK45
from typing_extensions import override

from symo_exp.checks import one_of
from symo_exp.systems.simulation import Slope, Solver

SAFETY, LEAST, MOST = 0.9, 0.2, 10.0
"""Constants of SciPy's control of the step size."""
Rate = Callable[[np.ndarray], np.ndarray]
Rows = Float[np.ndarray, " batch"]
States = Float[np.ndarray, "batch states"]


@dataclass(frozen=True)
class SolveIvp(Solver):
    """``solve_ivp(rate, (0, h), x)`` from each node to the next, for each trajectory by itself.

    With the default tolerances the result depends on the steps: with common steps, pendulums differ
    by 5e-4. All trajectories take a stage at once, but each has its own first step (Hairer, Nørsett
    and Wanner, section II.4) and step sizes, as in SciPy. The input is held from node to node.

    Args:
        method: The method of ``solve_ivp``: ``RK45``.
        rtol: The relative tolerance.
        atol: The absolute tolerance.
    """

    method: str = "RK45"
    rtol: float = 1e-3
    atol: float = 1e-6

    def __post_init__(self) -> None:
        super().__post_init__()
        one_of("data.solver.method", self.method, ("RK45",))

    @override
    def _advance(
        self, slope: Slope, k: int, x: States, h: float, first_step: float | None
    ) -> tuple[States, None]:
        found = self._to_next(partial(slope, k, 0.0), x, h)
        if not np.isfinite(found).all():
            raise self.failed(k, "not finite")
        return found, None

    def _to_next(self, rate: Rate, x: States, h: float) -> States:
        """Return the states ``h`` later, ``nan`` if steps become too small."""
        f = rate(x)
        step, left = self._first_steps(rate, x, f, h), np.full(len(x), h)
        rejected = np.zeros(len(x), dtype=bool)
        while left.any():
            step = np.minimum(step, left)
            after, f_after, error = self._stages(rate, x, f, step)
            with np.errstate(divide="ignore"):
                factor = np.clip(SAFETY * error ** (-1 / 5), LEAST, MOST)
            accepted = error < 1
            x, f = (np.where(accepted[:, None], *pair) for pair in ((after, x), (f_after, f)))
            left = np.where(accepted, left - step, left)
            step = step * np.where(accepted & rejected, np.minimum(factor, 1), factor)
            rejected = ~accepted
            if (~(step > 1e-15 * h) & (left > 0)).any():  # or is no number
                return np.full_like(x, np.nan)
        return x

    def _stages(self, rate: Rate, x: States, f: States, step: Rows) -> tuple[States, States, Rows]:
        """Return states, their rates, and errors over tolerance of a step of Dormand-Prince."""
        slopes, h = [f], step[:, None]
        for weights in (*(row[:i] for i, row in enumerate(RK45.A) if i), RK45.B):
            after = x + h * _combined(slopes, weights)
            slopes.append(rate(after))
        scale = self.atol + np.maximum(np.abs(x), np.abs(after)) * self.rtol
        error = _norm(h * _combined(slopes, RK45.E) / scale)
        return after, slopes[-1], np.where(np.isnan(error), np.inf, error)

    def _first_steps(self, rate: Rate, x: States, f: States, h: float) -> Rows:
        scale = self.atol + np.abs(x) * self.rtol
        d0, d1 = _norm(x / scale), _norm(f / scale)
        still = (d0 < 1e-5) | (d1 < 1e-5)
        h0 = np.minimum(np.where(still, 1e-6, 0.01 * d0 / np.where(still, 1, d1)), h)
        d2 = _norm((rate(x + h0[:, None] * f) - f) / scale) / h0
        most = np.maximum(d1, d2)
        flat = most <= 1e-15
        bent = (0.01 / np.where(flat, 1, most)) ** (1 / 5)
        h1 = np.where(flat, np.maximum(1e-6, 1e-3 * h0), bent)
        return np.minimum(np.minimum(100 * h0, h1), h)


def _combined(slopes: list[np.ndarray], weights: np.ndarray) -> np.ndarray:
    return np.tensordot(weights, np.stack(slopes), axes=1)


def _norm(x: States) -> Rows:
    return np.sqrt(np.square(x).mean(axis=1))
