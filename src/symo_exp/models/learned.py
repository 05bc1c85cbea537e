"""The Lagrangian that L-NODE, SyMo and E2E-SyMo learn."""

from __future__ import annotations

from typing import Any, Literal, Protocol, get_args

from symo_exp.errors import ConfigError
from symo_exp.mechanics.dissipation import Dissipation, DissipativeLagrangian
from symo_exp.mechanics.lagrangian import Lagrangian
from symo_exp.mechanics.types import Coordinates
from symo_exp.models.base import DynamicsModel
from symo_exp.models.objectives import Objective
from symo_exp.nets.rigid_chain import RigidChain
from symo_exp.nets.structured_lagrangian import StructuredLagrangian

Structure = Literal["network", "absolute", "relative", "rigid"]
"""A network, or what is true of rigid links, in a plane or in space: see ``LearnsLagrangian``."""


class MakesDissipation(Protocol):
    """A dissipation of some coordinates, to be learned (``conf/dissipation``)."""

    def __call__(self, *, coordinates: Coordinates) -> Dissipation: ...


class LearnsLagrangian(DynamicsModel):
    """A Lagrangian to learn, and a dissipation where one is to be learned, for the class beside it,
    which makes a flow of a Lagrangian.

    ``structure="network"`` has a network for a Cholesky factor of the inertia and the potential,
    ``structure="rigid"`` a chain of rigid bodies in space (``RigidChain``), each joint's angle
    counted from the link before and about one of the ``axes``, as far as they are known.
    Else it is that of ``n`` joints, slides and hinges, whose links move in a plane, without one::

        T = ½ Σ_r (A_r(q) · v)² + ½ Σ_i (aᵢ(q) vᵢ)²,   r = 1 … 2n,

    ``A``, ``a`` and ``V`` affine in ``s(q)``: speeds of points of the links are linear in the
    cosines and sines of the links' directions, and rotors turn with a joint. Directions are the
    angles themselves where they are ``absolute``, counted from the world, and their sums
    ``φ₁ + … + φᵢ`` where they are ``relative``, each joint's counted from the link before.
    ``width`` and ``depth`` are those of a network.
    """

    def __init__(
        self,
        objective: Objective,
        /,
        *,
        coordinates: Coordinates,
        width: int,
        depth: int = 2,
        initial_inertia: float | None = 1.0,
        harmonics: int = 0,
        structure: Structure = "network",
        axes: Any = None,
        dissipation: MakesDissipation | None = None,
        **base: Any,
    ) -> None:
        known = get_args(Structure)
        if structure not in known:
            raise ConfigError(f"structure={structure}: expected one of {', '.join(known)}")
        if axes is not None and structure != "rigid":
            raise ConfigError(
                f"axes={axes}: structure={structure} has none; expected structure=rigid"
            )
        lagrangian: Lagrangian
        if structure == "rigid":
            lagrangian = RigidChain(
                angular=coordinates.angular, initial_inertia=initial_inertia, axes=axes
            )
        else:
            lagrangian = StructuredLagrangian(
                angular=coordinates.angular,
                width=width,
                depth=depth,
                initial_inertia=initial_inertia,
                harmonics=harmonics,
                squares=structure != "network",
                relative=structure == "relative",
            )
        if dissipation is not None:
            lagrangian = DissipativeLagrangian(lagrangian, dissipation(coordinates=coordinates))
        super().__init__(lagrangian, objective, coordinates=coordinates, **base)  # type: ignore
