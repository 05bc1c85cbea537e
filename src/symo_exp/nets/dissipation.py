"""Learned dissipation: coefficients of friction, and a network for the rest."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor, nn
from typing_extensions import override

from symo_exp.checks import one_of, real, whole_number
from symo_exp.errors import ConfigError
from symo_exp.mechanics.dissipation import Dissipation, chord_excess
from symo_exp.mechanics.lagrangian import matvec, vecmat
from symo_exp.mechanics.types import Coordinates
from symo_exp.nets.affine import repeated
from symo_exp.nets.embedding import directions, features_of
from symo_exp.nets.mlp import MLP
from symo_exp.nets.roles import mark, mark_squares
from symo_exp.nets.triangle import Triangle

VELOCITY = 5.0
"""Velocity [rad/s, m/s] that a network sees as 1."""


class LearnedDissipation(nn.Module, Dissipation):
    """``F_d = −Aᵀ (D A v + c ∘ tanh(A v / ε_v)) − L_D(q, v) L_D(q, v)ᵀ v``, dissipative by design.

    ``D = U diag(d) Uᵀ`` is positive semidefinite, ``U`` unit lower triangular, and ``c, d ≥ 0`` are
    squares of parameters. Their slope decreases only with the square root of the friction, so that
    least squares find it from a start that is too small by orders of magnitude. ``L_D`` is lower
    triangular, a network with one hidden tanh layer that reads ``s(q)`` and ``v/5``. ``A`` maps
    coordinates to joints.

    Args:
        coordinates: The coordinates.
        viscous: Whether there is a ``D``.
        coulomb: Whether there is a ``c``.
        width: Hidden units of the network; 0: no network.
        joints: "own": each coordinate is a joint; "neighbours": angles are absolute, and each
            hinge turns with the difference of its angle to the one before.
        rest_velocity: Initial ``ε_v`` [rad/s, m/s]. It is learned, but never below a fifth of this:
            root finders do not converge at jumps.
        start: Initial coefficients [N m s, N m; N s/m, N].
    """

    def __init__(
        self,
        *,
        coordinates: Coordinates,
        viscous: bool = True,
        coulomb: bool = False,
        width: int = 0,
        joints: str = "own",
        rest_velocity: float = 0.1,
        start: float = 0.01,
    ) -> None:
        super().__init__()
        one_of("dissipation.joints", joints, ("own", "neighbours"))
        real("dissipation.rest_velocity", rest_velocity, above=0)
        real("dissipation.start", start, above=0)
        whole_number("dissipation.width", width, low=0)
        n = coordinates.n
        found = torch.eye(n)
        if joints == "neighbours":
            found = torch.linalg.solve_triangular(
                directions(coordinates.angular), found, upper=False, unitriangular=True
            )
        self.joints: Tensor
        self.register_buffer("joints", found, False)
        self._triangle = Triangle(n)
        entries = self._triangle.entries
        self.viscous_root = self.coulomb_root = self.rest = self.net = None
        root = math.sqrt(start)
        if viscous:
            self.viscous_root = nn.Parameter(self._triangle.flat(root * torch.eye(n)))
            mark_squares(self.viscous_root, self._triangle.flat(torch.eye(n)).bool())
        if coulomb:
            self.coulomb_root = nn.Parameter(torch.full((n,), root))
            mark_squares(self.coulomb_root)
            self.rest = nn.Parameter(torch.zeros(n))
            self._rest_velocity, self._least_rest = rest_velocity, 0.2
        if width > 0:
            self.embedding = features_of(coordinates)
            inputs = self.embedding.size + n
            self.net = MLP(inputs=inputs, outputs=entries, width=width, depth=1)
            with torch.no_grad():  # a product: at zero it would have no slope
                self.net.weights[-1].mul_(0.1)

        mark([p for p in (self.viscous_root, self.coulomb_root) if p is not None], "coefficient")
        mark(self.net.parameters() if self.net is not None else (), "late")

    @torch.no_grad()
    def damping(
        self, q: Float[Tensor, "batch N"], v: Float[Tensor, "batch n"]
    ) -> Float[Tensor, "batch n n"]:
        """Return ``∂F_d/∂v`` of the coefficients: the network is not stiff."""
        return self.joints.T @ self._joint_slope(v @ self.joints.T) @ self.joints

    @torch.no_grad()
    def derivatives(
        self, q: Float[Tensor, "batch N"], v: Float[Tensor, "batch n"]
    ) -> tuple[Float[Tensor, "batch n n"], Float[Tensor, "batch n n"]]:
        """Return ``∂F_d/∂q`` and ``∂F_d/∂v`` in closed form."""
        by_v = self.damping(q, v)
        if self.net is None:
            return torch.zeros_like(by_v), by_v
        (weight, bias), (last, last_bias) = self.net.layers()
        features, n = self.embedding(q), v.shape[1]
        hidden = torch.tanh(torch.cat((features.x, v / VELOCITY), dim=1) @ weight.T + bias)
        factor = self._triangle.square(hidden @ last.T + last_bias)
        by_s, by_rate = weight.T.split((self.embedding.size, n))
        by_q = self.embedding.basis_tangents(features) @ by_s
        tangents = torch.cat((by_q, (by_rate / VELOCITY).expand(v.shape[0], -1, -1)), dim=1)
        rates = (tangents * (1.0 - hidden * hidden).unsqueeze(1)) @ last.T
        turned = self._triangle.square(rates.flatten(0, 1)).unflatten(0, rates.shape[:2])
        x, y = v[:, None], vecmat(v, factor)[:, None]
        found = -(matvec(turned, y) + matvec(factor[:, None], vecmat(x, turned))).mT
        return found[..., :n], by_v + found[..., n:] - factor @ factor.mT

    @override
    @torch.no_grad()
    def chord(
        self, v: Float[Tensor, "batch n"], before: Float[Tensor, "batch n"]
    ) -> Float[Tensor, "batch n n"] | None:
        """Return what chords of dry friction add where a joint's velocity changes by ``ε_v``."""
        if (dry := self.dry()) is None:
            return None
        c, rest = dry
        excess = chord_excess(v @ self.joints.T, before @ self.joints.T, rest)
        return -self.joints.T @ torch.diag_embed(c / rest * excess) @ self.joints

    def coefficients(self) -> tuple[Tensor | None, tuple[Tensor, Tensor] | None]:
        """Return ``D`` (n, n), and ``c`` with ``ε_v`` (n), of joint velocities, where they are."""
        root = self.viscous_root
        return None if root is None else self._triangle.semidefinite(root), self.dry()

    def dry(self, batch: int | None = None) -> tuple[Tensor, Tensor] | None:
        """Return ``c`` and ``ε_v``, (n,) or (batch, n), if there is dry friction."""
        if self.coulomb_root is None or self.rest is None:
            return None
        root, rest = _rows(self.coulomb_root, batch), _rows(self.rest, batch)
        share = self._least_rest + (1.0 - self._least_rest) * rest.exp()
        return root.square(), self._rest_velocity * share

    def _joint_force(self, rate: Float[Tensor, "batch n"]) -> Float[Tensor, "batch n"]:
        """Return the friction of joint velocities, by the coefficients."""
        found = torch.zeros_like(rate)
        if self.viscous_root is not None:
            unit, d = self._triangle.factors(repeated(self.viscous_root, rate.shape[0]))
            found = found - matvec(unit, d * vecmat(rate, unit))
        if (dry := self.dry(rate.shape[0])) is not None:
            c, rest = dry
            found = found - c * torch.tanh(rate / rest)
        return found

    def _joint_slope(self, rate: Float[Tensor, "batch n"]) -> Float[Tensor, "batch n n"]:
        """Return the derivative of ``_joint_force``."""
        found = torch.zeros(rate.shape[0], *self.joints.shape).to(rate)
        if self.viscous_root is not None:
            found = found - self._triangle.semidefinite(self.viscous_root.unsqueeze(0))
        if (dry := self.dry()) is not None:
            c, rest = dry
            slope = 1.0 - torch.tanh(rate / rest).square()
            found = found - torch.diag_embed(c / rest * slope)
        return found

    @override
    def force(
        self, q: Float[Tensor, "batch N"], v: Float[Tensor, "batch n"]
    ) -> Float[Tensor, "batch n"]:
        found = vecmat(self._joint_force(matvec(self.joints, v)), self.joints)
        if self.net is not None:
            entries = self.net(torch.cat((self.embedding(q).x, v / VELOCITY), dim=1))
            factor = self._triangle.square(entries)
            found = found - matvec(factor, vecmat(v, factor))
        return found


class MachineFriction(LearnedDissipation):
    """Friction of machines: viscous and dry, asymmetric, with the Stribeck effect.

    With joint velocities ``w = A v``, ``t = tanh(w / ε_v)``, ``S = diag(1 + a ∘ t)``

        F_d = −Aᵀ (S D S w + (c + b ∘ exp(−(w / v_s)²)) ∘ (1 + e ∘ t) ∘ t) + k − L_D L_Dᵀ v

    ``|a|, |e| < 1`` make viscous friction ``(1 ± a)² D`` and dry friction ``(1 ± e) c`` in the two
    directions. ``b ≥ 0`` is the excess of breakaway over sliding friction (Stribeck), which fades
    at ``v_s > 0``. The force is dissipative by design except for the constant force ``k``.

    Args:
        coordinates: The coordinates.
        asymmetric: Whether there are ``a`` and ``e``.
        stribeck: Whether there are ``b`` and ``v_s``.
        constant: Whether there is a ``k`` [N m, N], on the coordinates.
        width: See ``LearnedDissipation``.
        joints: See ``LearnedDissipation``.
        rest_velocity: Initial ``ε_v`` [rad/s, m/s].
        least_rest_velocity: Smallest ``ε_v`` [rad/s, m/s], about the velocity that an encoder
            resolves.
        stribeck_velocity: Initial ``v_s`` [rad/s, m/s].
        start: Initial coefficients [N m s, N m; N s/m, N].
    """

    def __init__(
        self,
        *,
        coordinates: Coordinates,
        asymmetric: bool = True,
        stribeck: bool = False,
        constant: bool = False,
        width: int = 0,
        joints: str = "own",
        rest_velocity: float = 0.1,
        least_rest_velocity: float = 1e-3,
        stribeck_velocity: float = 0.5,
        start: float = 0.01,
    ) -> None:
        super().__init__(
            coordinates=coordinates,
            coulomb=True,
            width=width,
            joints=joints,
            rest_velocity=rest_velocity,
            start=start,
        )
        if not 0.0 < least_rest_velocity <= rest_velocity:
            raise ConfigError(
                f"dissipation.least_rest_velocity={least_rest_velocity}: "
                f"expected a number above 0, at most rest_velocity={rest_velocity}"
            )
        real("dissipation.stribeck_velocity", stribeck_velocity, above=0)
        self._least_rest = least_rest_velocity / rest_velocity
        self._stribeck_velocity = stribeck_velocity
        n = coordinates.n
        self.tilts = self.breakaway_root = self.fading = self.constant = None
        if asymmetric:
            self.tilts = nn.Parameter(torch.zeros(2 * n))
        if stribeck:
            self.breakaway_root = nn.Parameter(torch.full((n,), math.sqrt(start)))
            mark_squares(self.breakaway_root)
            self.fading = nn.Parameter(torch.zeros(n))
        if constant:
            self.constant = nn.Parameter(torch.zeros(n))
        own = (self.tilts, self.breakaway_root, self.constant)
        mark([p for p in own if p is not None], "coefficient")

    @override
    def force(
        self, q: Float[Tensor, "batch N"], v: Float[Tensor, "batch n"]
    ) -> Float[Tensor, "batch n"]:
        found = super().force(q, v)
        return found if self.constant is None else found + repeated(self.constant, v.shape[0])

    def asymmetry(self, batch: int | None = None) -> tuple[Tensor, Tensor] | None:
        """Return ``a`` and ``e``, (n,) or (batch, n) each, if friction is asymmetric."""
        if self.tilts is None:
            return None
        a, e = torch.tanh(_rows(self.tilts, batch)).chunk(2, dim=-1)
        return a, e

    def stribeck(self, batch: int | None = None) -> tuple[Tensor, Tensor] | None:
        """Return ``b`` and ``v_s``, (n,) or (batch, n) each, if there is a Stribeck effect."""
        if self.breakaway_root is None or self.fading is None:
            return None
        root, fading = _rows(self.breakaway_root, batch), _rows(self.fading, batch)
        return root.square(), self._stribeck_velocity * fading.exp()

    @override
    def _joint_force(self, rate: Float[Tensor, "batch n"]) -> Float[Tensor, "batch n"]:
        batch, both = rate.shape[0], self.dry(rate.shape[0])
        assert self.viscous_root is not None
        assert both is not None
        unit, d = self._triangle.factors(repeated(self.viscous_root, batch))
        dry, rest = both
        t = torch.tanh(rate / rest)
        a, e = self.asymmetry(batch) or (torch.zeros_like(t),) * 2
        if (stribeck := self.stribeck(batch)) is not None:
            excess, fading = stribeck
            dry = dry + excess * (-(rate / fading).square()).exp()
        s = 1.0 + a * t
        return -s * matvec(unit, d * vecmat(s * rate, unit)) - dry * (1.0 + e * t) * t

    @override
    def _joint_slope(self, rate: Float[Tensor, "batch n"]) -> Float[Tensor, "batch n n"]:
        both = self.dry()
        assert self.viscous_root is not None
        assert both is not None
        matrix = self._triangle.semidefinite(self.viscous_root.unsqueeze(0))
        dry, rest = both
        t = torch.tanh(rate / rest)
        by_rate = (1.0 - t.square()) / rest
        a, e = self.asymmetry() or (torch.zeros_like(rest),) * 2
        along, fall = dry.expand_as(t), torch.zeros_like(t)
        if (stribeck := self.stribeck()) is not None:
            excess, fading = stribeck
            bell = excess * (-(rate / fading).square()).exp()
            along, fall = along + bell, -2.0 * rate / fading.square() * bell
        s, bent = 1.0 + a * t, a * by_rate
        own = bent * matvec(matrix, s * rate)
        own = own + along * (1.0 + 2.0 * e * t) * by_rate + fall * (1.0 + e * t) * t
        mixed = s.unsqueeze(-1) * matrix * (s + bent * rate).unsqueeze(-2)
        return -(mixed + torch.diag_embed(own))


def _rows(parameter: Tensor, batch: int | None) -> Tensor:
    """Return a vector of parameters, repeated in each row of a batch if there is one."""
    return parameter if batch is None else repeated(parameter, batch)
