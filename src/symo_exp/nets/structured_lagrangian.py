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

With ``harmonics`` the outputs are ``MLP(s(q)) + S φ(q)``, ``φ`` the first harmonics of the angles:
a linear layer beside the network, with the same derivatives by the same rules.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.autograd.function import once_differentiable
from typing_extensions import override

from symo_exp.checks import real, whole_number
from symo_exp.mechanics.lagrangian import (
    Curvature,
    Expansion,
    Gradients,
    Lagrangian,
    Rates,
    matvec,
    vecmat,
)
from symo_exp.mechanics.space import Space
from symo_exp.nets.affine import (
    bias_gradient,
    linear,
    shift,
    tanh_jet_layer,
    weight_gradient,
)  # fmt: skip
from symo_exp.nets.embedding import Embedding, Features
from symo_exp.nets.factor import FactorHead, HeadPoint
from symo_exp.nets.harmonics import Harmonics
from symo_exp.nets.mlp import MLP

QUIET = 0.1
"""Weights of the last layer at the start of training, relative to Xavier's."""


class StructuredLagrangian(nn.Module, Lagrangian):
    """``ℒ`` of ``n`` coordinates by one network; the inertia is positive definite by design.

    Args:
        angular: Which of the coordinates before the rotations are angles.
        width: Units of a hidden layer.
        depth: Number of hidden layers.
        initial_inertia: Training starts near ``H = initial_inertia · I`` [kg, kg m²] and a
            potential that is weak relative to it. With ``None`` the last layer starts uniform in
            ``±1/√inputs``, PyTorch's default, as in the published code of the thesis; Xavier
            weights, as in its text, often lead to a nearly singular ``H`` and diverging
            accelerations.
        harmonics: Largest number of angles that a harmonic couples; 0: no harmonics. Their weights
            ``S`` start at zero.
        squares: Whether the kinetic energy is a sum of squared speeds (``FactorHead``); speeds and
            potential are then affine in ``s(q)``, as those of rigid links in a plane.
        relative: Whether each angle is relative to the one before (``Embedding``).
        rotations: Number of rotations, with three coordinates each.
    """

    skip: Any
    """``S``, a parameter; ``None`` without harmonics."""

    def __init__(
        self,
        *,
        angular: tuple[bool, ...],
        width: int,
        depth: int = 2,
        initial_inertia: float | None = 1.0,
        harmonics: int = 0,
        squares: bool = False,
        relative: bool = False,
        rotations: int = 0,
    ) -> None:
        super().__init__()
        if initial_inertia is not None:
            real("lagrangian.initial_inertia", initial_inertia, above=0)
        whole_number("lagrangian.harmonics", harmonics, low=0)
        self.embedding = Embedding(angular=angular, relative=relative, rotations=rotations)
        self.head = FactorHead(
            len(angular) + 3 * rotations, squares=squares, inertia=initial_inertia or 1.0
        )
        self.net = MLP(
            inputs=self.embedding.size,
            outputs=self.head.outputs,
            width=width,
            depth=depth,
            affine=squares,
        )
        self.harmonics = Harmonics(angular=angular, order=harmonics)
        size = self.harmonics.size
        self.skip = nn.Parameter(torch.zeros(self.head.outputs, size)) if size else None
        last, bias = self.net.weights[-1], self.net.biases[-1]
        if initial_inertia is None:
            bound = 1.0 / math.sqrt(last.shape[1])
            nn.init.uniform_(last, -bound, bound)
            nn.init.uniform_(bias, -bound, bound)
        else:
            with torch.no_grad():
                diagonal = math.sqrt(initial_inertia)
                last.mul_(QUIET * self.head.scales_of(diagonal).unsqueeze(-1))
                bias.copy_(self.head.outputs_of(diagonal))

    @property
    @override
    def space(self) -> Space:
        return self.embedding.space

    @override
    def mass_matrix(self, q: Float[Tensor, "batch N"]) -> Float[Tensor, "batch n n"]:
        return self.head.mass(self.head.factor(self._outputs(q)))

    @override
    def potential(self, q: Float[Tensor, "batch N"]) -> Float[Tensor, " batch"]:
        return self._outputs(q)[:, -1]

    def _outputs(self, q: Tensor) -> Tensor:
        outputs: Tensor = self.net(self.embedding(q).x)
        if self.skip is None:
            return outputs
        return outputs + linear(self.harmonics(q).x, self.skip)

    @override
    def gradients(self, q: Float[Tensor, "batch N"], v: Float[Tensor, "batch n"]) -> Gradients:
        at = self.expand(q, v)
        return at.gradients(q, v) if torch.is_grad_enabled() else at.values

    @override
    @torch.no_grad()
    def expand(
        self, q: Float[Tensor, "batch N"], v: Float[Tensor, "batch n"]
    ) -> StructuredExpansion:
        features = self.embedding(q.detach())
        *layers, (last, last_bias) = self.net.layers()
        hidden, slopes, x = [], [], features.x
        for weight, bias in layers:
            x = torch.tanh(torch.addmm(bias, x, weight.T))
            hidden.append(x)
            slopes.append(1.0 - x * x)
        outputs = torch.addmm(last_bias, x, last.T)
        waves = () if self.skip is None else (self.harmonics(q.detach()),)
        for wave in waves:
            outputs = torch.addmm(outputs, wave.x, self.skip.T)
        head = self.head.point(outputs, v.detach())
        output_cotangent = self.head.cotangent(head)
        cotangents: list[Tensor] = []
        back, above = output_cotangent, last
        for (weight, _), slope in zip(reversed(layers), reversed(slopes), strict=True):
            back = (back @ above) * slope
            cotangents.insert(0, back)
            above = weight
        passes = _Passes(
            features,
            tuple(hidden),
            tuple(slopes),
            head,
            output_cotangent,
            tuple(cotangents),
            back @ above,
            waves,
        )
        return StructuredExpansion(self, passes)

    def rates(self, q: Float[Tensor, "batch N"], v: Float[Tensor, "batch n"]) -> Rates:
        """Return ``H``, ``Ḣ v``, ``ℒ_q`` from a jet, values with their ``n`` derivatives.

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
        if self.skip is not None:
            waves = self.harmonics(q)
            rates = self.harmonics.basis_tangents(waves).transpose(0, 1)
            beside = torch.cat((waves.x.unsqueeze(0), rates))
            jet = jet + linear(beside.flatten(0, 1), self.skip).unflatten(0, (n + 1, -1))
        outputs, partials = shift(jet[0], bias), jet[1:]
        factor = head.factor(outputs)
        partial_factors = head.factor_tangent(head.slope(outputs), partials)  # (n, B, n, n)
        y = vecmat(v, factor)
        partial_y = vecmat(v, partial_factors)  # L_iᵀ v, (n, B, n)
        dq = ((y * partial_y).sum(-1) - partials[..., -1]).T
        along = v.T.reshape(n, -1, 1)
        factor_rate = (along.unsqueeze(-1) * partial_factors).sum(0)
        y_rate = (along * partial_y).sum(0)
        mass_rate_v = matvec(factor_rate, y) + matvec(factor, y_rate)
        return Rates(head.mass(factor), mass_rate_v, dq)


class _Passes(NamedTuple):
    """Results of a forward and a transposed pass."""

    features: Features
    hidden: tuple[Tensor, ...]
    """``h_l``."""
    slopes: tuple[Tensor, ...]
    """``1 − h_l²``."""
    head: HeadPoint
    output_cotangent: Tensor
    """``∂ℒ/∂o``."""
    cotangents: tuple[Tensor, ...]
    """``d_l = ∂ℒ/∂z_l``."""
    feature_cotangent: Tensor
    """``x̄ = ∂ℒ/∂s``."""
    waves: tuple[Features, ...]
    """``φ``, empty without harmonics."""


class StructuredExpansion(Expansion):
    """``ℒ`` around ``(q, v)``; all derivatives share one forward and one transposed pass."""

    parts = ("_lagrangian", "_passes", "values")
    _lagrangian: StructuredLagrangian
    _rates: tuple[Tensor, ...] = ()
    """``∂z_l/∂q`` and ``∂o/∂q``, (B, n, ·) each, once ``curvature`` has computed them."""

    def __init__(self, lagrangian: StructuredLagrangian, passes: _Passes) -> None:
        self._lagrangian, self._passes = lagrangian, passes
        dq = lagrangian.embedding.to_coordinates(passes.features, passes.feature_cotangent)
        for waves in passes.waves:
            slopes = waves.dx * (passes.output_cotangent @ lagrangian.skip)
            dq = dq + lagrangian.harmonics.to_coordinates(slopes)
        self.values = Gradients(dq, lagrangian.head.momentum(passes.head))

    @override
    def mass(self) -> Tensor:
        return self._lagrangian.head.mass(self._passes.head.factor)

    @override
    @torch.no_grad()
    def curvature(self, before: Expansion | None = None) -> Curvature:
        embedding, head = self._lagrangian.embedding, self._lagrangian.head
        *layers, (last, _) = self._lagrangian.net.layers()
        at = self._passes
        tangents = embedding.basis_tangents(at.features)  # (B, n, ·) from here on
        qq = embedding.curvature(at.features, at.feature_cotangent)
        rates = []
        for (weight, _), h, slope, d in zip(
            layers, at.hidden, at.slopes, at.cotangents, strict=True
        ):
            z = tangents @ weight.T
            qq = torch.baddbmm(qq, z * (h * d).unsqueeze(1), z.mT, alpha=-2.0)
            tangents = z * slope.unsqueeze(1)
            rates.append(z)
        rates.append(tangents @ last.T)
        harmonics, skip = self._lagrangian.harmonics, self._lagrangian.skip
        for waves in at.waves:
            qq = qq + harmonics.curvature(waves, at.output_cotangent @ skip)
            rates[-1] = rates[-1] + harmonics.basis_tangents(waves) @ skip.T
        self._rates = tuple(rates)
        outputs_qq, vq = head.curvature(at.head, rates[-1])
        return Curvature(qq + outputs_qq, vq, vq.mT)

    @override
    def gradients(self, q: Tensor, v: Tensor) -> Gradients:
        weights, biases = zip(*self._lagrangian.net.layers(), strict=True)
        skip = self._lagrangian.skip
        return Gradients(*_DifferentiableGradients.apply(self, q, v, skip, *weights, *biases))

    def pullback(self, a: Tensor, b: Tensor, *, to_point: bool) -> tuple[Tensor | None, ...]:
        """Return the gradients of ``⟨a, ℒ_q⟩ + ⟨b, ℒ_v⟩`` in ``q``, ``v``, ``S``, weights, biases.

        Those in ``q`` and ``v`` are ``None`` without ``to_point``.
        """
        embedding, at = self._lagrangian.embedding, self._passes
        weights, biases = zip(*self._lagrangian.net.layers(), strict=True)
        tangents = [embedding.rate(at.features, a)]
        bends: list[Tensor] = []  # −2 h_l z_l' d_l
        along = [(a.unsqueeze(-1) * rates).sum(1) for rates in self._rates]  # Σ aᵢ ∂z_l/∂qᵢ
        for layer, (h, slope, d) in enumerate(
            zip(at.hidden, at.slopes, at.cotangents, strict=True)
        ):
            z = along[layer] if along else tangents[-1] @ weights[layer].T
            bends.append(-2.0 * z * h * d)
            tangents.append(z * slope)
        rates = along[-1] if along else tangents[-1] @ weights[-1].T
        harmonics, skip = self._lagrangian.harmonics, self._lagrangian.skip
        for waves in at.waves:
            wave_rates = waves.dx * harmonics.spread(a)
            if not along:
                rates = rates + wave_rates @ skip.T
        back, velocity = self._lagrangian.head.directional_cotangents(at.head, rates, b)
        inputs = (at.features.x, *at.hidden)
        own = (*at.cotangents, at.output_cotangent)
        output_back, skip_gradient = back, None
        for waves in at.waves:
            skip_gradient = weight_gradient(skip, (own[-1], wave_rates), (back, waves.x))
        weight_gradients: list[Tensor | None] = []
        bias_gradients: list[Tensor | None] = []
        for layer in range(len(weights) - 1, -1, -1):
            factors = (own[layer], tangents[layer]), (back, inputs[layer])
            weight_gradients.insert(0, weight_gradient(weights[layer], *factors))
            bias_gradients.insert(0, bias_gradient(biases[layer], back))
            if layer > 0:
                back = torch.addcmul(bends[layer - 1], back @ weights[layer], at.slopes[layer - 1])
        gradients = skip_gradient, *weight_gradients, *bias_gradients
        if not to_point:
            return None, None, *gradients
        configuration = embedding.to_stored(at.features, back @ weights[0], at.feature_cotangent, a)
        for waves in at.waves:
            slopes = (output_back @ skip) * waves.dx
            bent = (own[-1] @ skip) * waves.x * harmonics.spread(a)
            configuration = configuration + harmonics.to_coordinates(slopes - bent)
        return configuration, velocity, *gradients


class _DifferentiableGradients(torch.autograd.Function):
    """``(ℒ_q, ℒ_v)`` at an expanded point; the backward pass is its ``pullback``."""

    @staticmethod
    def forward(
        ctx: Any, at: StructuredExpansion, q: Tensor, v: Tensor, *parameters: Tensor | None
    ) -> tuple[Tensor, Tensor]:
        ctx.at = at
        return at.values.q.clone(), at.values.v.clone()

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, a: Tensor, b: Tensor) -> Any:
        to_point = ctx.needs_input_grad[1] or ctx.needs_input_grad[2]
        return None, *ctx.at.pullback(a, b, to_point=to_point)
