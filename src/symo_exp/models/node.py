"""NODE: a neural ordinary differential equation of second order (thesis section 4.3.1)."""

from typing import Any

import torch
from torch import Tensor

from symo_exp.models.ode import OdeModel
from symo_exp.nets.embedding import Embedding
from symo_exp.nets.mlp import MLP


class NODE(OdeModel):
    """``v̇ = MLP(s(q), v, u)``: no mechanics but that velocity is the derivative of the pose."""

    def __init__(self, *, width: int, depth: int = 2, **base: Any) -> None:
        super().__init__(**base)
        n, m = self.input_matrix.shape
        self.embedding = Embedding(angular=self.coordinates.angular)
        self.net = MLP(inputs=self.embedding.size + n + m, outputs=n, width=width, depth=depth)

    def acceleration(self, q: Tensor, v: Tensor, u: Tensor) -> Tensor:
        return self.net(torch.cat((self.embedding(q).x, v, u), dim=1))
