"""Arguments of a model's methods, read as the batches of tensors that flows work on."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.autograd import forward_ad

from symo_exp.checks import whole_number
from symo_exp.errors import ConfigError, first_line
from symo_exp.mechanics.space import FLAT, Space
from symo_exp.words import counted

Array = Any
"""Numbers of any precision: a tensor on any device, an array, a DataFrame or nested sequences."""
REAL = "biuf"
"""Kinds of NumPy's types that are real numbers."""


def in_transform() -> bool:
    """Return whether a transform of ``torch.func`` is running, such as ``vmap`` or ``grad``.

    PyTorch tells by refusing a call that it refuses nowhere else.
    """
    try:
        torch.empty(0).requires_grad_()
    except RuntimeError:
        return True
    return False


class Inputs:
    """Arguments of one call, for a batch or for a single state, which becomes a batch of one.

    They are brought to the precision and the device of the model. Tensors stay differentiable.

    Args:
        like: The input matrix (n, m) of the model.
        q: Configurations (B, N) or (N,).
        space: Their space, ``N = n`` without rotations.
        transforms: Whether ``torch.func`` can transform the call.

    Raises:
        ConfigError: If ``torch.func`` transforms a call that it cannot transform, or an argument is
            not an array of numbers of the right shape.
    """

    def __init__(
        self, like: Tensor, q: Array, space: Space = FLAT, *, transforms: bool = False
    ) -> None:
        if not transforms and in_transform():
            raise ConfigError(
                "steps and rollouts cannot be transformed by torch.func (vmap, grad, jacrev, ...): "
                "instead of vmap give a batch of states; for derivatives use linearize, or "
                "torch.autograd with step"
            )
        self._like, (self._n, self._m) = like, like.shape
        self._space, self._width = space, space.stored(self._n)
        self._tracked = False
        q, size = self._numbers("q", q), self._width
        if q.ndim not in (1, 2) or q.shape[-1] != size:
            raise ConfigError(
                f"q has shape {tuple(q.shape)}: expected ({size}) for a single state, or "
                f"(batch, {size})"
            )
        self.single, self._batch = q.ndim == 1, q.shape[:-1]
        self.q = q.unsqueeze(0) if self.single else q

    def configuration(self, name: str, x: Array) -> Tensor:
        """Return an argument as (B, N)."""
        return self._read(name, x, self._width)

    def state(self, name: str, x: Array) -> Tensor:
        """Return an argument as (B, n)."""
        return self._read(name, x, self._n)

    def control(self, name: str, u: Array | None) -> Tensor:
        """Return the control as (B, m), zero without one."""
        zero = u is None
        return self._like.new_zeros(len(self.q), self._m) if zero else self._read(name, u, self._m)

    def controls(self, u: Array | None, steps: int | None) -> Tensor:
        """Return ``u`` at every node (B, T+1, m), zero for so many ``steps``."""
        if (u is None) == (steps is None):
            raise ConfigError("a rollout needs either u, the control at every node, or steps")
        if steps is None:
            controls = self._read("u", u, "nodes", self._m)
            if not controls.shape[1]:
                raise ConfigError("u has no nodes: expected at least that of the start")
            return controls
        return self._like.new_zeros(len(self.q), whole_number("steps", steps, low=0) + 1, self._m)

    def gradients(self) -> torch.set_grad_enabled:
        """Return a context that builds a graph only if an argument requires a gradient."""
        return torch.set_grad_enabled(self._tracked and torch.is_grad_enabled())

    def finite(self, name: str, x: Tensor) -> Tensor:
        """Return an argument that was read.

        Raises:
            ConfigError: If a number is not finite.
        """
        if not x.isfinite().all():
            row = int((~x.isfinite()).any(1).nonzero()[0, 0])
            where = "" if self.single else f" in row {row}"
            raise ConfigError(f"{name} is not finite{where}: {x[row].tolist()}")
        return x

    def start(self, name: str) -> Tensor:
        """Return the configurations, from which a motion starts.

        Raises:
            ConfigError: If a number is not finite, or a rotation is none.
        """
        q = self.finite(name, self.q)
        if not (fits := self._space.rotates(q)).all():
            row = int((~fits).nonzero()[0, 0])
            where = "" if self.single else f" in row {row}"
            raise ConfigError(
                f"{name} has no rotation matrix{where}: {q[row].tolist()}; expected the nine "
                "entries of each rotation at the end, row by row (Space.of_quaternions of "
                "symo_exp.mechanics.space converts quaternions)"
            )
        return q

    def _numbers(self, name: str, x: Array) -> Tensor:
        try:
            found = x if isinstance(x, Tensor) else np.asarray(x)
            real = not found.is_complex() if isinstance(found, Tensor) else found.dtype.kind in REAL
            if not real:
                raise TypeError(f"its type is {found.dtype}")
            if isinstance(found, np.ndarray):  # in any order of bytes and of axes
                found = torch.from_numpy(found.astype(np.float64, order="C"))
            self._tracked |= found.requires_grad
            found = found.to(self._like)
        except (TypeError, ValueError, RuntimeError) as error:
            told = f"{name} is not an array of numbers: {first_line(error)}"
            raise ConfigError(told) from None
        if forward_ad.unpack_dual(found).tangent is not None:
            raise ConfigError(
                f"{name} has a tangent (torch.func.jvp or jacfwd), but models have no forward-mode "
                "derivatives: use linearize, or torch.autograd.functional.jacobian of step"
            )
        return found.clone() if found.is_inference() else found  # its copy can have derivatives

    def _read(self, name: str, given: Array, *shape: int | str) -> Tensor:
        """Return numbers of a shape, in which a size given by a name may be any."""
        x, wanted = self._numbers(name, given), (*self._batch, *shape)
        sizes = [a if isinstance(b, str) else b for a, b in zip(x.shape, wanted, strict=False)]
        if x.ndim != len(wanted) or list(x.shape) != sizes:
            kind = "a single state" if self.single else counted(len(self.q), "state")
            fits = ", ".join(map(str, wanted))
            raise ConfigError(f"{name} has shape {tuple(x.shape)}: expected ({fits}) for {kind}")
        return x.unsqueeze(0) if self.single else x
