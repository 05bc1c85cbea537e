"""The physical parameters of a learned model: values, uncertainty and determination by data."""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from typing import Any, NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from symo_exp.mechanics.forced import ForcedLagrangian
from symo_exp.mechanics.types import Coordinates
from symo_exp.mechanics.units import powers_in, product
from symo_exp.nets.inputs import LearnedInputs
from symo_exp.nets.known import KnownLagrangian
from symo_exp.nets.readings import Reading, readings
from symo_exp.optim.posterior import Posterior

STRUCTURAL = 1e-6
"""Share of a gradient along directions without information that makes a number undetermined."""
SMALL = 1e-4
"""Entries of reduced matrices below this, relative to the largest, count as zero."""
ABSENT = 1e-20
"""Square below which a quantity counts as absent, such as friction that the data do not show, in
the units of the machine."""
ENDED = 1e-9
"""Slope of a learned number, relative to its value, below which it is at the end of its range."""
FEW = 6
"""Partners that a note names."""
RELATIVE = "up to a factor"
"""Unit of friction that was learned without known forces, by a model without inertias."""


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
    inputs: LearnedInputs | None = None,
) -> list[Parameter]:
    """Return the physical parameters of a learned Lagrangian; none of a network.

    A number is determined if it does not change along the directions of the posterior without
    information, and is not at the end of its range, where it changes in no direction. Numbers that
    are not are named with those that they are determined with; where sums and differences of
    numbers with the same unit are determined, these are rows of their own, and so are products of
    powers of the other positive numbers. Rows that are determined come first.

    Without known forces, motions determine inertias and forces up to a common factor. They are
    then divided by one of the inertias, that which leaves the fewest numbers undetermined.

    Args:
        lagrangian: The learned Lagrangian, with its dissipation.
        coordinates: Coordinates of the system.
        parameters: All parameters of the model, in the order of the posterior.
        posterior: Their posterior, where there is one.
        driven: Whether known forces act. If not, learned forces and inertias are relative; those
            of known equations are not, as their constants may be given.
        inputs: The input matrix, if it was learned.
    """
    with torch.enable_grad():
        found = [*readings(lagrangian, coordinates), *readings(inputs, coordinates)]
        conservative = lagrangian
        while isinstance(conservative, ForcedLagrangian):
            conservative = conservative.conservative
        slopes = [_gradient(reading, parameters) for reading in found]
    if not found:
        return []
    names, units, exact, parts = zip(*found, strict=True)
    values = torch.stack([value.detach().double() for value in exact])
    by_parameters = torch.stack(slopes).double()
    sizes = torch.tensor([coordinates.units.size(unit) for unit in units], dtype=torch.float64)
    there = (values.abs() > ABSENT * sizes) | (by_parameters.norm(dim=1) > ABSENT**0.5 * sizes)
    numbers = _Numbers(names, units, values, by_parameters, there)
    one = None
    if not driven and not isinstance(conservative, KnownLagrangian):
        one, numbers = _relative(numbers, posterior)
    plain = [i for i, own in enumerate(parts) if not own]
    rows = _rows(numbers.only(plain), posterior)
    rows += _combined(numbers, parts, {x.name for x in rows if x.determined == "no"}, posterior)
    if one is not None:
        note = "set to 1: without known forces, inertias and forces are relative to it"
        rows[one] = Parameter(names[one], 1.0, units[one], math.nan, "no", note)
    return sorted(rows, key=lambda row: row.determined == "no")


class _Numbers(NamedTuple):
    """Physical numbers and their derivatives in the parameters."""

    names: Sequence[str]
    units: Sequence[str]
    values: Float[Tensor, " numbers"]
    slopes: Float[Tensor, "numbers p"]
    there: Bool[Tensor, " numbers"]
    """Whether each is present; a square that vanished, as of friction, is absent."""

    def only(self, index: Sequence[int]) -> _Numbers:
        """Return some of the numbers."""
        names, units = [self.names[i] for i in index], [self.units[i] for i in index]
        return _Numbers(names, units, *(x[list(index)] for x in self[2:]))


def _relative(numbers: _Numbers, posterior: Posterior | None) -> tuple[int | None, _Numbers]:
    """Return the number that all inertias and forces are divided by, and the quotients."""
    powers = [powers_in(unit)[2] for unit in numbers.units]
    mechanical = [i for i, power in enumerate(powers) if power]
    inertias = [
        i for i in mechanical if numbers.units[i].startswith("kg") and numbers.values[i] > 0.0
    ]
    if not inertias:
        units = [RELATIVE if i in mechanical else x for i, x in enumerate(numbers.units)]
        return None, numbers._replace(units=units)

    def undetermined(one: int) -> int:
        if posterior is None:
            return 0
        return int((_free(_over(numbers, powers, one), posterior) != 0.0).any(1).sum())

    chosen = min(inertias, key=undetermined)
    return chosen, _over(numbers, powers, chosen)


def _over(numbers: _Numbers, powers: Sequence[Fraction], one: int) -> _Numbers:
    """Return the numbers, each divided by a power of one of them, that of mass in its unit."""
    power = torch.tensor([float(x) for x in powers], dtype=torch.float64)
    size = numbers.values[one] ** power
    values = numbers.values / size
    common = (power * values).unsqueeze(1) * numbers.slopes[one] / numbers.values[one]
    slopes = numbers.slopes / size.unsqueeze(1) - common
    unit, units = numbers.units[one], list(numbers.units)
    for i, own in enumerate(powers):
        if own:
            by = f"({unit})" if own == 1 else f"({unit})^({own})"
            units[i] = "1" if units[i] == unit else f"{units[i]} / {by}"
    return numbers._replace(units=units, values=values, slopes=slopes)


def _free(numbers: _Numbers, posterior: Posterior) -> Float[Tensor, "numbers free"]:
    """Return the derivatives along directions without information, zero where negligible."""
    along = numbers.slopes @ posterior.free.double()
    size = numbers.slopes.norm(dim=1).clamp_min(1e-300)
    least = torch.where(numbers.there, STRUCTURAL * size, torch.inf).unsqueeze(1)
    return torch.where(along.abs() > least, along, 0.0)


def _rows(numbers: _Numbers, posterior: Posterior | None) -> list[Parameter]:
    """Return a row for each number, then those of combinations that are determined."""
    if posterior is None:
        return [
            Parameter(name, float(value), unit, math.nan, "unknown", "no posterior")
            if present
            else _absent(name, unit)
            for name, unit, value, _, present in zip(*numbers, strict=True)
        ]
    along = _free(numbers, posterior)
    size = numbers.slopes.norm(dim=1, keepdim=True).clamp_min(1e-300)
    # the first reduction takes small numbers, such as inertias of light links, for zero
    each = zip(_partners(along), _partners(along / size), strict=True)
    partners = [own or relative for own, relative in each]
    rows = []
    for i, (name, unit, value, slope, present) in enumerate(zip(*numbers, strict=True)):
        if partners[i]:
            others = _others(numbers.names, partners[i], i)
            note = f"determined only together with {others}" if others else "data do not show it"
            rows.append(Parameter(name, float(value), unit, math.nan, "no", note))
        elif not present:
            rows.append(_absent(name, unit))
        elif 0.0 < slope.norm() <= ENDED * value.abs():
            rows.append(Parameter(name, float(value), unit, math.nan, "no", "the end of its range"))
        else:
            rows.append(_certain(name, unit, value, slope, posterior))
    free = [i for i, own in enumerate(partners) if own]
    sums, terms = _sums(numbers.only(free), along[free], posterior)
    free = [i for i in free if numbers.names[i] not in terms and float(numbers.values[i]) > 0.0]
    return rows + sums + _products(numbers.only(free), along[free], posterior)


def _combined(
    numbers: _Numbers, parts: Sequence[Sequence[str]], free: set[str], posterior: Posterior | None
) -> list[Parameter]:
    """Return rows of combinations that the data determine though not their ``parts``.

    Args:
        numbers: All numbers.
        parts: Names of the numbers that each combines.
        free: Names of those that the data do not determine.
        posterior: Nothing is determined without one.
    """
    if posterior is None:
        return []
    fixed = (_free(numbers, posterior) == 0.0).all(dim=1) & numbers.there
    note = "the combination that is determined"
    return [
        _certain(name, unit, value, slope, posterior, note)
        for name, unit, value, slope, own, known in zip(*numbers[:4], parts, fixed, strict=True)
        if known and free.intersection(own)
    ]


def _absent(name: str, unit: str) -> Parameter:
    """Return the row of a number that vanished."""
    return Parameter(name, 0.0, unit, math.nan, "no", "none was found")


def _certain(
    name: str, unit: str, value: Tensor, slope: Tensor, posterior: Posterior, note: str = ""
) -> Parameter:
    """Return the row of a number or of a combination that is determined."""
    deviation = float((slope @ posterior.without_prior().double()).norm())
    if deviation <= abs(float(value)):
        return Parameter(name, float(value), unit, deviation, "yes", note)
    note += f"{', but ' * bool(note)}the standard deviation exceeds the value"
    return Parameter(name, float(value), unit, deviation, "weakly", note)


def _others(names: Sequence[str], partners: Sequence[int], own: int) -> str:
    """Return the first partners of a number in words, empty if it has none but itself."""
    others = [names[j] for j in partners if j != own]
    more = f" and {len(others) - FEW} more" if len(others) > FEW else ""
    return ", ".join(others[:FEW]) + more


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


def _determined(along: Float[Tensor, "numbers free"]) -> Float[Tensor, "rows numbers"]:
    """Return linear combinations that do not change along directions without information."""
    if along.numel() == 0:
        return along.new_zeros(0, len(along))
    _, sizes, right = torch.linalg.svd(along.T, full_matrices=True)
    rank = int((sizes > STRUCTURAL * sizes.amax().clamp_min(1e-300)).sum())
    return _reduced(right[rank:])


def _sums(
    numbers: _Numbers, along: Float[Tensor, "numbers free"], posterior: Posterior
) -> tuple[list[Parameter], set[str]]:
    """Return the sums and differences that are determined though their terms are not.

    The second result has the names of the terms.
    """
    rows: list[Parameter] = []
    every: set[str] = set()
    for unit in dict.fromkeys(numbers.units):
        same = [i for i, x in enumerate(numbers.units) if x == unit]
        names, _, values, slopes, _ = numbers.only(same)
        for combination in _determined(along[same]):
            signs = combination.round()
            plain = bool((combination - signs).abs().max() < 1e-3 and signs.abs().max() == 1.0)
            if not plain or int((signs != 0.0).sum()) < 2:
                continue
            signs *= signs[signs != 0.0][0]  # the first term is added
            terms = {x: sign for x, sign in zip(names, signs.tolist(), strict=True) if sign}
            told = " ".join(f"{'-' if sign < 0.0 else '+'} {x}" for x, sign in terms.items())
            name, note = told.removeprefix("+ "), "the combination that is determined"
            rows.append(_certain(name, unit, signs @ values, signs @ slopes, posterior, note))
            every |= terms.keys()
    return rows, every


def _products(
    factors: _Numbers, along: Float[Tensor, "numbers free"], posterior: Posterior
) -> list[Parameter]:
    """Return the products of powers that are determined though their factors are not."""
    names, units, values, slopes, _ = factors
    rows = []
    for power in _determined(along / values.unsqueeze(1)):
        doubled = (2.0 * power).round()
        plain = bool((2.0 * power - doubled).abs().max() < 1e-3 and doubled.abs().max() <= 8)
        if not plain or int((doubled != 0).sum()) < 2:
            continue
        exact = doubled if (doubled % 2 != 0).any() else 0.5 * doubled
        name = _product(exact, names)
        own = [(unit, x) for unit, x in zip(units, exact.tolist(), strict=True) if x]
        unit = RELATIVE if RELATIVE in dict(own) else product(own)
        value = (exact * values.log()).sum().exp()
        slope = value * (exact / values) @ slopes
        rows.append(_certain(name, unit, value, slope, posterior, "product that is determined"))
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
    return left
