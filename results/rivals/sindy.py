"""pysindy: sparse regression of the accelerations, explicit and implicit.

The library has the products of sines and cosines of the angles, velocities, inputs and
``tanh(v / 0.1)`` up to a degree. The implicit form has also the products of the accelerations with
those of sines and cosines on the right-hand side of each acceleration (the idea of SINDy-PI with
the left-hand side chosen, Kaheman, Kutz and Brunton 2020), solved by the same sequentially
thresholded least squares.
"""

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import pysindy
import torch
from machines import TIME_STEP, Machine
from polynomials import Products
from torch import Tensor

from symo_exp.evaluation.references import Continuous
from symo_exp.models.starts import RollsOut

NAME, GIVEN = "pysindy", "angles are angles; velocities and accelerations from the recording"
SUBSTEPS = 4
REST = 0.1
"""Velocity [rad/s] below which dry friction fades."""


def quantities(q: Tensor, v: Tensor, u: Tensor, *, dry: bool) -> Tensor:
    """The factors of the library: of free machines sin, cos, v; also tanh and u with motors."""
    return torch.cat((q.sin(), q.cos(), v, *([torch.tanh(v / REST), u] if dry else [])), dim=1)


@dataclass
class Sparse:
    """``(I − C(q)) v̇ = Θ(q, v, u) Ξ``; C is zero in the explicit form."""

    products: Products
    weights: Tensor
    mixed: Products | None
    """Of sines and cosines, that multiply accelerations."""
    coupling: Tensor | None
    """(products, n, n)."""
    dry: bool

    def acceleration(self, q: Tensor, v: Tensor, u: Tensor) -> Tensor:
        right = self.products(quantities(q, v, u, dry=self.dry)) @ self.weights
        if self.mixed is None or self.coupling is None:
            return right
        turned = self.mixed(torch.cat((q.sin(), q.cos()), dim=1))
        matrix = torch.eye(q.shape[1]).to(q) - torch.einsum("bk,kij->bij", turned, self.coupling)
        return torch.linalg.solve_ex(matrix, right)[0]


def differentiated(machine: Machine, given: str, window: int) -> tuple[Tensor, ...]:
    """``q, v, v̇, u`` of all samples; v̇ by pysindy's smoothed differences."""
    settings = {"window_length": window, "polyorder": 3}
    rule = pysindy.SmoothedFiniteDifference(smoother_kws=settings)
    rows = []
    for q, v, u in machine.fine:
        t = machine.fine_step * np.arange(len(q))
        rate = v.numpy() if given == "measured" else rule(q.numpy(), t)
        slope, inner = rule(rate, t), slice(window // 2, -(window // 2))
        fields = q, torch.tensor(np.asarray(rate)), torch.tensor(np.asarray(slope)), u
        rows.append([x[inner] for x in fields])
    return tuple(torch.cat(x) for x in zip(*rows, strict=True))


def fitted(
    machine: Machine, *, velocities: str, window: int, degree: int, threshold: float, implicit: bool
) -> Continuous:
    q, v, a, u = differentiated(machine, velocities, window)
    dry = machine.driven
    z = quantities(q, v, u, dry=dry)
    library = pysindy.PolynomialLibrary(degree=degree)
    library.fit(z[:2].numpy())
    powers = torch.tensor(np.asarray(library.powers_))
    powers = powers[~repeated(powers, machine.n)]
    products = Products.of_powers(powers)
    rows = slice(None, None, max(1, len(z) // 6000))
    theta, slopes, mixed = products(z[rows]), a[rows], None
    factors = theta[:, :0]
    if implicit:
        turning = pysindy.PolynomialLibrary(degree=2)
        turning.fit(z[:2, : 2 * machine.n].numpy())
        powers = torch.tensor(np.asarray(turning.powers_))
        mixed = Products.of_powers(powers[~repeated(powers, machine.n)])  # the first is 1
        factors = mixed(z[rows, : 2 * machine.n])
    terms, size = theta.shape[1], factors.shape[1]
    weights, coupling = [], torch.zeros(size, machine.n, machine.n, dtype=torch.float64)
    for i in range(machine.n):  # no 1 beside its own acceleration, which would be a = a
        others = [factors[:, int(i == j) :] * slopes[:, j : j + 1] for j in range(machine.n)]
        solver = pysindy.STLSQ(threshold=threshold, alpha=1e-6, normalize_columns=True, max_iter=10)
        solver.fit(torch.cat((theta, *others), dim=1).numpy(), slopes[:, i : i + 1].numpy())
        found = torch.tensor(np.asarray(solver.coef_)).flatten()
        weights.append(found[:terms])
        if implicit:
            parts = found[terms:].split([size - int(i == j) for j in range(machine.n)])
            for j, part in enumerate(parts):
                coupling[int(i == j) :, i, j] = part
    whole = torch.stack(weights, 1)
    used = (whole != 0).any(1)
    used[0] = True
    found = Sparse(
        Products(products.index[used]), whole[used], mixed, coupling if implicit else None, dry
    )
    return Continuous(found, TIME_STEP, SUBSTEPS)


def repeated(powers: Tensor, n: int) -> Tensor:
    """Products with cos² of an angle, which ``sin² + cos² = 1`` makes superfluous."""
    return (powers[:, n : 2 * n] > 1).any(1)


def candidates(machine: Machine) -> Iterator[tuple[str, Callable[[], RollsOut]]]:
    forms = [(True, 4), (False, 4), (True, 3), (False, 3), (False, 2)]
    if machine.n == 1:
        forms = [(False, 3), (False, 2), (False, 4)]
    elif machine.driven:
        forms = [(True, 3), (False, 3), (True, 2), (False, 2), (False, 4)]
    derivatives = (("measured", 11), ("from angles", 11), ("from angles", 5))
    for threshold, (velocities, window) in itertools.product((10.0, 1.0, 100.0, 0.1), derivatives):
        for implicit, degree in forms:
            settings = {
                "velocities": velocities, "window": window, "degree": degree,
                "threshold": threshold, "implicit": implicit,
            }  # fmt: skip
            words = (
                f"{'implicit' if implicit else 'explicit'}, degree {degree}, threshold "
                f"{threshold:g}, velocities {velocities}, window {window}"
            )
            yield words, lambda settings=settings: fitted(machine, **settings)
