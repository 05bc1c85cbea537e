"""The learned Lagrangian: a network for the Cholesky factor of ``H`` and for ``V``.

``ℒ(q, v) = ½ vᵀ H(q) v − V(q)``, ``(L, V) = MLP(s(q))``, ``H = L Lᵀ + ε I`` (thesis section 4.1).

Derivatives are closed forms instead of repeated automatic differentiation. With ``z_l`` and
``h_l = tanh z_l`` the hidden layers and ``d_l = ∂ℒ/∂z_l`` from one transposed pass:

* ``ℒ_q = s_qᵀ W₁ᵀ d₁``;
* a tangent pass along ``q' = a``, ``v' = b``: ``z_l' = W_l h_{l−1}'``, ``h_l' = (1 − h_l²) z_l'``;
* ``φ = ⟨a, ℒ_q⟩ + ⟨b, ℒ_v⟩`` is the derivative of ``ℒ`` along ``(a, b)``. In its reverse pass the
  cotangents of the tangents ``z_l'`` are the ``d_l`` at hand, so only those of ``z_l`` are new:
  ``D_l = (1 − h_l²) C_l − 2 h_l z_l' d_l``, ``C_{l−1} = W_lᵀ D_l``, and
  ``∂φ/∂W_l = d_l h_{l−1}'ᵀ + D_l h_{l−1}ᵀ``, ``∂φ/∂b_l = D_l``;
* ``ℒ_{q_i q_j} = o_iᵀ F_oo o_j + Σ_l Σ (−2 h_l d_l) z_{l,i} z_{l,j} + x̄ · s_ij``, with ``n``
  tangent passes along the coordinates and ``F_oo`` the second derivative of ``ℒ`` in the outputs.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from symo_exp.mechanics.lagrangian import Curvature, Expansion, Gradients, Lagrangian, Rates
from symo_exp.nets.affine import bias_gradient, linear, shift, weight_gradient
from symo_exp.nets.cholesky import CholeskyHead, HeadPoint
from symo_exp.nets.embedding import Embedding, Features
from symo_exp.nets.jet import tanh_jet_layer
from symo_exp.nets.mlp import MLP


class StructuredLagrangian(nn.Module, Lagrangian):
    """``ℒ`` of ``n`` coordinates by one network; the inertia is positive definite by design."""

    def __init__(self, *, angular: tuple[bool, ...], width: int, depth: int = 2) -> None:
        super().__init__()
        self.embedding = Embedding(angular=angular)
        self.head = CholeskyHead(len(angular))
        self.net = MLP(
            inputs=self.embedding.size, outputs=self.head.outputs, width=width, depth=depth
        )

    def mass_matrix(self, q: Float[Tensor, "batch n"]) -> Float[Tensor, "batch n n"]:
        return self.head.mass(self.head.factor(self.net(self.embedding(q).x)))

    def potential(self, q: Float[Tensor, "batch n"]) -> Float[Tensor, " batch"]:
        return self.net(self.embedding(q).x)[:, -1]

    def gradients(self, q: Float[Tensor, "batch n"], v: Float[Tensor, "batch n"]) -> Gradients:
        at = self.expand(q, v)
        return at.gradients(q, v) if torch.is_grad_enabled() else at.values

    @torch.no_grad()
    def expand(
        self, q: Float[Tensor, "batch n"], v: Float[Tensor, "batch n"]
    ) -> StructuredExpansion:
        features = self.embedding(q.detach())
        layers = self.net.layers()
        hidden, x = [], features.x
        for weight, bias in layers[:-1]:
            x = torch.tanh(torch.addmm(bias, x, weight.T))
            hidden.append(x)
        weight, bias = layers[-1]
        head = self.head.point(torch.addmm(bias, x, weight.T), v.detach())
        output_cotangent = self.head.cotangent(head)
        cotangents: list[Tensor] = []
        back = output_cotangent
        for (weight, _), h in zip(reversed(layers[1:]), reversed(hidden), strict=True):
            back = (back @ weight) * (1.0 - h * h)
            cotangents.insert(0, back)
        return StructuredExpansion(
            self,
            _Passes(
                features,
                tuple(hidden),
                head,
                output_cotangent,
                tuple(cotangents),
                cotangents[0] @ layers[0][0],
            ),
        )

    def rates(self, q: Float[Tensor, "batch n"], v: Float[Tensor, "batch n"]) -> Rates:
        """``H``, ``Ḣ v``, ``ℒ_q`` from a jet: the value and its ``n`` coordinate derivatives.

        ``o_i = ∂o/∂q_i`` give ``L_i``; then ``ℒ_{q_i} = y · L_iᵀ v − V_i`` and
        ``Ḣ v = L̇ y + L L̇ᵀ v`` with ``L̇ = Σ v_i L_i``.
        """
        n, head = self.head.n, self.head
        features = self.embedding(q)
        tangents = self.embedding.basis_tangents(features).transpose(0, 1)
        jet = torch.cat((features.x.unsqueeze(0), tangents))
        *hidden, (weight, bias) = self.net.layers()
        for w, b in hidden:
            jet = tanh_jet_layer(jet, w, b)
        jet = linear(jet.flatten(0, 1), weight).unflatten(0, (n + 1, -1))
        outputs, partials = shift(jet[0], bias), jet[1:]
        factor = head.factor(outputs)
        partial_factors = head.factor_tangent(head.slope(outputs), partials)  # (n, B, n, n)
        y = (v.unsqueeze(-2) @ factor).squeeze(-2)
        partial_y = (v.unsqueeze(-2) @ partial_factors).squeeze(-2)  # L_iᵀ v, (n, B, n)
        dq = ((y * partial_y).sum(-1) - partials[..., -1]).T
        along = v.T.reshape(n, -1, 1)
        factor_rate = (along.unsqueeze(-1) * partial_factors).sum(0)
        y_rate = (along * partial_y).sum(0)
        mass_rate_v = (factor_rate @ y.unsqueeze(-1) + factor @ y_rate.unsqueeze(-1)).squeeze(-1)
        return Rates(head.mass(factor), mass_rate_v, dq)


class _Passes(NamedTuple):
    """What a forward and a transposed pass compute."""

    features: Features
    hidden: tuple[Tensor, ...]
    """``h_l``."""
    head: HeadPoint
    output_cotangent: Tensor
    """``∂ℒ/∂o``."""
    cotangents: tuple[Tensor, ...]
    """``d_l = ∂ℒ/∂z_l``."""
    feature_cotangent: Tensor
    """``x̄ = ∂ℒ/∂s``."""


class StructuredExpansion(Expansion):
    """``ℒ`` around ``(q, v)``: the passes are kept and serve every further derivative."""

    def __init__(self, lagrangian: StructuredLagrangian, passes: _Passes) -> None:
        self._lagrangian, self._passes = lagrangian, passes
        head, embedding = lagrangian.head, lagrangian.embedding
        self.values = Gradients(
            embedding.to_coordinates(passes.features.dx * passes.feature_cotangent),
            head.momentum(passes.head),
            head.mass(passes.head.factor),
        )

    @torch.no_grad()
    def curvature(self) -> Curvature:
        embedding, head = self._lagrangian.embedding, self._lagrangian.head
        weights, at = tuple(self._lagrangian.net.weights), self._passes
        tangents = embedding.basis_tangents(at.features)  # (B, n, ·) from here on
        own = embedding.second(at.features) * at.feature_cotangent
        qq = torch.diag_embed(embedding.to_coordinates(own))
        for weight, h, d in zip(weights[:-1], at.hidden, at.cotangents, strict=True):
            z = tangents @ weight.T
            qq = qq + (z * (-2.0 * h * d).unsqueeze(1)) @ z.mT
            tangents = z * (1.0 - h * h).unsqueeze(1)
        rates = tangents @ weights[-1].T
        point = at.head
        n = head.n
        factors = head.factor_tangent(point.slope.unsqueeze(1), rates)  # L_i: (B, n, n, n)
        ys = (point.v[:, None, None, :] @ factors).squeeze(-2)  # y_i = L_iᵀ v: (B, n, n)
        bend = point.v * point.y * point.slope * (1.0 - point.slope)
        diagonal_rates = rates[..., :n]
        qq = qq + ys @ ys.mT + (diagonal_rates * bend.unsqueeze(1)) @ diagonal_rates.mT
        # p_i = L_i y + L y_i, stored with the derivative last.
        moved = (factors @ point.y[:, None, :, None]).squeeze(-1) + ys @ point.factor.mT
        return Curvature(qq, moved.mT)

    def gradients(self, q: Tensor, v: Tensor) -> Gradients:
        net = self._lagrangian.net
        return Gradients(*_DifferentiableGradients.apply(self, q, v, *net.weights, *net.biases))

    def rows(self, index: Tensor) -> StructuredExpansion:
        return StructuredExpansion(self._lagrangian, _map(lambda x: x[index], self._passes))

    def replace(self, index: Tensor, other: Expansion) -> StructuredExpansion:
        assert isinstance(other, StructuredExpansion)
        passes = _map(lambda x, y: x.index_copy(0, index, y), self._passes, other._passes)
        return StructuredExpansion(self._lagrangian, passes)

    def pullback(
        self, a: Tensor, b: Tensor, mass_cotangent: Tensor | None
    ) -> tuple[Tensor, Tensor, list[Tensor | None], list[Tensor | None]]:
        """Gradients of ``⟨a, ℒ_q⟩ + ⟨b, ℒ_v⟩ + ⟨M, H⟩`` in ``q``, ``v``, weights and biases."""
        embedding, head = self._lagrangian.embedding, self._lagrangian.head
        weights, at = tuple(self._lagrangian.net.weights), self._passes
        inputs = (at.features.x, *at.hidden)
        tangents = [embedding.tangent(at.features, a)]
        bends: list[Tensor] = []
        for weight, h, d in zip(weights[:-1], at.hidden, at.cotangents, strict=True):
            z = tangents[-1] @ weight.T
            bends.append(z * h * d)
            tangents.append(z * (1.0 - h * h))
        rates = tangents[-1] @ weights[-1].T
        back, velocity = head.directional_cotangents(at.head, rates, b, mass_cotangent)
        own = (at.output_cotangent, *reversed(at.cotangents))
        biases = tuple(self._lagrangian.net.biases)
        weight_gradients: list[Tensor | None] = []
        bias_gradients: list[Tensor | None] = []
        for layer in range(len(weights) - 1, -1, -1):
            d = own[len(weights) - 1 - layer]
            factors = (d, tangents[layer]), (back, inputs[layer])
            weight_gradients.insert(0, weight_gradient(weights[layer], *factors))
            bias_gradients.insert(0, bias_gradient(biases[layer], back))
            back = back @ weights[layer]
            if layer > 0:
                h = at.hidden[layer - 1]
                back = back * (1.0 - h * h) - 2.0 * bends[layer - 1]
        second = embedding.second(at.features) * at.feature_cotangent
        pose = embedding.to_coordinates(back * at.features.dx)
        pose = pose + embedding.to_coordinates(second) * a
        return pose, velocity, weight_gradients, bias_gradients


class _DifferentiableGradients(torch.autograd.Function):
    """``(ℒ_q, ℒ_v, H)`` at an expanded point; the backward pass is its ``pullback``."""

    @staticmethod
    def forward(
        ctx: Any, at: StructuredExpansion, q: Tensor, v: Tensor, *parameters: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        ctx.at = at
        ctx.set_materialize_grads(False)
        return tuple(x.clone() for x in at.values)  # type: ignore[return-value]

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, a: Tensor | None, b: Tensor | None, mass: Tensor | None) -> Any:
        at: StructuredExpansion = ctx.at
        zero = torch.zeros_like(at.values.q)
        pose, velocity, weights, biases = at.pullback(
            zero if a is None else a, zero if b is None else b, mass
        )
        return None, pose, velocity, *weights, *biases


def _map(function: Any, *trees: Any) -> Any:
    """Apply a function to the tensors of equal nested tuples."""
    first = trees[0]
    if isinstance(first, Tensor):
        return function(*trees)
    mapped = (_map(function, *branches) for branches in zip(*trees, strict=True))
    return type(first)(*mapped) if hasattr(first, "_fields") else tuple(mapped)
