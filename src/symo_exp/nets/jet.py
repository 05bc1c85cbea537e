"""A tanh layer on a jet, a value with its derivatives along some directions."""

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from symo_exp.nets.affine import bias_gradient, weight_gradient


def tanh_jet_layer(
    x: Float[Tensor, "jet batch into"],
    weight: Float[Tensor, "out into"],
    bias: Float[Tensor, " out"],
) -> Float[Tensor, "jet batch out"]:
    """Return ``h = tanh(W x + b)`` in row 0, ``h_i = (1 − h²) W x_i`` in row ``i`` of the jet."""
    if not torch.is_grad_enabled():
        return _value(x, weight, bias)[0]
    return _TanhJetLayer.apply(x, weight, bias)


def _value(x: Tensor, weight: Tensor, bias: Tensor) -> tuple[Tensor, Tensor, Tensor]:
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
        y, z, h = _value(x, weight, bias)
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
        dx = (flat @ weight).view_as(x)
        return (
            dx,
            weight_gradient(weight, (flat, x.flatten(0, 1))),
            bias_gradient(bias, back[0]),
        )
