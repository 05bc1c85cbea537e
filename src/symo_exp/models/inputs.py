"""What a user hands to a model, read as the batches of tensors that flows work on."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from symo_exp.errors import ConfigError

Array = Any
"""Numbers: a tensor, a NumPy array or nested sequences, of any precision and on any device."""


class Inputs:
    """The arguments of one call, for a batch or for a single state, which becomes a batch of one.

    They are brought to the precision and the device of the model. Tensors stay differentiable.
    """

    def __init__(self, like: Tensor, q: Array) -> None:
        """``like`` is the input matrix (n, m) of the model, ``q`` (B, n) or (n,)."""
        self._like, (self._n, self._m) = like, like.shape
        q = self._numbers("q", q)
        self.single, self._batch = q.ndim != 2, q.shape[:1] if q.ndim == 2 else ()
        self.q = self._read("q", q, self._n)

    def state(self, name: str, x: Array) -> Tensor:
        """(B, n)."""
        return self._read(name, x, self._n)

    def control(self, name: str, u: Array | None) -> Tensor:
        """(B, m); zero without one."""
        zero = u is None
        return self._like.new_zeros(len(self.q), self._m) if zero else self._read(name, u, self._m)

    def controls(self, u: Array | None, steps: int | None) -> Tensor:
        """(B, T+1, m): ``u`` at every node, or zero for so many ``steps``."""
        if (u is None) == (steps is None):
            raise ConfigError("a rollout needs either u, the control at every node, or steps")
        if steps is None:
            return self._read("u", u, "nodes", self._m)
        if not isinstance(steps, int) or steps < 0:
            raise ConfigError(f"steps={steps}: expected a whole number, 0 or more")
        return self._like.new_zeros(len(self.q), steps + 1, self._m)

    def _numbers(self, name: str, x: Array) -> Tensor:
        try:
            return (x if isinstance(x, Tensor) else torch.tensor(x)).to(self._like)
        except (TypeError, ValueError, RuntimeError) as error:
            reason = str(error).partition("\n")[0]
            raise ConfigError(f"{name} is no array of numbers: {reason}") from None

    def _read(self, name: str, given: Array, *shape: int | str) -> Tensor:
        """As many numbers as ``shape`` says; a size with a name is free."""
        x, wanted = self._numbers(name, given), (*self._batch, *shape)
        sizes = [a if isinstance(b, str) else b for a, b in zip(x.shape, wanted, strict=False)]
        if x.ndim != len(wanted) or list(x.shape) != sizes:
            kind = "a single state" if self.single else f"{wanted[0]} states"
            fits = ", ".join(map(str, wanted))
            raise ConfigError(f"{name} has shape {tuple(x.shape)}; ({fits}) fits {kind}")
        return x.unsqueeze(0) if self.single else x
