"""Checks of an inertia and a potential that a class of a user defines."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from symo_exp.errors import ConfigError
from symo_exp.mechanics.lagrangian import Lagrangian, evaluated

STEP = 1e-5
"""Step of difference quotients, relative to the ranges of the coordinates."""


def check_equations(
    lagrangian: Lagrangian, q: Float[Tensor, "batch N"], way: Float[Tensor, "batch n"]
) -> None:
    """Refuse an inertia or a potential that defines no motion, or not the one that it seems to.

    Args:
        lagrangian: The inertia and the potential.
        q: Configurations; their number differs from that of the coordinates.
        way: Steps from them as long as the ranges of the coordinates.

    Raises:
        ConfigError: If a function fails, has the wrong shape or precision or values that are not
            finite, or if automatic differentiation does not find its derivatives; if the inertia
            is not symmetric and positive definite.
    """
    with torch.enable_grad():
        at = q.detach().requires_grad_()
        values = evaluated(lagrangian, at, way.shape[1])
        for name, value in values.items():
            bad = ~value.detach().flatten(1 if value.ndim > 1 else 0).isfinite()
            _refuse(lagrangian, name, q, bad, "is not finite")
        mass = values["mass_matrix"].detach()
        uneven = (mass - mass.mT).abs() > 1e-9 * mass.abs().amax((1, 2), keepdim=True)
        _refuse(lagrangian, "mass_matrix", q, uneven, "is not symmetric")
        _, info = torch.linalg.cholesky_ex(mass)
        _refuse(lagrangian, "mass_matrix", q, info != 0, "is not positive definite")
        for name, value in values.items():
            _check_slope(lagrangian, name, _along(value, way), at, way)


def _refuse(lagrangian: Lagrangian, name: str, q: Tensor, bad: Tensor, told: str) -> None:
    """Refuse values that are bad in some rows."""
    rows = bad.reshape(len(q), -1).any(dim=1)
    if rows.any():
        where = ", ".join(f"{x:.4g}" for x in q[rows][0].tolist())
        raise ConfigError(f"{type(lagrangian).__name__}.{name}(q) {told} at q=[{where}]")


def _along(value: Tensor, way: Tensor) -> Tensor:
    """Return one number in a row: of an inertia, its square of the step."""
    return value if value.ndim == 1 else torch.einsum("bij,bi,bj->b", value, way, way)


def _check_slope(lagrangian: Lagrangian, name: str, value: Tensor, at: Tensor, way: Tensor) -> None:
    """Refuse a function whose derivatives are not those of automatic differentiation.

    Most rows are enough, because a function may have kinks.
    """
    space, function = lagrangian.space, getattr(lagrangian, name)
    found = None
    if value.requires_grad:
        (found,) = torch.autograd.grad(value.sum(), at, retain_graph=True, allow_unused=True)
    q = at.detach()
    slope = torch.zeros_like(way) if found is None else space.pull(q, found)
    with torch.no_grad():
        ahead, behind = (
            _along(function(space.retract(q, sign * STEP * way)), way) for sign in (1.0, -1.0)
        )
    expected, found = (ahead - behind) / (2 * STEP), (slope * way).sum(-1)
    size = torch.maximum(expected.abs(), found.abs())
    wrong = (found - expected).abs() > 1e-4 * size + 1e-8 * value.detach().abs().max()
    if wrong.double().mean() > 0.5:
        raise ConfigError(
            f"{type(lagrangian).__name__}.{name}(q) has other derivatives than automatic "
            "differentiation finds: compute it from q in PyTorch, without detach, item, tolist or "
            "NumPy, and without random numbers"
        )
