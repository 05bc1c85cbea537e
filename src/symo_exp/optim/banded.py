"""Residuals along trajectories, banded since each depends on three consecutive nodes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.linalg import lapack
from torch import Tensor

from symo_exp.mechanics.space import Space, space_of
from symo_exp.mechanics.types import Trajectory, Windows
from symo_exp.nets.affine import parameter_jacobian

WindowResiduals = Callable[[Windows], Float[Tensor, "windows k"]]
"""Maps samples of three nodes to their residuals."""


class Chain(NamedTuple):
    """The nodes of trajectories of any lengths, one after another, and the windows over them.

    ``x`` holds the measured values at a node: the configuration or the state, and possibly the
    inputs, last. A configuration with rotations is given by its coordinates in the chart at the
    measured one, ``base``.
    """

    x: Float[Tensor, "nodes d"]
    u: Float[Tensor, "nodes m"]
    centre: Int[Tensor, " windows"]
    """The middle node of each window."""
    n: int
    inputs: bool
    base: Float[Tensor, "nodes N"]
    space: Space

    @staticmethod
    def of(trajectories: Sequence[Trajectory], *, velocities: bool, inputs: bool = False) -> Chain:
        """Return the chain of some trajectories; no window extends over two of them.

        Args:
            trajectories: The trajectories; those of fewer than three nodes have no window.
            velocities: Whether ``x`` has velocities.
            inputs: Whether ``x`` has inputs.
        """
        q, v, u = (torch.cat(fields) for fields in zip(*trajectories, strict=True))
        of = torch.repeat_interleave(torch.tensor([len(t.q) for t in trajectories]))
        centre = (of[2:] == of[:-2]).nonzero().squeeze(1) + 1
        space = space_of(q, v)
        parts = [space.origin(q), *([v] if velocities else []), *([u] if inputs else [])]
        return Chain(torch.cat(parts, dim=1), u, centre, v.shape[1], inputs, q, space)

    @property
    def known(self) -> int:
        """Columns of ``x`` without the inputs."""
        return self.x.shape[1] - (self.u.shape[1] if self.inputs else 0)

    def weights(
        self, sizes: Float[Tensor, " n"], velocities: float, inputs: float
    ) -> Float[Tensor, " d"]:
        """Return the noise of each column: ``sizes`` of configurations and, over it, of others."""
        found = torch.full((self.x.shape[1],), inputs, dtype=torch.float64)
        found[: self.n] = sizes
        if self.known > self.n:
            found[self.n : self.known] = velocities * sizes
        return found

    def stencil(self, x: Float[Tensor, "nodes d"]) -> tuple[Tensor, Tensor, Tensor]:
        """Return the three nodes of every window, (windows, d) each."""
        return x[self.centre - 1], x[self.centre], x[self.centre + 1]

    def windows(self, before: Tensor, at: Tensor, after: Tensor) -> Windows:
        """Return samples of three nodes, with zero velocities if the nodes have none."""
        n, known, nodes = self.n, self.known, (before, at, after)
        none = torch.zeros_like(at[:, :n])
        v, v_next = (x[:, n:known] if known > n else none for x in (at, after))
        u = [x[:, known:] for x in nodes] if self.inputs else self.stencil(self.u)
        bases = self.stencil(self.base)
        a, b, c = (self.space.point(q, x[:, :n]) for q, x in zip(bases, nodes, strict=True))
        return Windows(a, b, c, v, v_next, *u)

    def weighted(
        self, residuals: WindowResiduals, nodes: Sequence[Tensor], weight: Float[Tensor, " d"]
    ) -> Float[Tensor, "windows k"]:
        """Return residuals at the three nodes of every window over their noise.

        Residuals are in the units of the coordinates, those of velocities over their weight.
        """
        found = residuals(self.windows(*nodes))
        sizes = weight[: self.n].repeat(found.shape[1] // self.n)
        return found / (weight[: len(sizes)] / sizes)

    def linearised(
        self,
        residuals: WindowResiduals,
        x: Float[Tensor, "nodes d"],
        weight: Float[Tensor, " d"],
        parameters: Sequence[Tensor] = (),
    ) -> tuple[Tensor, Tensor, tuple[Tensor, ...]]:
        """Return ``r``, ``J_θ`` and ``J_x`` at nodes ``x``, in units of their noise ``weight``."""
        nodes = [y.clone().requires_grad_() for y in self.stencil(x)]
        r, by_theta, by_x = parameter_jacobian(
            lambda: self.weighted(residuals, nodes, weight), parameters, nodes
        )
        return r, by_theta, tuple(j * weight for j in by_x)

    def spread(
        self, jacobians: Sequence[Float[Tensor, "windows k d"]], y: Float[Tensor, "windows k"]
    ) -> Float[Tensor, "nodes d"]:
        """Return ``Jᵀ y`` with the derivatives of every window in its three nodes."""
        total = torch.zeros_like(self.x)
        for shift, jacobian in zip((-1, 0, 1), jacobians, strict=True):
            total.index_add_(0, self.centre + shift, (jacobian * y.unsqueeze(-1)).sum(1))
        return total

    def apply(
        self, jacobians: Sequence[Float[Tensor, "windows k d"]], x: Float[Tensor, "nodes d"]
    ) -> Float[Tensor, "windows k"]:
        """Return ``J x``."""
        parts = zip(jacobians, self.stencil(x), strict=True)
        return sum(((j * y.unsqueeze(1)).sum(-1) for j, y in parts), torch.zeros(()).to(x))

    def factor(
        self, jacobians: Sequence[Float[Tensor, "windows k d"]], own: float
    ) -> BandFactor | None:
        """Factor ``J Jᵀ + own I``; windows two apart share one node at most.

        Returns:
            The Cholesky factor, ``None`` if the matrix is not positive definite in floating point.
        """
        a, b, c = jacobians
        joined = self.centre.diff() == 1  # windows of one trajectory
        second = joined[1:] & joined[:-1]
        blocks = (
            a @ a.mT + b @ b.mT + c @ c.mT,
            (a[1:] @ b[:-1].mT + b[1:] @ c[:-1].mT) * joined.view(-1, 1, 1),
            (a[2:] @ c[:-2].mT) * second.view(-1, 1, 1),
        )
        return BandFactor.of(blocks, own)


class BandFactor:
    """The Cholesky factor ``L`` of a symmetric block-banded matrix ``S = L Lᵀ``.

    Args:
        band: The lower bands of ``L``, as LAPACK stores them.
        shape: Number and size of the blocks.
    """

    def __init__(self, band: np.ndarray, shape: tuple[int, int]) -> None:
        self._band, self._shape = band, shape

    @staticmethod
    def of(blocks: Sequence[Float[Tensor, "blocks m m"]], own: float) -> BandFactor | None:
        """Factor the matrix with blocks ``(k, k)``, ``(k+1, k)`` and ``(k+2, k)``, plus ``own I``.

        Returns:
            The factor, ``None`` if the matrix is not positive definite in floating point.
        """
        count, m, _ = blocks[0].shape
        band = np.zeros((len(blocks) * m, count, m))
        for offset, block in enumerate(blocks):
            values = block.numpy()
            for i in range(m):
                for j in range(m):
                    if offset * m + i >= j:
                        band[offset * m + i - j, : len(values), j] = values[:, i, j]
        flat = np.asfortranarray(band.reshape(len(blocks) * m, -1))
        flat[0] += own
        factor, info = lapack.dpbtrf(flat, lower=1, overwrite_ab=1)
        # LAPACK does not report NaN, which always reaches the diagonal of the factor.
        return (
            BandFactor(factor, (count, m)) if info == 0 and np.isfinite(factor[0]).all() else None
        )

    @property
    def log_determinant(self) -> float:
        """The logarithm of the determinant of ``S``."""
        return float(2.0 * np.log(self._band[0]).sum())

    def whiten(self, x: Float[Tensor, "blocks m *k"]) -> Float[Tensor, "rows k"]:
        """Return ``L⁻¹ x``, a row for each row of ``S``."""
        found, _ = lapack.dtbtrs(self._band, self._rows(x), uplo=b"L")
        return torch.from_numpy(np.ascontiguousarray(found))

    def solve(self, x: Float[Tensor, "blocks m"]) -> Float[Tensor, "blocks m"]:
        """Return ``S⁻¹ x``."""
        found, _ = lapack.dpbtrs(self._band, self._rows(x), lower=1)
        return torch.from_numpy(found).view(self._shape)

    def _rows(self, x: Tensor) -> np.ndarray:
        return x.reshape(self._shape[0] * self._shape[1], -1).numpy()
