"""L-NODE: a neural ordinary differential equation through the Euler-Lagrange equations."""

from typing import Any

from torch import Tensor

from symo_exp.mechanics.types import Coordinates
from symo_exp.models.base import ExplicitModel
from symo_exp.models.fields import EulerLagrangeAcceleration
from symo_exp.models.learned import MakesDissipation, Structure, learned_lagrangian
from symo_exp.models.learner import Learner
from symo_exp.models.objectives import StateError


class LNODE(ExplicitModel, Learner):
    """``v̇ = H⁻¹ (B u − Ḣ v + ℒ_q)`` of a learned Lagrangian (thesis section 4.3.4); trained on the
    error of the next state."""

    def __init__(
        self,
        *,
        coordinates: Coordinates,
        input_matrix: Tensor,
        width: int,
        depth: int = 2,
        initial_inertia: float | None = 1.0,
        harmonics: int = 0,
        structure: Structure = "network",
        dissipation: MakesDissipation | None = None,
        **base: Any,
    ) -> None:
        lagrangian = learned_lagrangian(
            coordinates,
            width=width,
            depth=depth,
            initial_inertia=initial_inertia,
            harmonics=harmonics,
            structure=structure,
            dissipation=dissipation,
        )
        field = EulerLagrangeAcceleration(lagrangian, input_matrix)
        super().__init__(field, StateError(), coordinates=coordinates, **base)
