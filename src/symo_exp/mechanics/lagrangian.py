"""Lagrangians of mechanical systems, ``ℒ(q, v) = ½ vᵀ H(q) v − V(q)`` (thesis (3.10))."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from symo_exp.mechanics.rows import Rowwise


class Gradients(NamedTuple):
    """First derivatives of ``ℒ``."""

    q: Float[Tensor, "batch n"]
    """``∂ℒ/∂q``."""
    v: Float[Tensor, "batch n"]
    """``∂ℒ/∂v = H v``, the momentum."""


class Curvature(NamedTuple):
    """Second derivatives of ``ℒ``, but for ``∂²ℒ/∂v² = H``.

    With dissipation ``ℒ_q`` stands for ``ℒ_q + F_d``, and ``qv`` is no longer ``vqᵀ``.
    """

    qq: Float[Tensor, "batch n n"]
    """``∂²ℒ/∂qᵢ∂qⱼ``."""
    vq: Float[Tensor, "batch n n"]
    """``∂²ℒ/∂vᵢ∂qⱼ = (∂H/∂qⱼ v)ᵢ``."""
    qv: Float[Tensor, "batch n n"]
    """``∂²ℒ/∂qᵢ∂vⱼ``."""


class Rates(NamedTuple):
    """What the Euler-Lagrange equations need of ``ℒ`` along a motion."""

    mass: Float[Tensor, "batch n n"]
    """``H(q)``."""
    mass_rate_v: Float[Tensor, "batch n"]
    """``Ḣ v = Σⱼ vⱼ (∂H/∂qⱼ) v``."""
    q: Float[Tensor, "batch n"]
    """``∂ℒ/∂q``."""


class Expansion(Rowwise, ABC):
    """``ℒ`` around one batch of points ``(q, v)``: numbers now, derivatives on demand.

    A root finder asks for the gradients, perhaps for the curvature, and at the root for gradients
    that can be differentiated. Keeping the point as an object lets an implementation keep what
    its first pass computed.
    """

    values: Gradients
    """Gradients at the point, without a graph."""

    @abstractmethod
    def mass(self) -> Float[Tensor, "batch n n"]:
        """``H`` at the point, without a graph."""

    @abstractmethod
    def curvature(self) -> Curvature:
        """Second derivatives at the point, without a graph."""

    dissipates: ClassVar[bool] = False
    """Whether a dissipative force ``F_d`` belongs to ``ℒ``."""

    def damping(self) -> Float[Tensor, "batch n n"]:
        """``∂F_d/∂v``, or what of it may be stiff, without a graph."""
        raise TypeError("there is no dissipation")

    @abstractmethod
    def gradients(self, q: Tensor, v: Tensor) -> Gradients:
        """The gradients as differentiable functions of ``q``, ``v`` and the parameters.

        ``q`` and ``v`` must hold the values of this point; they carry the graph.
        """


class Lagrangian(ABC):
    """A mechanical Lagrangian: give the inertia and the potential, the rest follows.

    The derivatives here are by automatic differentiation of ``mass_matrix`` and ``potential``;
    a subclass with closed forms overrides ``gradients``, ``rates`` and ``expand``.
    """

    @abstractmethod
    def mass_matrix(self, q: Float[Tensor, "batch n"]) -> Float[Tensor, "batch n n"]:
        """Generalised inertia ``H(q)``, symmetric and positive definite (thesis (3.9))."""

    @abstractmethod
    def potential(self, q: Float[Tensor, "batch n"]) -> Float[Tensor, " batch"]:
        """Potential energy ``V(q)`` [J]."""

    def terms(self, q: Tensor) -> tuple[Tensor, Tensor]:
        """``H(q)`` and ``V(q)``, of complex ``q`` too; to be overridden where they share work."""
        return self.mass_matrix(q), self.potential(q)

    def kinetic(
        self, q: Float[Tensor, "batch n"], v: Float[Tensor, "batch n"]
    ) -> Float[Tensor, " batch"]:
        """Kinetic energy ``T = ½ vᵀ H(q) v`` [J] (thesis (3.9))."""
        return 0.5 * (v * self.momentum(q, v)).sum(-1)

    def energy(
        self, q: Float[Tensor, "batch n"], v: Float[Tensor, "batch n"]
    ) -> Float[Tensor, " batch"]:
        """Total energy ``E = T + V`` [J]."""
        return self.kinetic(q, v) + self.potential(q)

    def momentum(
        self, q: Float[Tensor, "batch n"], v: Float[Tensor, "batch n"]
    ) -> Float[Tensor, "batch n"]:
        """Generalised momentum ``p = ∂ℒ/∂v = H(q) v``."""
        return matvec(self.mass_matrix(q), v)

    def velocity(
        self, q: Float[Tensor, "batch n"], p: Float[Tensor, "batch n"]
    ) -> Float[Tensor, "batch n"]:
        """The inverse Legendre transform, ``v = H(q)⁻¹ p``."""
        return solve(self.mass_matrix(q), p)

    def gradients(self, q: Float[Tensor, "batch n"], v: Float[Tensor, "batch n"]) -> Gradients:
        """``∂ℒ/∂q`` and ``∂ℒ/∂v``, differentiable where gradients are enabled."""
        tracked = torch.is_grad_enabled()
        with torch.enable_grad():
            q_ = q if tracked and q.requires_grad else q.detach().requires_grad_()
            p = self.momentum(q_, v)
            lagrangian = 0.5 * (v * p).sum(-1) - self.potential(q_)
            # The vanishing term keeps q in the graph of a Lagrangian that does not depend on it.
            total = lagrangian.sum() + 0.0 * q_.sum()
            (dq,) = torch.autograd.grad(total, q_, create_graph=tracked)
        return Gradients(dq, p) if tracked else Gradients(dq, p.detach())

    def rates(self, q: Float[Tensor, "batch n"], v: Float[Tensor, "batch n"]) -> Rates:
        """``H``, ``Ḣ v`` and ``∂ℒ/∂q``: the terms of the Euler-Lagrange equations (3.11)-(3.12)."""
        dq = self.gradients(q, v).q
        mass, mass_rate = torch.func.jvp(self.mass_matrix, (q,), (v,))[:2]
        return Rates(mass, matvec(mass_rate, v), dq)

    def expand(self, q: Float[Tensor, "batch n"], v: Float[Tensor, "batch n"]) -> Expansion:
        """``ℒ`` around ``(q, v)``, as root finding needs it."""
        return AutodiffExpansion(self, q.detach(), v.detach())


class AutodiffExpansion(Expansion):
    """An expansion that differentiates automatically, for any Lagrangian."""

    parts = ("_lagrangian", "_q", "_v", "values", "_mass")

    def __init__(
        self,
        lagrangian: Lagrangian,
        q: Tensor,
        v: Tensor,
        values: Gradients | None = None,
        mass: Tensor | None = None,
    ) -> None:
        """``values`` and ``mass`` at the point, where they are known already."""
        self._lagrangian, self._q, self._v, self._mass = lagrangian, q, v, mass
        with torch.no_grad():
            self.values = lagrangian.gradients(q, v) if values is None else values

    def mass(self) -> Tensor:
        if self._mass is None:
            with torch.no_grad():
                self._mass = self._lagrangian.mass_matrix(self._q)
        return self._mass

    def curvature(self) -> Curvature:
        with torch.enable_grad():
            q = self._q.clone().requires_grad_()
            gradients = self._lagrangian.gradients(q, self._v)
            qq, vq = (jacobian(y, q).detach() for y in (gradients.q, gradients.v))
        return Curvature(qq, vq, vq.mT)

    def gradients(self, q: Tensor, v: Tensor) -> Gradients:
        return self._lagrangian.gradients(q, v)


def matvec(
    matrix: Float[Tensor, "*#batch n k"], vector: Float[Tensor, "*#batch k"]
) -> Float[Tensor, "*batch n"]:
    """``A x`` for a batch of matrices and vectors."""
    return _product(matrix, vector.unsqueeze(-1)).squeeze(-1)


def vecmat(
    vector: Float[Tensor, "*#batch n"], matrix: Float[Tensor, "*#batch n k"]
) -> Float[Tensor, "*batch k"]:
    """``xᵀ A``, likewise."""
    return _product(vector.unsqueeze(-2), matrix).squeeze(-2)


def _product(left: Tensor, right: Tensor) -> Tensor:
    """`torch.matmul`; one batch on both sides, the rule here, is spared its broadcasting."""
    if left.ndim == right.ndim == 3 and left.shape[0] == right.shape[0]:
        return torch.bmm(left, right)
    return torch.matmul(left, right)


def solve(
    matrix: Float[Tensor, "batch n n"], vector: Float[Tensor, "batch n"]
) -> Float[Tensor, "batch n"]:
    """``A⁻¹ x`` for a batch; a singular matrix gives non-finite rows, not an exception."""
    return torch.linalg.solve_ex(matrix, vector.unsqueeze(-1))[0].squeeze(-1)


def jacobian(
    y: Float[Tensor, "batch k"], x: Float[Tensor, "batch n"]
) -> Float[Tensor, "batch k n"]:
    """``∂y_bi/∂x_bj`` of a function that acts row by row."""
    if not y.requires_grad:  # a constant inertia
        return x.new_zeros(len(x), y.shape[1], x.shape[1])
    rows = [
        torch.autograd.grad(y[:, i].sum(), x, retain_graph=True, allow_unused=True)[0]
        for i in range(y.shape[1])
    ]
    return torch.stack([torch.zeros_like(x) if row is None else row for row in rows], dim=1)
