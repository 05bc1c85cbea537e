"""Affine maps, and tanh layers on jets, with parameter gradients for each sample.

The gradient of a weight is a sum of outer products over the rows of a batch, ``Σ_r ḡ_r x_rᵀ``.
Networks use their weights through this module: usually gradients are that sum; inside
``parameter_jacobian`` the factors ``ḡ_r``, ``x_r`` are kept and combined sample by sample.

Convention: the sample is the innermost part of a row index, so that of ``R N`` rows for ``N``
samples row ``r`` belongs to sample ``r mod N``.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

Pair = tuple[Tensor, Tensor]
"""Rows ``ḡ (rows, out)`` and ``x (rows, in)`` of a sum of outer products."""


def linear(x: Float[Tensor, "rows into"], weight: Tensor, bias: Tensor | None = None) -> Tensor:
    """Return ``W x + b`` in each row."""
    if _record is None:
        return nn.functional.linear(x, weight, bias)
    y = _Linear.apply(x, weight)
    return y if bias is None else _Shift.apply(y, bias)


def transposed(x: Float[Tensor, "rows out"], weight: Tensor) -> Tensor:
    """Return ``Wᵀ x`` in each row."""
    return x @ weight if _record is None else _Transposed.apply(x, weight)


def shift(x: Float[Tensor, "rows out"], bias: Tensor) -> Tensor:
    """Return ``x + b`` in each row."""
    return x + bias if _record is None else _Shift.apply(x, bias)


def tanh_jet_layer(
    x: Float[Tensor, "jet batch into"],
    weight: Float[Tensor, "out into"],
    bias: Float[Tensor, " out"],
) -> Float[Tensor, "jet batch out"]:
    """Return ``h = tanh(W x + b)`` in row 0, ``h_i = (1 − h²) W x_i`` in row ``i`` of the jet."""
    if not torch.is_grad_enabled():
        return _jet_value(x, weight, bias)[0]
    return _TanhJetLayer.apply(x, weight, bias)


def by_sample() -> bool:
    """Return whether derivatives are being kept sample by sample."""
    return _record is not None


def repeated(parameter: Tensor, batch: int) -> Float[Tensor, "batch k"]:
    """Return a vector of parameters, repeated in each row of a batch."""
    return shift(parameter.new_zeros(batch, len(parameter)), parameter)


def weight_gradient(weight: Tensor, *pairs: Pair) -> Tensor | None:
    """Return ``Σ ḡ xᵀ`` over all pairs and rows, for a backward pass in closed form."""
    if _record is not None:
        _record[weight.data_ptr()] += pairs
        return None
    (cotangent, x), *others = pairs
    gradient = cotangent.T @ x
    for cotangent, x in others:
        gradient = torch.addmm(gradient, cotangent.T, x)
    return gradient


def bias_gradient(bias: Tensor, cotangent: Float[Tensor, "rows out"]) -> Tensor | None:
    """Return ``Σ ḡ`` over all rows."""
    if _record is None:
        return cotangent.sum(0)
    _record[bias.data_ptr()].append((cotangent, cotangent))
    return None


_record: defaultdict[int, list[Pair]] | None = None
"""The factors of each parameter's gradient, by the address of its data."""


class Linearised(NamedTuple):
    """Residuals of independent samples, and their derivatives sample by sample."""

    residuals: Float[Tensor, "samples residuals"]
    parameters: Float[Tensor, "samples residuals parameters"]
    inputs: tuple[Float[Tensor, "samples residuals size"], ...]


@torch.enable_grad()
def parameter_jacobian(
    function: Callable[[], Float[Tensor, "samples residuals"]],
    parameters: Sequence[Tensor],
    inputs: Sequence[Float[Tensor, "samples size"]] = (),
) -> Linearised:
    """Return the residuals of independent samples and their derivatives.

    Takes one backward pass for each residual of a sample.

    Args:
        function: Computes the residuals. It must use the parameters through this module only.
        parameters: Parameters to differentiate in; derivatives are flattened.
        inputs: Tensors to differentiate in; ``function`` maps their rows independently.

    Raises:
        RuntimeError: If a parameter is used outside of this module, or in a nested call.
    """
    global _record
    if _record is not None:
        raise RuntimeError("parameter_jacobian cannot be nested")
    _record = defaultdict(list)
    try:
        residuals = function()
        samples, count = residuals.shape
        jacobian = residuals.new_zeros(samples, count, sum(p.numel() for p in parameters))
        by_input = tuple(residuals.new_zeros(samples, count, x.shape[1]) for x in inputs)
        for k in range(count):
            _record.clear()
            summed = torch.autograd.grad(
                residuals[:, k].sum(),
                (*inputs, *parameters),
                retain_graph=k + 1 < count,
                allow_unused=True,
            )
            for target, gradient in zip(by_input, summed, strict=False):
                if gradient is not None:
                    target[:, k] = gradient
            if any(gradient is not None for gradient in summed[len(inputs) :]):
                raise RuntimeError("a parameter is used outside nets.affine: no Jacobian by sample")
            _assemble(_record, parameters, jacobian[:, k])
    finally:
        _record = None
    return Linearised(residuals.detach(), jacobian, by_input)


@torch.no_grad()
def _assemble(
    pairs: Mapping[int, list[Pair]],
    parameters: Sequence[Tensor],
    rows: Float[Tensor, "samples parameters"],
) -> None:
    samples, start = len(rows), 0
    for p in parameters:
        target = rows[:, start : start + p.numel()]
        start += p.numel()
        factors = pairs.get(p.data_ptr(), [])
        if not factors:
            continue
        left = torch.cat([g.unflatten(0, (-1, samples)) for g, _ in factors])
        if p.ndim == 1:
            target.copy_(left.sum(0))
        else:
            right = torch.cat([x.unflatten(0, (-1, samples)) for _, x in factors])
            outer = torch.bmm(left.permute(1, 2, 0), right.transpose(0, 1))
            target.copy_(outer.flatten(1))


class _Linear(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor, weight: Tensor) -> Tensor:
        ctx.save_for_backward(x, weight)
        return x @ weight.T

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, cotangent: Tensor) -> tuple[Tensor, Tensor | None]:
        x, weight = ctx.saved_tensors
        return cotangent @ weight, weight_gradient(weight, (cotangent, x))


class _Transposed(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor, weight: Tensor) -> Tensor:
        ctx.save_for_backward(x, weight)
        return x @ weight

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, cotangent: Tensor) -> tuple[Tensor, Tensor | None]:
        x, weight = ctx.saved_tensors
        return cotangent @ weight.T, weight_gradient(weight, (x, cotangent))


class _Shift(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor, bias: Tensor) -> Tensor:
        ctx.save_for_backward(bias)
        return x + bias

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, cotangent: Tensor) -> tuple[Tensor, Tensor | None]:
        (bias,) = ctx.saved_tensors
        return cotangent, bias_gradient(bias, cotangent)


def _jet_value(x: Tensor, weight: Tensor, bias: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return the layer's jet, ``z`` without the bias, and ``h``, for the derivative."""
    z = (x.flatten(0, 1) @ weight.T).unflatten(0, x.shape[:2])
    h = torch.tanh(z[0] + bias)
    return torch.cat((h.unsqueeze(0), z[1:] * (1.0 - h * h))), z, h


class _TanhJetLayer(torch.autograd.Function):
    """The layer with its derivative.

    With cotangents ``G``: ``Z_i = (1 − h²) G_i``, ``Z₀ = (1 − h²) (G₀ − 2 h Σ_i G_i z_i)``.
    """

    @staticmethod
    def forward(ctx: Any, x: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
        y, z, h = _jet_value(x, weight, bias)
        ctx.save_for_backward(x, weight, bias, z, h)
        return y

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, cotangent: Tensor) -> tuple[Tensor, Tensor | None, Tensor | None]:
        x, weight, bias, z, h = ctx.saved_tensors
        slope = 1.0 - h * h
        bend = (cotangent[1:] * z[1:]).sum(0)
        back = torch.cat(
            (((cotangent[0] - 2.0 * h * bend) * slope).unsqueeze(0), cotangent[1:] * slope)
        )
        flat = back.flatten(0, 1)
        by_weight = weight_gradient(weight, (flat, x.flatten(0, 1)))
        return (flat @ weight).view_as(x), by_weight, bias_gradient(bias, back[0])
