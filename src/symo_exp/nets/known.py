"""Known equations of motion whose constants are learned."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn
from typing_extensions import override

from symo_exp.checks import real
from symo_exp.errors import ConfigError, place_in_code, shortened
from symo_exp.mechanics.dissipation import Dissipation, chord_excess
from symo_exp.mechanics.lagrangian import (
    Curvature,
    Expansion,
    Gradients,
    Lagrangian,
    Rates,
    differentiated,
    jacobian,
)
from symo_exp.mechanics.space import Space
from symo_exp.mechanics.types import Constant, Coordinates
from symo_exp.nets.affine import by_sample, repeated
from symo_exp.nets.roles import mark
from symo_exp.nets.triangle import Triangle

LEAST_REST = 0.2
"""Learned width of dry friction over the initial one, at least."""
SHIFT, AGREEMENT = 1e-4, 1e-5
"""Change of the logarithm of a constant in the check of derivatives, and the error allowed."""


class KnownLagrangian(nn.Module, Lagrangian):
    """A system's own inertia and potential, with its constants as parameters.

    Numbers are ``c = c₀ exp(θ)`` and pseudo-inertias ``U₀ E Eᵀ U₀ᵀ`` with ``E`` upper triangular,
    ``E_ii = exp(θ_ii)`` (the log-Cholesky parametrisation of Rucker and Wensing, "Smooth
    parameterization of rigid-body inertia", 2022), so that every ``θ`` is a possible machine and
    ``θ = 0`` the given one.

    Args:
        system: The system; its ``constants`` are the values to start from.
        fixed: Names of constants that keep their values.
        coordinates: Coordinates of the system.
    """

    def __init__(
        self, *, system: Any, fixed: Sequence[str] = (), coordinates: Coordinates | None = None
    ) -> None:
        super().__init__()
        known: Mapping[str, Constant] | None = getattr(system, "constants", None)
        if known is None:
            raise ConfigError(
                f"lagrangian=known: {type(system).__name__} has no known equations; give a system "
                "that has, such as system=mujoco system.model=FILE, or another lagrangian"
            )
        unknown = sorted(set(fixed) - set(known))
        if unknown:
            raise ConfigError(
                f"lagrangian.fixed={unknown}: no such constant; there are {', '.join(known)}"
            )
        self.system = system
        self._closed_form: bool = system.closed_form
        self.given = {name: constant for name, constant in known.items() if name not in fixed}
        if not self.given:
            raise ConfigError("lagrangian.fixed: at least one constant has to be free")
        self.numbers = [k for k, constant in self.given.items() if constant.value.ndim == 0]
        self.bodies = [k for k, constant in self.given.items() if constant.value.ndim == 2]
        self._roots = {name: _upper(known[name].value) for name in self.bodies}
        self._triangle = Triangle(4)
        self.logarithms = nn.Parameter(torch.zeros(len(self.numbers)))
        self.factors = nn.Parameter(torch.zeros(self._triangle.entries * len(self.bodies)))
        """The upper triangle of each ``E``, row by row; logarithms on its diagonal."""
        mark(self.parameters(), "coefficient")
        self._check_derivatives()

    @property
    @override
    def space(self) -> Space:
        found: Space = self.system.space
        return found

    @override
    def input_force(self, input_matrix: Tensor, q: Tensor, u: Tensor) -> Tensor:
        found: Tensor = self.system.input_force(input_matrix, q, u)
        return found

    def constants(self) -> dict[str, Tensor]:
        """Return the present values by name, differentiable in the parameters."""
        return self._values(self.logarithms, self.factors)

    @override
    def mass_matrix(self, q: Float[Tensor, "batch N"]) -> Float[Tensor, "batch n n"]:
        return self.terms(q)[0]

    @override
    def potential(self, q: Float[Tensor, "batch N"]) -> Float[Tensor, " batch"]:
        return self.terms(q)[1]

    @override
    def terms(self, q: Tensor) -> tuple[Tensor, Tensor]:
        mass, potential = self._by_system(lambda at, q: at.terms(q), q)
        return mass, potential

    @override
    def gradients(self, q: Float[Tensor, "batch N"], v: Float[Tensor, "batch n"]) -> Gradients:
        if self._closed_form:
            return Gradients(*self._by_system(lambda at, q, v: at.gradients(q, v), q, v))
        return super().gradients(q, v)

    @override
    def rates(self, q: Float[Tensor, "batch N"], v: Float[Tensor, "batch n"]) -> Rates:
        if self._closed_form:
            return Rates(*self._by_system(lambda at, q, v: at.rates(q, v), q, v))
        tracked = torch.is_grad_enabled()
        q_, mass, (dq, p) = differentiated(self, q, v, tracked=tracked)
        with torch.enable_grad():
            moved = self.space.push(q_, v).unsqueeze(1)
            turned = (jacobian(p, q_, tracked=tracked) * moved).sum(-1)
        found = Rates(mass, turned, dq)
        return found if tracked else Rates(*(x.detach() for x in found))

    @override
    @torch.no_grad()
    def expand(self, q: Float[Tensor, "batch N"], v: Float[Tensor, "batch n"]) -> Expansion:
        if not self._closed_form:
            return super().expand(q, v)
        twin = self.system.with_constants(self.constants())
        return KnownExpansion(self, twin.expand(q.detach(), v.detach()))

    def _by_system(
        self, function: Callable[..., tuple[Tensor, ...]], *state: Tensor
    ) -> tuple[Tensor, ...]:
        """Return a function of the system with the present constants and of ``state``."""
        if not by_sample():
            return function(self.system.with_constants(self.constants()), *state)
        batch = state[0].shape[0]
        parameters = repeated(self.logarithms, batch), repeated(self.factors, batch)
        return self._by_row(function, *parameters, *state)

    def _by_row(
        self, function: Callable[..., tuple[Tensor, ...]], *given: Tensor
    ) -> tuple[Tensor, ...]:
        """Return a function of the system whose constants differ from row to row.

        Args:
            function: The function.
            given: Parameters, and the state, in each row.
        """

        def of_one(logarithms: Tensor, factors: Tensor, *state: Tensor) -> tuple[Tensor, ...]:
            twin = self.system.with_constants(self._values(logarithms, factors))
            return tuple(x.squeeze(0) for x in function(twin, *(x.unsqueeze(0) for x in state)))

        found: tuple[Tensor, ...] = torch.func.vmap(of_one)(*given)
        return found

    def _values(self, logarithms: Tensor, factors: Tensor) -> dict[str, Tensor]:
        found = {}
        for i, name in enumerate(self.numbers):
            found[name] = self.given[name].value.to(logarithms) * logarithms[i].exp()
        for name, own in zip(self.bodies, factors.view(-1, self._triangle.entries), strict=True):
            square = self._triangle.square(own.flip(0)).flip(0, 1)
            factor = torch.triu(square, 1) + torch.diag(square.diagonal().exp())
            root = self._roots[name].to(factors) @ factor
            found[name] = root @ root.mT
        return found

    def _check_derivatives(self) -> None:
        """Refuse a system whose code loses the derivatives in its constants."""
        flat = torch.zeros(len(self.logarithms) + len(self.factors), dtype=torch.float64)
        q, *_ = self.system.points(4, seed=0)
        split = [len(self.logarithms), len(self.factors)]

        def by_row(flat: Tensor) -> Tensor:
            rows = (x.expand(len(q), -1) for x in flat.split(split))
            return total(*self._by_row(lambda at, q: at.terms(q), *rows, q))

        def by_all(flat: Tensor) -> Tensor:
            return total(*self.system.with_constants(self._values(*flat.split(split))).terms(q))

        def total(mass: Tensor, potential: Tensor) -> Tensor:
            weight = torch.arange(1.0, 1.0 + mass[0].numel()).to(mass).view_as(mass[0]).cos()
            return (mass * weight).sum() + potential.sum()

        try:
            with torch.enable_grad():
                at = flat.clone().requires_grad_()
                value = by_row(at)
                gradient = (
                    torch.autograd.grad(value, at)[0] if value.requires_grad else flat.clone()
                )
        except (RuntimeError, TypeError) as error:
            reason = f"{shortened(error, 200)}{place_in_code(error)}"
            raise ConfigError(self._complaint(reason)) from error
        with torch.no_grad():
            steps = SHIFT * torch.eye(len(flat), dtype=torch.float64)
            slopes = [(by_all(flat + s) - by_all(flat - s)) / (2.0 * SHIFT) for s in steps]
            size = max(float(value.detach().abs()), float(gradient.abs().max()), 1e-12)
            apart = float((torch.stack(slopes) - gradient).abs().max())
        if not apart <= AGREEMENT * size:
            raise ConfigError(self._complaint("derivatives in a constant are wrong"))

    def _complaint(self, reason: str) -> str:
        return (
            f"lagrangian=known: {type(self.system).__name__} cannot be differentiated in its "
            f"constants ({reason}); write its equations in tensor operations, e.g. "
            "`constant * torch.ones_like(q)` for torch.full_like(q, constant), or q.new_zeros(...) "
            "for a tensor whose entries are set"
        )


class KnownExpansion(Expansion):
    """Known equations around ``(q, v)``, by the closed forms of their system.

    Args:
        lagrangian: The known equations.
        at: Those with the present constants, expanded.
    """

    parts = ("_lagrangian", "_at", "values")

    def __init__(self, lagrangian: KnownLagrangian, at: Expansion) -> None:
        self._lagrangian, self._at = lagrangian, at
        self.values = at.values

    @override
    def mass(self) -> Tensor:
        return self._at.mass()

    @override
    def curvature(self, before: Expansion | None = None) -> Curvature:
        return self._at.curvature()


class KnownFriction(nn.Module, Dissipation):
    """A system's own friction, its coefficients as parameters, beside its fixed drag.

    ``F_d = −d ∘ v − c ∘ tanh(v / ε_v)``, with ``d = d₀ exp(θ)`` and ``c`` likewise: coefficients
    that are zero to begin with stay so.

    Args:
        system: The system; its coefficients are the values to start from.
        missing: Coefficients to start from where the system has none, a number or one for each
            coordinate [N m s, N m; N s/m, N].
        rest_velocity: ``ε_v`` [rad/s, m/s]; ``None``: the system's.
        learned_rest: Whether ``ε_v`` is learned, one for each coordinate, never below a fifth of
            this.
        coordinates: Coordinates of the system.
    """

    def __init__(
        self,
        *,
        system: Any,
        missing: float | Sequence[float] = 0.0,
        rest_velocity: float | None = None,
        learned_rest: bool = False,
        coordinates: Coordinates | None = None,
    ) -> None:
        super().__init__()
        n = system.coordinates.n
        none = (0.0,) * n
        if not hasattr(system, "viscous"):
            raise ConfigError(
                f"dissipation=known: {type(system).__name__} has no known friction; choose another "
                "dissipation"
            )
        each = [missing] * n if isinstance(missing, int | float) else list(missing)
        if len(each) != n:
            raise ConfigError(
                f"dissipation.missing={missing}: expected a number, or {n}, one for each coordinate"
            )
        start = [real("dissipation.missing", x, low=0) for x in each]
        viscous, coulomb = system.viscous or none, system.coulomb or none
        width = system.rest_velocity if rest_velocity is None else rest_velocity
        self.rest_velocity = real("dissipation.rest_velocity", width, above=0)
        self.drag: Dissipation | None = replace(system, viscous=none, coulomb=none).dissipation
        given = zip((*viscous, *coulomb), (*start, *start), strict=True)
        coefficients = [float(own or other) for own, other in given]
        self.given: Tensor
        known = torch.tensor(coefficients, dtype=torch.float64).to(torch.get_default_dtype())
        self.register_buffer("given", known, persistent=False)
        self.free = [i for i, x in enumerate(coefficients) if x > 0.0]
        index = torch.full((2 * n,), len(self.free))
        index[self.free] = torch.arange(len(self.free))
        self.index: Tensor
        self.register_buffer("index", index, persistent=False)
        self.logarithms = nn.Parameter(torch.zeros(len(self.free)))
        mark(self.parameters(), "coefficient")
        self.rest = nn.Parameter(torch.zeros(n)) if learned_rest else None

    def width(self, batch: int = 1) -> Tensor | float:
        """Return ``ε_v``, (batch, n) if it is learned."""
        if self.rest is None:
            return self.rest_velocity
        share = LEAST_REST + (1.0 - LEAST_REST) * repeated(self.rest, batch).exp()
        return self.rest_velocity * share

    def coefficients(self, batch: int = 1) -> tuple[Tensor, Tensor]:
        """Return ``d`` and ``c``, (batch, n) each."""
        own = repeated(self.logarithms, batch)
        padded = torch.cat((own, torch.zeros_like(self.given[:1]).expand(batch, 1)), dim=1)
        found = self.given * padded[:, self.index].exp()
        viscous, coulomb = found.chunk(2, dim=1)
        return viscous, coulomb

    @override
    def derivatives(
        self, q: Float[Tensor, "batch N"], v: Float[Tensor, "batch n"]
    ) -> tuple[Float[Tensor, "batch n n"], Float[Tensor, "batch n n"]]:
        if self.drag is not None:
            return super().derivatives(q, v)
        by_v = self.damping(q, v)
        return torch.zeros_like(by_v), by_v

    @override
    @torch.no_grad()
    def damping(
        self, q: Float[Tensor, "batch N"], v: Float[Tensor, "batch n"]
    ) -> Float[Tensor, "batch n n"]:
        """Return ``∂F_d/∂v`` of the coefficients: the drag is not stiff."""
        (viscous, coulomb), width = self.coefficients(), self.width()
        bent = 1.0 - torch.tanh(v / width).square()
        return -torch.diag_embed(viscous + coulomb / width * bent)

    @override
    @torch.no_grad()
    def chord(
        self, v: Float[Tensor, "batch n"], before: Float[Tensor, "batch n"]
    ) -> Float[Tensor, "batch n n"]:
        (_, coulomb), width = self.coefficients(), self.width()
        return -torch.diag_embed(coulomb / width * chord_excess(v, before, width))

    @override
    def force(
        self, q: Float[Tensor, "batch N"], v: Float[Tensor, "batch n"]
    ) -> Float[Tensor, "batch n"]:
        viscous, coulomb = self.coefficients(v.shape[0])
        found = -viscous * v - coulomb * torch.tanh(v / self.width(v.shape[0]))
        return found if self.drag is None else found + self.drag.force(q, v)


def _upper(matrix: Float[Tensor, "k k"]) -> Float[Tensor, "k k"]:
    """Return the upper triangular ``U`` with ``U Uᵀ`` the matrix."""
    return torch.linalg.cholesky(matrix.flip(0, 1)).flip(0, 1)
