"""The multilayer perceptron of all methods (thesis section 6.3)."""

from itertools import pairwise
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn
from typing_extensions import override

from symo_exp.checks import whole_number
from symo_exp.nets.affine import linear


class MLP(nn.Module):
    """``depth`` hidden tanh layers of ``width`` units and a linear output.

    Weights are Xavier-uniform with the gain of tanh, biases zero.

    Args:
        inputs: Number of inputs.
        outputs: Number of outputs.
        width: Units of a hidden layer.
        depth: Number of hidden layers.
        affine: Leave out the hidden layers.
    """

    def __init__(
        self, *, inputs: int, outputs: int, width: int, depth: int, affine: bool = False
    ) -> None:
        super().__init__()
        whole_number("width", width)
        whole_number("depth", depth)
        sizes = [inputs, *([] if affine else [width] * depth), outputs]
        pairs = list(pairwise(sizes))
        self.weights = nn.ParameterList([torch.empty(out, into) for into, out in pairs])
        self.biases = nn.ParameterList([torch.zeros(out) for _, out in pairs])
        for weight in self.weights:
            nn.init.xavier_uniform_(weight, gain=nn.init.calculate_gain("tanh"))

    def layers(self) -> tuple[tuple[Tensor, Tensor], ...]:
        """Return weight and bias of every layer, the linear output last."""
        # `_parameters`: iterating over the lists themselves takes five times as long
        weights: Any = self.weights._parameters.values()
        biases: Any = self.biases._parameters.values()
        return tuple(zip(weights, biases, strict=True))

    @override
    def forward(self, x: Float[Tensor, "batch inputs"]) -> Float[Tensor, "batch outputs"]:
        *hidden, (weight, bias) = self.layers()
        for w, b in hidden:
            x = torch.tanh(linear(x, w, b))
        return linear(x, weight, bias)
