"""Differentiation of a root by the implicit function theorem (thesis theorem 5.2.1)."""

from jaxtyping import Float
from torch import Tensor

from symo_exp.mechanics.lagrangian import solve


def attach_root(
    x: Float[Tensor, "batch n"],
    residual: Float[Tensor, "batch n"],
    jacobian: Float[Tensor, "batch n n"],
) -> Float[Tensor, "batch n"]:
    """Return the root ``x`` of ``g(x; θ) = 0`` as a differentiable function of ``θ``.

    ``x`` and ``jacobian = ∂g/∂x`` are numbers; ``residual`` is ``g(x; θ)`` with a graph in
    ``θ``, ``x`` itself held fixed. The result, ``x − J⁻¹ g(x; θ)``, has the value of the root
    (one Newton correction further) and the derivative ``∂x/∂θ = −J⁻¹ ∂g/∂θ``; its backward pass
    solves with ``Jᵀ``, the corrected (5.24).
    """
    return x.detach() - solve(jacobian.detach(), residual)
