"""The learned Lagrangians of ``conf/lagrangian``, built for the coordinates of a system.

Another one is :class:`symo_exp.nets.rigid_chain.RigidChain`.
"""

from __future__ import annotations

from torch import Tensor
from typing_extensions import override

from symo_exp.errors import ConfigError
from symo_exp.mechanics.types import Coordinates
from symo_exp.nets.embedding import require_flat
from symo_exp.nets.structured_lagrangian import StructuredLagrangian


class NetworkLagrangian(StructuredLagrangian):
    """A network for a Cholesky factor of the inertia and for the potential.

    It reads the nine entries of each rotation.

    Args:
        coordinates: Coordinates of the system.
        width: Units of each hidden layer.
        depth: Number of hidden layers.
        harmonics: Largest number of angles that one harmonic of the linear part couples; 0: none.
        initial_inertia: Inertia near which training starts [kg, kg m²]; ``None``: the last layer
            is drawn as by PyTorch's default.
    """

    def __init__(
        self,
        *,
        coordinates: Coordinates,
        width: int,
        depth: int = 2,
        harmonics: int = 0,
        initial_inertia: float | None = 1.0,
    ) -> None:
        flat, rotations = len(coordinates.flat), len(coordinates.rotations)
        angular = coordinates.angular[:flat]
        if rotations and harmonics:
            raise ConfigError(
                f"lagrangian.harmonics={harmonics}: harmonics are of angles, and the system has "
                f"the rotation {', '.join(coordinates.rotations)}; set it to 0"
            )
        super().__init__(
            angular=angular,
            rotations=rotations,
            width=width,
            depth=depth,
            harmonics=harmonics,
            initial_inertia=initial_inertia,
        )
        self._coordinates = coordinates

    @override
    def input_force(self, input_matrix: Tensor, q: Tensor, u: Tensor) -> Tensor:
        return self._coordinates.input_force(input_matrix, q, u)


class PlanarLagrangian(StructuredLagrangian):
    """The Lagrangian of ``n`` joints, slides and hinges, whose links move in a plane.

    ::

        T = ½ Σ_r (A_r(q) · v)² + ½ Σ_i (aᵢ(q) vᵢ)²,   r = 1 … 2n,

    with ``A``, ``a`` and the potential affine in the cosines and sines of the links' directions:
    speeds of points of the links are linear in these, and rotors turn with a joint.

    Args:
        coordinates: Coordinates of the system.
        relative: Whether each angle counts from the link before, so that the directions are
            ``φ₁ + … + φᵢ``; else angles count from the world.
        harmonics: Largest number of angles that one harmonic of an additional linear part couples;
            0: there is none.
        initial_inertia: Inertia near which training starts [kg, kg m²]; ``None``: parameters are
            drawn as by PyTorch's default.
    """

    def __init__(
        self,
        *,
        coordinates: Coordinates,
        relative: bool,
        harmonics: int = 0,
        initial_inertia: float | None = 1.0,
    ) -> None:
        require_flat(coordinates, "this lagrangian", "lagrangian=network or rigid_body")
        super().__init__(
            angular=coordinates.angular,
            width=1,
            depth=1,
            harmonics=harmonics,
            initial_inertia=initial_inertia,
            squares=True,
            relative=relative,
        )
