"""Polynomials as lists of products, evaluated in one gather."""

from typing import NamedTuple

import torch
from torch import Tensor


class Products(NamedTuple):
    """Products of columns; the column after the last one is 1.

    Attributes:
        index: Columns of each product (terms, degree).
    """

    index: Tensor

    @classmethod
    def of_powers(cls, powers: Tensor) -> "Products":
        """Return the products with such exponents (terms, columns)."""
        degree, one = max(1, int(powers.sum(1).max())), powers.shape[1]
        rows = []
        for row in powers.tolist():
            factors = [j for j, power in enumerate(row) for _ in range(int(power))]
            rows.append(factors + [one] * (degree - len(factors)))
        return cls(torch.tensor(rows))

    def __call__(self, z: Tensor) -> Tensor:
        whole = torch.cat((z, torch.ones_like(z[:, :1])), dim=1)
        return whole[:, self.index].prod(-1)
