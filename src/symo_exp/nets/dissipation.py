"""Learned dissipation: friction by its coefficients, and what they cannot say by a network."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor, nn
from typing_extensions import override

from symo_exp.errors import ConfigError
from symo_exp.mechanics.dissipation import Dissipation
from symo_exp.mechanics.lagrangian import matvec, vecmat
from symo_exp.mechanics.types import Coordinates
from symo_exp.nets.affine import repeated
from symo_exp.nets.embedding import Embedding
from symo_exp.nets.mlp import MLP
from symo_exp.nets.roles import mark

VELOCITY = 5.0
"""Velocity [rad/s] that a network sees as 1."""


class LearnedDissipation(nn.Module, Dissipation):
    """``F_d = −Aᵀ (D A v + c ∘ tanh(A v / ε_v)) − L_D(q, v) L_D(q, v)ᵀ v``, dissipative by design.

    ``D = U diag(d) Uᵀ`` is positive semidefinite, ``U`` unit lower triangular, and ``c, d ≥ 0``, by
    softplus: unlike a Cholesky factor's, the slope of ``d`` is of its own size where there is
    hardly any friction. ``L_D`` is a network with one
    hidden tanh layer of ``width`` units that reads ``s(q)`` and ``v/5``, lower triangular. ``A``
    takes coordinates to joints: themselves, or with ``joints="neighbours"`` the differences
    ``v₁, v₂ − v₁, …`` of a chain whose angles are absolute. ``ε_v`` is learned too, beginning at
    ``rest_velocity`` and never below a fifth of it [rad/s]: a jump no root finder would like.
    Coefficients begin at ``start`` [N m s, N m]; far larger ones take long to reach.
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
        if joints not in ("own", "neighbours"):
            raise ConfigError(f"dissipation.joints={joints}: expected own or neighbours")
        for name, value in (("rest_velocity", rest_velocity), ("start", start)):
            if not value > 0.0:
                raise ConfigError(f"dissipation.{name}={value}: expected above 0")
        n = coordinates.n
        chain = torch.eye(n) - torch.diag(torch.ones(n - 1), -1)
        self.joints: Tensor
        self.register_buffer("joints", chain if joints == "neighbours" else torch.eye(n), False)
        self._triangle = _Triangle(n)
        entries = self._triangle.entries
        self.viscous = self.coulomb = self.rest = self.net = None
        begin = math.log(math.expm1(start))
        if viscous:
            self.viscous = nn.Parameter(self._triangle.flat(begin * torch.eye(n)))
        if coulomb:
            self.coulomb = nn.Parameter(torch.full((n,), begin))
            self.rest = nn.Parameter(torch.zeros(n))
            self._rest_velocity = rest_velocity
        if width > 0:
            self.embedding = Embedding(angular=coordinates.angular)
            inputs = self.embedding.size + n
            self.net = MLP(inputs=inputs, outputs=entries, width=width, depth=1)
            with torch.no_grad():  # a product: at zero it would have no slope
                self.net.weights[-1].mul_(0.1)

        mark([p for p in (self.viscous, self.coulomb) if p is not None], "coefficient")
        mark(self.net.parameters() if self.net is not None else (), "late")

    @torch.no_grad()
    def damping(
        self, q: Float[Tensor, "batch n"], v: Float[Tensor, "batch n"]
    ) -> Float[Tensor, "batch n n"]:
        """Return ``∂F_d/∂v`` of the coefficients: the network is not stiff."""
        found = torch.zeros(v.shape[0], *self.joints.shape).to(v)
        if self.viscous is not None:
            unit, d = self._factors(self.viscous.unsqueeze(0))
            found = found - unit * d.unsqueeze(-2) @ unit.mT
        if self.coulomb is not None and self.rest is not None:
            c, rest = self._dry(self.coulomb, self.rest)
            slope = 1.0 - torch.tanh(v @ self.joints.T / rest).square()
            found = found - torch.diag_embed(c / rest * slope)
        return self.joints.T @ found @ self.joints

    @torch.no_grad()
    def derivatives(
        self, q: Float[Tensor, "batch n"], v: Float[Tensor, "batch n"]
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

    def coefficients(self) -> tuple[Tensor | None, tuple[Tensor, Tensor] | None]:
        """Return ``D`` (n, n), and ``c`` with ``ε_v`` (n), of joint velocities, where they are."""
        matrix = dry = None
        if self.viscous is not None:
            unit, d = (x[0] for x in self._factors(self.viscous.unsqueeze(0)))
            matrix = unit * d @ unit.mT
        if self.coulomb is not None and self.rest is not None:
            dry = self._dry(self.coulomb, self.rest)
        return matrix, dry

    def _factors(self, viscous: Tensor) -> tuple[Tensor, Tensor]:
        """Return ``U`` and ``d``."""
        square = self._triangle.square(viscous)
        d = nn.functional.softplus(square.diagonal(dim1=-2, dim2=-1))
        return torch.tril(square, -1) + torch.eye(d.shape[-1]).to(d), d

    def _dry(self, coulomb: Tensor, rest: Tensor) -> tuple[Tensor, Tensor]:
        """Return ``c`` and ``ε_v``."""
        return nn.functional.softplus(coulomb), self._rest_velocity * (0.2 + 0.8 * rest.exp())

    @override
    def force(
        self, q: Float[Tensor, "batch n"], v: Float[Tensor, "batch n"]
    ) -> Float[Tensor, "batch n"]:
        rate, found = matvec(self.joints, v), torch.zeros_like(v)
        if self.viscous is not None:
            unit, d = self._factors(repeated(self.viscous, v.shape[0]))
            found = found - matvec(unit, d * vecmat(rate, unit))
        if self.coulomb is not None and self.rest is not None:
            c, rest = self._dry(*(repeated(x, v.shape[0]) for x in (self.coulomb, self.rest)))
            found = found - c * torch.tanh(rate / rest)
        found = vecmat(found, self.joints)
        if self.net is not None:
            entries = self.net(torch.cat((self.embedding(q).x, v / VELOCITY), dim=1))
            factor = self._triangle.square(entries)
            found = found - matvec(factor, vecmat(v, factor))
        return found


class _Triangle(nn.Module):
    """Lower triangular matrices of ``n`` rows as vectors of their entries."""

    place: Tensor

    def __init__(self, n: int) -> None:
        super().__init__()
        self.entries = n * (n + 1) // 2
        row, column = torch.tril_indices(n, n)
        place = torch.full((n, n), self.entries)  # above the diagonal: the zero at the end
        place[row, column] = torch.arange(self.entries)
        self.register_buffer("place", place, persistent=False)

    def square(self, flat: Float[Tensor, "batch entries"]) -> Float[Tensor, "batch n n"]:
        """Return the matrices of such vectors."""
        padded = torch.cat((flat, torch.zeros_like(flat[:, :1])), dim=1)
        return padded[:, self.place]

    def flat(self, matrix: Float[Tensor, "n n"]) -> Float[Tensor, " entries"]:
        """Return the vector of a matrix."""
        return matrix[tuple(torch.tril_indices(*matrix.shape))]
