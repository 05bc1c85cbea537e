"""SyMo: a symplectic-momentum network (thesis section 5.1)."""

from typing import Any

from symo_exp.mechanics.types import Coordinates
from symo_exp.models.base import VariationalModel
from symo_exp.models.learned import MakesDissipation, Structure, learned_lagrangian
from symo_exp.models.learner import Learner
from symo_exp.models.objectives import Objective, Residual


class SyMo(VariationalModel, Learner):
    """A learned Lagrangian in a variational integrator, trained on the violation of the discrete
    Euler-Lagrange equations at the data; it finds roots only to predict."""

    def __init__(
        self,
        *,
        coordinates: Coordinates,
        objective: Objective | None = None,
        width: int,
        depth: int = 2,
        initial_inertia: float | None = 1.0,
        harmonics: int = 0,
        structure: Structure = "network",
        dissipation: MakesDissipation | None = None,
        **base: Any,
    ) -> None:
        """``objective`` is one of a variational flow, ``Residual`` if left out."""
        lagrangian = learned_lagrangian(
            coordinates,
            width=width,
            depth=depth,
            initial_inertia=initial_inertia,
            harmonics=harmonics,
            structure=structure,
            dissipation=dissipation,
        )
        super().__init__(lagrangian, objective or Residual(), coordinates=coordinates, **base)
