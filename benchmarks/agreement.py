"""Agreement of all contenders in loss, gradient and prediction with a float64 reference.

The reference is baseline (a) in float64. Baseline (a) is timed through the adjoint, whose
gradient is that of another discretisation (thesis section 4.2.2); the comparison takes the exact
one, by backpropagation through the step.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from benchmarks.cases import CASES, METHODS, system_windows
from benchmarks.contenders import Autograd, Contender, Jax, jax_is_installed
from benchmarks.plausible import plausible_weights
from benchmarks.project import Project

LOSS_TOLERANCE = 1e-3
GRADIENT_TOLERANCE = 2e-3
PREDICTION_TOLERANCE = 1e-4
"""Relative error of the loss, of the gradient (Euclidean norm), and largest error of a
configuration [m or rad], all in float32: the discrete Euler-Lagrange residual divides differences
of configurations by h."""


@dataclass(frozen=True)
class Difference:
    """Errors of a contender relative to the reference."""

    system: str
    method: str
    contender: str
    loss: float
    gradient: float
    prediction: float

    @property
    def acceptable(self) -> bool:
        """Return whether every error is within its tolerance."""
        return (
            self.loss <= LOSS_TOLERANCE
            and self.gradient <= GRADIENT_TOLERANCE
            and self.prediction <= PREDICTION_TOLERANCE
        )


def exact(method: str) -> dict[str, bool]:
    """The option of baseline (a) that asks for the gradient of the step itself."""
    return {"adjoint": False} if method in ("node", "l_node") else {}


def differences(
    system: str, method: str, rows: int = 128, *, compiled: bool = False
) -> list[Difference]:
    """Every contender beside the reference, on the same weights and data."""
    case, layers = CASES[system], plausible_weights(system, method)
    windows = system_windows(system, rows)
    reference = Autograd(method, case, layers, dtype=torch.float64, **exact(method))
    batch = reference.prepare(windows)
    true_loss, true_slope = reference.loss_and_gradient(batch)
    true_configuration = reference.predict(batch)
    contenders: dict[str, Contender] = {"autograd": Autograd(method, case, layers, **exact(method))}
    if jax_is_installed():
        contenders["jax"] = Jax(method, case, layers)
    contenders["project"] = Project(method, case, layers)
    if compiled:
        contenders["compiled"] = Project(method, case, layers, compiled=True)
    found = []
    for name, contender in contenders.items():
        batch = contender.prepare(windows)
        loss, slope = contender.loss_and_gradient(batch)
        error = sum(np.sum((a - b) ** 2) for a, b in zip(slope, true_slope, strict=True))
        size = sum(np.sum(b**2) for b in true_slope)
        configuration = np.abs(contender.predict(batch) - true_configuration).max()
        found.append(
            Difference(
                system,
                method,
                name,
                abs(loss - true_loss) / true_loss,
                float(np.sqrt(error / size)),
                float(configuration),
            )
        )
    return found


def check(systems: list[str], methods: list[str], *, compiled: bool = False) -> list[Difference]:
    """All differences; raises in one sentence if one is too large."""
    rows = [d for s in systems for m in methods for d in differences(s, m, compiled=compiled)]
    for row in rows:
        if not row.acceptable:
            raise SystemExit(f"the contenders do not compute the same numbers: {row}")
    return rows


if __name__ == "__main__":
    for row in check(list(CASES), list(METHODS)):
        print(row)
