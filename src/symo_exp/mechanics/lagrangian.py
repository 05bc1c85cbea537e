"""Lagrangians of mechanical systems, ``ℒ(q, v) = ½ vᵀ H(q) v − V(q)`` (thesis (3.10)).

Where a configuration has rotations, derivatives in ``q`` are those along ``Space.retract`` at a
fixed ``v``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from typing_extensions import override

from symo_exp.mechanics.returned import checked_tensor, returned
from symo_exp.mechanics.rows import Rowwise
from symo_exp.mechanics.space import FLAT, Space


class Gradients(NamedTuple):
    """First derivatives of ``ℒ``."""

    q: Float[Tensor, "batch n"]
    """``∂ℒ/∂q``."""
    v: Float[Tensor, "batch n"]
    """``∂ℒ/∂v = H v``, the momentum."""


class Curvature(NamedTuple):
    """Second derivatives of ``ℒ``, except ``∂²ℒ/∂v² = H``.

    With dissipation ``ℒ_q`` means ``ℒ_q + F_d``, and ``qv`` is no longer ``vqᵀ``.
    """

    qq: Float[Tensor, "batch n n"]
    """``∂²ℒ/∂qᵢ∂qⱼ``."""
    vq: Float[Tensor, "batch n n"]
    """``∂²ℒ/∂vᵢ∂qⱼ = (∂H/∂qⱼ v)ᵢ``."""
    qv: Float[Tensor, "batch n n"]
    """``∂²ℒ/∂qᵢ∂vⱼ``."""


class Rates(NamedTuple):
    """Terms of the Euler-Lagrange equations along a motion."""

    mass: Float[Tensor, "batch n n"]
    """``H(q)``."""
    mass_rate_v: Float[Tensor, "batch n"]
    """``Ḣ v = Σⱼ vⱼ (∂H/∂qⱼ) v``."""
    q: Float[Tensor, "batch n"]
    """``∂ℒ/∂q``."""


class Expansion(Rowwise, ABC):
    """``ℒ`` around one batch of points ``(q, v)``: values now, derivatives on demand.

    Root finding needs the gradients, possibly the curvature, and at the root differentiable
    gradients. An implementation can reuse the results of its first pass.
    """

    values: Gradients
    """Gradients at the point, without a graph."""
    _lagrangian: Lagrangian
    """``ℒ``; without it a subclass has ``gradients`` of its own."""

    @abstractmethod
    def mass(self) -> Float[Tensor, "batch n n"]:
        """Return ``H`` at the point, without a graph."""

    @abstractmethod
    def curvature(self, before: Expansion | None = None) -> Curvature:
        """Return the second derivatives at the point, without a graph.

        ``before`` is the expansion around the previous iterate of a root finder: where a force
        bends sharply between them, as dry friction does, the slope of the chord may replace its
        derivative, so that iterates do not oscillate.
        """

    dissipates: ClassVar[bool] = False
    """True if there is a dissipative force ``F_d``."""

    def damping(self) -> Float[Tensor, "batch n n"]:
        """Return ``∂F_d/∂v``, or its stiff part, without a graph."""
        raise TypeError("there is no dissipation")

    def gradients(self, q: Tensor, v: Tensor) -> Gradients:
        """Return the gradients as differentiable functions of ``q``, ``v`` and the parameters.

        ``q`` and ``v`` must have the values of this point; they carry the graph.
        """
        return self._lagrangian.gradients(q, v)


class Lagrangian(ABC):
    """A mechanical Lagrangian, defined by its inertia and potential.

    Derivatives are computed by automatic differentiation of ``mass_matrix`` and ``potential``; a
    subclass with closed forms overrides ``gradients``, ``rates`` and ``expand``.
    """

    @property
    def space(self) -> Space:
        """The space of configurations."""
        return FLAT

    def input_force(
        self,
        input_matrix: Float[Tensor, "n m"],
        q: Float[Tensor, "batch N"],
        u: Float[Tensor, "batch m"],
    ) -> Float[Tensor, "batch n"]:
        """Return the generalised force of controls; it depends on ``q`` with rotations only."""
        return u @ input_matrix.T

    @abstractmethod
    def mass_matrix(self, q: Float[Tensor, "batch N"]) -> Float[Tensor, "batch n n"]:
        """Return the inertia ``H(q)``, symmetric and positive definite (thesis (3.9))."""

    @abstractmethod
    def potential(self, q: Float[Tensor, "batch N"]) -> Float[Tensor, " batch"]:
        """Return the potential energy ``V(q)`` [J]."""

    def terms(self, q: Tensor) -> tuple[Tensor, Tensor]:
        """Return ``H(q)`` and ``V(q)``, also of complex ``q``. Override it if they share work."""
        return self.mass_matrix(q), self.potential(q)

    def kinetic(
        self, q: Float[Tensor, "batch N"], v: Float[Tensor, "batch n"]
    ) -> Float[Tensor, " batch"]:
        """Return the kinetic energy ``T = ½ vᵀ H(q) v`` [J] (thesis (3.9))."""
        return 0.5 * (v * self.momentum(q, v)).sum(-1)

    def energy(
        self, q: Float[Tensor, "batch N"], v: Float[Tensor, "batch n"]
    ) -> Float[Tensor, " batch"]:
        """Return the total energy ``E = T + V`` [J]."""
        return self.kinetic(q, v) + self.potential(q)

    def momentum(
        self, q: Float[Tensor, "batch N"], v: Float[Tensor, "batch n"]
    ) -> Float[Tensor, "batch n"]:
        """Return the generalised momentum ``p = ∂ℒ/∂v = H(q) v``."""
        return matvec(self.mass_matrix(q), v)

    def velocity(
        self, q: Float[Tensor, "batch N"], p: Float[Tensor, "batch n"]
    ) -> Float[Tensor, "batch n"]:
        """Return the inverse Legendre transform, ``v = H(q)⁻¹ p``."""
        return solve(self.mass_matrix(q), p)

    def gradients(self, q: Float[Tensor, "batch N"], v: Float[Tensor, "batch n"]) -> Gradients:
        """Return ``∂ℒ/∂q`` and ``∂ℒ/∂v``, differentiable where gradients are enabled."""
        tracked = torch.is_grad_enabled()
        *_, found = differentiated(self, q, v, tracked=tracked)
        return found if tracked else Gradients(*(x.detach() for x in found))

    def rates(self, q: Float[Tensor, "batch N"], v: Float[Tensor, "batch n"]) -> Rates:
        """Return the terms of the Euler-Lagrange equations (3.11), (3.12)."""
        dq = self.gradients(q, v).q
        mass, mass_rate = torch.func.jvp(self.mass_matrix, (q,), (self.space.push(q, v),))[:2]
        return Rates(mass, matvec(mass_rate, v), dq)

    def expand(self, q: Float[Tensor, "batch N"], v: Float[Tensor, "batch n"]) -> Expansion:
        """Return ``ℒ`` around ``(q, v)``, as root finding needs it."""
        return AutodiffExpansion(self, q.detach(), v.detach())


@torch.enable_grad()
def differentiated(
    lagrangian: Lagrangian,
    q: Float[Tensor, "batch N"],
    v: Float[Tensor, "batch n"],
    *,
    tracked: bool,
) -> tuple[Float[Tensor, "batch N"], Float[Tensor, "batch n n"], Gradients]:
    """Return ``q`` with a graph, ``H`` and the gradients, by automatic differentiation.

    The gradients are differentiable if ``tracked``, and ``H`` always in the returned ``q``.
    """
    q_ = q if tracked and q.requires_grad else q.detach().requires_grad_()
    mass, potential = lagrangian.terms(q_)
    p = matvec(mass, v)
    # The vanishing term keeps q in the graph of a Lagrangian that does not depend on it.
    total = (0.5 * (v * p).sum(-1) - potential).sum() + 0.0 * q_.sum()
    (dq,) = torch.autograd.grad(total, q_, create_graph=tracked, retain_graph=True)
    return q_, mass, Gradients(lagrangian.space.pull(q_, dq), p)


class AutodiffExpansion(Expansion):
    """An expansion by automatic differentiation, for any Lagrangian.

    Args:
        lagrangian: ``ℒ``.
        q: Configurations.
        v: Velocities.
    """

    parts = ("_lagrangian", "_q", "_v", "_mass", "values")

    def __init__(self, lagrangian: Lagrangian, q: Tensor, v: Tensor) -> None:
        self._lagrangian, self._q, self._v = lagrangian, q, v
        self._mass: Tensor | None = None
        with torch.no_grad():
            self.values = lagrangian.gradients(q, v)

    @override
    def mass(self) -> Tensor:
        if self._mass is None:
            with torch.no_grad():
                self._mass = self._lagrangian.mass_matrix(self._q)
        return self._mass

    @override
    def curvature(self, before: Expansion | None = None) -> Curvature:
        with torch.enable_grad():
            q = self._q.clone().requires_grad_()
            gradients = self._lagrangian.gradients(q, self._v)
            qq, vq = (jacobian(y, q).detach() for y in (gradients.q, gradients.v))
        place = q.detach().unsqueeze(1)
        qq, vq = (self._lagrangian.space.pull(place, x) for x in (qq, vq))
        return Curvature(qq, vq, vq.mT)


def evaluated(lagrangian: Lagrangian, q: Float[Tensor, "batch N"], n: int) -> dict[str, Tensor]:
    """Return ``mass_matrix(q)`` and ``potential(q)`` of a class that may be a user's, by name.

    Args:
        lagrangian: The Lagrangian.
        q: Configurations; their number differs from ``n``, so that shapes show the batch.
        n: Number of coordinates.

    Raises:
        ConfigError: If a function fails or returns no tensor of the right shape and precision.
    """
    found: dict[str, Tensor] = {}
    for name, shape in (("mass_matrix", (len(q), n, n)), ("potential", (len(q),))):
        told = f"{type(lagrangian).__name__}.{name}(q)"
        value = returned(told, getattr(lagrangian, name), q)
        given = f"q of shape {tuple(q.shape)}"
        found[name] = checked_tensor(told, value, shape, q.dtype, given)
    return found


def matvec(
    matrix: Float[Tensor, "*#batch n k"], vector: Float[Tensor, "*#batch k"]
) -> Float[Tensor, "*batch n"]:
    """Return ``A x`` for a batch of matrices and vectors."""
    return _product(matrix, vector.unsqueeze(-1)).squeeze(-1)


def vecmat(
    vector: Float[Tensor, "*#batch n"], matrix: Float[Tensor, "*#batch n k"]
) -> Float[Tensor, "*batch k"]:
    """Return ``xᵀ A`` for a batch of vectors and matrices."""
    return _product(vector.unsqueeze(-2), matrix).squeeze(-2)


def _product(left: Tensor, right: Tensor) -> Tensor:
    """`torch.matmul` without its broadcasting for equal batches, the usual case here."""
    if left.ndim == right.ndim == 3 and left.shape[0] == right.shape[0]:
        return torch.bmm(left, right)
    return torch.matmul(left, right)


def solve(
    matrix: Float[Tensor, "*batch n n"], vector: Float[Tensor, "*batch n"]
) -> Float[Tensor, "*batch n"]:
    """Return ``A⁻¹ x`` for a batch; a singular matrix gives non-finite rows, not an exception."""
    return torch.linalg.solve_ex(matrix, vector.unsqueeze(-1))[0].squeeze(-1)


def jacobian(
    y: Float[Tensor, "batch k"], x: Float[Tensor, "batch n"], *, tracked: bool = False
) -> Float[Tensor, "batch k n"]:
    """Return ``∂y_bi/∂x_bj`` of a function that acts row by row, differentiable if ``tracked``."""
    if not y.requires_grad:  # a constant inertia
        return x.new_zeros(x.shape[0], y.shape[1], x.shape[1])
    rows = [
        torch.autograd.grad(
            y[:, i].sum(), x, retain_graph=True, create_graph=tracked, allow_unused=True
        )[0]
        for i in range(y.shape[1])
    ]
    return torch.stack([torch.zeros_like(x) if row is None else row for row in rows], dim=1)
