"""Derivatives by central differences, which those of the sources are compared with."""

from collections.abc import Callable, Sequence

import torch
from torch import Tensor


def slopes(function: Callable[[Tensor], Tensor], x: Tensor, eps: float = 1e-5) -> Tensor:
    """Derivatives with respect to the last axis of ``x``, each in a last axis of its own."""
    columns = []
    for i in range(x.shape[-1]):
        shift = torch.zeros_like(x)
        shift[..., i] = eps
        with torch.no_grad():
            columns.append((function(x + shift) - function(x - shift)) / (2 * eps))
    return torch.stack(columns, dim=-1)


def slopes_by_rows(function: Callable[[Tensor], Tensor], x: Tensor, eps: float = 1e-5) -> Tensor:
    """``slopes`` at one point, of a function of rows: all differences are rows of one call."""
    shifts = eps * torch.eye(len(x), dtype=x.dtype)
    with torch.no_grad():
        above, below = function(torch.cat((x + shifts, x - shifts))).chunk(2)
    return ((above - below) / (2 * eps)).movedim(0, -1)


def assert_gradients(
    value: Callable[[], Tensor], inputs: Sequence[Tensor], *, eps: float, atol: float, rtol: float
) -> None:
    """The gradients of ``value`` in each of its ``inputs`` are its slopes in a random direction."""
    gradients = torch.autograd.grad(value(), inputs, materialize_grads=True)
    for x, gradient in zip(inputs, gradients, strict=True):
        way, ends = torch.randn_like(x), []
        with torch.no_grad():
            for step in (eps, -2 * eps):
                x += step * way
                ends.append(value())
            x += eps * way
        slope = (ends[0] - ends[1]) / (2 * eps)
        torch.testing.assert_close((gradient * way).sum(), slope, atol=atol, rtol=rtol)
