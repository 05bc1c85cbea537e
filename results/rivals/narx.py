"""sysidentpy: a polynomial NARX model of each velocity difference, terms selected by FROLS.

``y = (q_{k+1} − q_k) / h`` of each angle is a polynomial of its values one step before, of sines
and cosines of the angles and of the inputs at k. The regressors of all trajectories are built by
sysidentpy's ``Polynomial``, selected by its error reduction ratio and estimated by its least
squares; they are stacked here because its ``fit`` takes one uninterrupted series.
"""

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import torch
from machines import TIME_STEP, Machine
from polynomials import Products
from sysidentpy.basis_function import Polynomial
from sysidentpy.model_structure_selection import FROLS
from sysidentpy.parameter_estimation import LeastSquares
from torch import Tensor

from symo_exp.mechanics.types import Trajectories
from symo_exp.models.starts import RollsOut

NAME, GIVEN = "sysidentpy", "angles are angles"


def regressors(y: Tensor, q: Tensor, u: Tensor, *, driven: bool) -> Tensor:
    return torch.cat((y, q.sin(), q.cos(), *([u] if driven else [])), dim=1)


@dataclass
class Narx:
    """``q_{k+1} = q_k + h F(y_{k−1}, q_k, u_k)`` with ``y_{k−1} = (q_k − q_{k−1}) / h``."""

    products: list[Products]
    weights: list[Tensor]
    driven: bool
    time_step = TIME_STEP

    def rollout(self, q0: Tensor, v0: Tensor, u: Tensor) -> Trajectories:
        q, y = [q0], [v0]
        for held in u[:, :-1].unbind(1):
            z = regressors(y[-1], q[-1], held, driven=self.driven)
            parts = [p(z) @ w for p, w in zip(self.products, self.weights, strict=True)]
            y.append(torch.stack(parts, 1))
            q.append(q[-1] + TIME_STEP * y[-1])
        return Trajectories(torch.stack(q, 1), torch.stack(y, 1), u)


def fitted(machine: Machine, *, degree: int, terms: int) -> Narx:
    driven = machine.driven
    past, now = [], []
    for q, _, u in machine.train:
        y = (q[1:] - q[:-1]) / TIME_STEP
        past.append(regressors(y[:-1], q[1:-1], u[1:-1], driven=driven))
        now.append(y[1:])
    z, y = torch.cat(past).numpy(), torch.cat(now).numpy()
    basis = Polynomial(degree=degree)
    model = FROLS(
        n_terms=terms, order_selection=False, ylag=1, xlag=1, basis_function=basis,
        estimator=LeastSquares(),
    )  # fmt: skip
    model.max_lag = 0
    psi = basis.fit(np.hstack((np.ones((len(z), 1)), z)), max_lag=0)
    powers = exponents(z.shape[1], degree)
    some = torch.tensor(z[:50])
    np.testing.assert_allclose(Products.of_powers(powers)(some).numpy(), psi[:50])
    products, weights = [], []
    for i in range(machine.n):
        target = y[:, i : i + 1]
        _, order, chosen = model.error_reduction_ratio(psi, target, min(terms, psi.shape[1]))
        theta = model.estimator.optimize(chosen, target)
        kept = torch.tensor(order[: chosen.shape[1]])
        products.append(Products.of_powers(powers[kept]))
        weights.append(torch.tensor(np.asarray(theta)).flatten())
    return Narx(products, weights, driven)


def exponents(columns: int, degree: int) -> Tensor:
    """Exponents in the order of ``Polynomial``: combinations with repetition of 1 and columns."""
    rows = []
    for combination in itertools.combinations_with_replacement(range(columns + 1), degree):
        rows.append([combination.count(j + 1) for j in range(columns)])
    return torch.tensor(rows)


def candidates(machine: Machine) -> Iterator[tuple[str, Callable[[], RollsOut]]]:
    degrees = (3, 2, 4) if machine.n == 1 else (3, 4, 2)
    for degree, terms in itertools.product(degrees, (20, 40, 10, 80, 160)):
        words = f"degree {degree}, {terms} terms"
        yield words, lambda degree=degree, terms=terms: fitted(machine, degree=degree, terms=terms)
