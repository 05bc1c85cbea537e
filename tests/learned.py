"""A learned Lagrangian whose derivatives are well scaled enough for finite differences."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import torch
from torch import Tensor

from symo_exp.mechanics.lagrangian import Lagrangian
from symo_exp.nets.affine import parameter_jacobian
from symo_exp.nets.structured_lagrangian import StructuredLagrangian


@contextmanager
def double_precision() -> Iterator[None]:
    """Have new tensors and modules in float64."""
    before = torch.get_default_dtype()
    torch.set_default_dtype(torch.float64)
    try:
        yield
    finally:
        torch.set_default_dtype(before)


def learned_lagrangian(
    angular: tuple[bool, ...], *, width: int = 10, **kind: Any
) -> StructuredLagrangian:
    """Random weights, float64, and an inertia away from singular."""
    torch.manual_seed(len(angular))
    lagrangian = StructuredLagrangian(
        angular=angular, width=width, initial_inertia=None, **kind
    ).double()
    with torch.no_grad():
        if lagrangian.skip is not None:
            lagrangian.skip += 0.2 * torch.randn_like(lagrangian.skip)
        lagrangian.net.biases[-1][: lagrangian.head.n] += 1.5
    return lagrangian


def assert_same(
    closed: Sequence[Tensor], plain: Sequence[Tensor], inputs: Sequence[Tensor], tolerance: float
) -> None:
    """The same values, and derivatives in ``inputs`` to ten times that, of a random sum of them."""
    weights = [torch.randn_like(x) for x in closed]

    def pullback(outputs: Sequence[Tensor]) -> list[Tensor]:
        total = sum((w * x).sum() for w, x in zip(weights, outputs, strict=True))
        found = torch.autograd.grad(total, inputs, allow_unused=True)
        return [torch.zeros_like(x) if g is None else g for g, x in zip(found, inputs, strict=True)]

    for mine, oracle in zip(closed, plain, strict=True):
        torch.testing.assert_close(mine, oracle, atol=tolerance, rtol=tolerance)
    for mine, oracle in zip(pullback(closed), pullback(plain), strict=True):
        torch.testing.assert_close(mine, oracle, atol=10 * tolerance, rtol=10 * tolerance)


def assert_jacobian(function: Callable[[], Tensor], parameters: Sequence[Tensor]) -> None:
    """The Jacobian by samples has the rows of one backward pass for each number."""
    values, jacobian, _ = parameter_jacobian(function, parameters)
    expected = function()
    torch.testing.assert_close(values, expected)
    for sample in range(expected.shape[0]):
        for k in range(expected.shape[1]):
            row = torch.autograd.grad(
                expected[sample, k], parameters, retain_graph=True, materialize_grads=True
            )
            flat = torch.cat([x.flatten() for x in row])
            torch.testing.assert_close(jacobian[sample, k], flat, rtol=1e-9, atol=1e-12)


def assert_each_sample_alone(lagrangian: Lagrangian, q: Tensor, v: Tensor) -> None:
    """Derivatives sample by sample, in parameters and inputs, are those of each sample alone."""
    parameters = list(lagrangian.parameters())
    inputs = q.clone().requires_grad_(), v.clone().requires_grad_()

    def force(rows: slice = slice(None)) -> Tensor:
        return lagrangian.gradients(*(x[rows] for x in inputs)).q

    found = parameter_jacobian(force, parameters, inputs)
    for sample in range(len(q)):
        for i in range(v.shape[1]):
            alone = force(slice(sample, sample + 1))[0, i]
            (*by_input,) = torch.autograd.grad(
                alone, (*inputs, *parameters), materialize_grads=True
            )
            flat = torch.cat([g.flatten() for g in by_input[2:]])
            torch.testing.assert_close(found.parameters[sample, i], flat)
            for mine, oracle in zip(found.inputs, by_input[:2], strict=True):
                torch.testing.assert_close(mine[sample, i], oracle[sample])
