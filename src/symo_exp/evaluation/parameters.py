"""The physical parameters of a learned model: values, uncertainty and determination by data."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from symo_exp.mechanics.forced import ForcedLagrangian
from symo_exp.mechanics.types import Coordinates
from symo_exp.nets.known import KnownLagrangian
from symo_exp.nets.readings import Reading, readings
from symo_exp.optim.posterior import Posterior

STRUCTURAL = 1e-6
"""Share of a gradient along directions without information that makes a number undetermined."""
SMALL = 1e-4
"""Entries of reduced matrices below this, relative to the largest, count as zero."""
ABSENT = 1e-20
"""Square below which nothing of it is there, such as friction that the data do not show."""
FEW = 6
"""Partners that a note names."""
RELATIVE = "up to a factor"
"""Unit of forces and inertias that were learned without known forces."""


class Parameter(NamedTuple):
    """A row of ``parameters.csv``."""

    name: str
    value: float
    unit: str
    standard_deviation: float
    """Not a number where there is no posterior or the data do not determine the value."""
    determined: str
    """``yes``, ``weakly`` (the standard deviation exceeds the value), ``no`` or ``unknown``."""
    note: str


def physical_parameters(
    lagrangian: Any,
    coordinates: Coordinates,
    parameters: Sequence[Tensor],
    posterior: Posterior | None,
    *,
    driven: bool = True,
) -> list[Parameter]:
    """Return the physical parameters of a learned Lagrangian; none of a network.

    A number is determined if it does not change along the directions of the posterior without
    information. Numbers that are not are named with those that they are determined with; where
    products of powers of positive numbers are determined, these follow as rows of their own.

    Args:
        lagrangian: The learned Lagrangian, with its dissipation.
        coordinates: Coordinates of the system.
        parameters: All parameters of the model, in the order of the posterior.
        posterior: Their posterior, where there is one.
        driven: Whether known forces act. If not, learned forces and inertias have no unit; those
            of known equations do, as their constants may be given.
    """
    with torch.enable_grad():
        found = readings(lagrangian, coordinates)
        conservative = lagrangian
        while isinstance(conservative, ForcedLagrangian):
            conservative = conservative.conservative
        if not driven and not isinstance(conservative, KnownLagrangian):
            found = [_without_scale(reading) for reading in found]
        gradients = [_gradient(reading, parameters) for reading in found]
    if posterior is None:
        return [
            Parameter(r.name, float(r.value.detach()), r.unit, math.nan, "unknown", "no posterior")
            for r in found
        ]
    if not found:
        return []
    slopes = torch.stack(gradients).to(posterior.mean)
    along = slopes @ posterior.free
    size = slopes.norm(dim=1).clamp_min(1e-300)
    values = torch.stack([reading.value.detach().double() for reading in found])
    there = (values.abs() > ABSENT) | (size > ABSENT**0.5)
    least = torch.where(there, STRUCTURAL * size, torch.inf).unsqueeze(1)
    along = torch.where(along.abs() > least, along, 0.0)
    deviations = (slopes @ posterior.directions).norm(dim=1)
    partners = _partners(along)
    rows = []
    for i, reading in enumerate(found):
        value, deviation = float(values[i]), float(deviations[i])
        if partners[i]:
            names = [found[j].name for j in partners[i] if j != i]
            told = ", ".join(names[:FEW]) + (f" and {len(names) - FEW} more" * (len(names) > FEW))
            others = told or "terms that are not listed"
            note = f"determined only together with {others}"
            rows.append(Parameter(reading.name, value, reading.unit, math.nan, "no", note))
        elif not there[i]:
            note = "none was found"
            rows.append(Parameter(reading.name, 0.0, reading.unit, math.nan, "no", note))
        elif deviation > abs(value):
            note = "the standard deviation exceeds the value"
            rows.append(Parameter(reading.name, value, reading.unit, deviation, "weakly", note))
        else:
            rows.append(Parameter(reading.name, value, reading.unit, deviation, "yes", ""))
    free = [i for i, own in enumerate(partners) if own and float(values[i]) > 0.0]
    factors = [found[i] for i in free]
    return rows + _products(factors, values[free], slopes[free], along[free], posterior)


def _without_scale(reading: Reading) -> Reading:
    mechanical = any(part.startswith(("N", "kg")) for part in reading.unit.split())
    return reading._replace(unit=RELATIVE) if mechanical else reading


def _gradient(reading: Reading, parameters: Sequence[Tensor]) -> Float[Tensor, " p"]:
    if not reading.value.requires_grad:
        return torch.cat([torch.zeros_like(p).flatten() for p in parameters])
    found = torch.autograd.grad(
        reading.value, list(parameters), retain_graph=True, materialize_grads=True
    )
    return torch.cat([g.flatten() for g in found])


def _partners(along: Float[Tensor, "readings free"]) -> list[list[int]]:
    """Return the numbers that change with each one along directions without information."""
    reduced = _reduced(along.T).T
    touched = reduced != 0.0
    return [
        touched[:, row].any(1).nonzero().flatten().tolist() if row.any() else [] for row in touched
    ]


def _products(
    found: Sequence[Reading],
    values: Float[Tensor, " readings"],
    slopes: Float[Tensor, "readings p"],
    along: Float[Tensor, "readings free"],
    posterior: Posterior,
) -> list[Parameter]:
    """Return the products of powers that are determined though their factors are not."""
    if not found or along.shape[1] == 0:
        return []
    logarithmic = along / values.unsqueeze(1)
    _, sizes, right = torch.linalg.svd(logarithmic.T, full_matrices=True)
    rank = int((sizes > STRUCTURAL * sizes.amax().clamp_min(1e-300)).sum())
    powers = _reduced(right[rank:])
    rows = []
    for power in powers:
        doubled = (2.0 * power).round()
        plain = bool((2.0 * power - doubled).abs().max() < 1e-3 and doubled.abs().max() <= 8)
        if not plain or int((doubled != 0).sum()) < 2:
            continue
        exact = doubled if (doubled % 2 != 0).any() else 0.5 * doubled
        name = _product(exact, [reading.name for reading in found])
        unit = _product(exact, [f"({reading.unit})" for reading in found])
        value = float((exact * values.log()).sum().exp())
        slope = value * (exact / values) @ slopes
        deviation = float((slope @ posterior.directions).norm())
        sure = "yes" if deviation <= value else "weakly"
        rows.append(Parameter(name, value, unit, deviation, sure, "product that is determined"))
    return rows


def _product(powers: Tensor, names: Sequence[str]) -> str:
    parts = [
        name if power == 1.0 else f"{name}^{power:g}"
        for name, power in zip(names, powers.tolist(), strict=True)
        if power != 0.0
    ]
    return " ".join(parts)


def _reduced(matrix: Float[Tensor, "rows columns"]) -> Float[Tensor, "rank columns"]:
    """Return the reduced row echelon form, pivots by size."""
    left = matrix.clone().double()
    size = float(left.abs().max()) if left.numel() else 0.0
    done: list[int] = []
    for row in range(len(left)):
        rest = left[row:].abs()
        if rest.numel() == 0 or float(rest.max()) <= SMALL * size:
            return left[:row]
        at = int(rest.argmax())
        pivot, column = row + at // left.shape[1], at % left.shape[1]
        left[[row, pivot]] = left[[pivot, row]]
        left[row] = left[row] / left[row, column]
        for other in range(len(left)):
            if other != row:
                left[other] = left[other] - left[other, column] * left[row]
        left = torch.where(left.abs() > SMALL, left, 0.0)
        size = 1.0
        done.append(column)
    return left
