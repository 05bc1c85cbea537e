"""The Euler-Lagrange equations solved for the acceleration."""

from jaxtyping import Float
from torch import Tensor

from symo_exp.mechanics.lagrangian import Lagrangian, matvec, solve


def acceleration(
    lagrangian: Lagrangian,
    q: Float[Tensor, "batch N"],
    v: Float[Tensor, "batch n"],
    force: Float[Tensor, "batch n"],
) -> Float[Tensor, "batch n"]:
    """Return ``v̇ = H⁻¹ (F − Ḣ v + ∂ℒ/∂q)`` (thesis (3.13), (3.14) with ``∂/∂q`` throughout).

    With rotations, whose velocities are in body axes, ``v̇ = H⁻¹ (F − Ḣ v − ω × p + ∂ℒ/∂q)``.
    ``force`` is the generalised force ``F = B u``. A singular inertia gives non-finite rows.
    """
    rates = lagrangian.rates(q, v)
    total = force - rates.mass_rate_v + rates.q
    if lagrangian.space.rotations:
        total = total - lagrangian.space.coadjoint(v, matvec(rates.mass, v))
    return solve(rates.mass, total)
