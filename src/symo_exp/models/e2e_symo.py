"""E2E-SyMo: a SyMo trained through its root finding (thesis section 5.2)."""

from typing import Any, Literal

from symo_exp.mechanics.types import Coordinates
from symo_exp.models.base import VariationalModel
from symo_exp.models.learned import MakesDissipation, Structure, learned_lagrangian
from symo_exp.models.learner import Learner
from symo_exp.models.objectives import RootError


class E2ESyMo(VariationalModel, Learner):
    """A learned Lagrangian in a variational integrator, trained on the error of the root: that of
    the next configuration."""

    def __init__(
        self,
        *,
        coordinates: Coordinates,
        guess: Literal["datum", "inertial"] = "datum",
        fallback: bool = True,
        width: int,
        depth: int = 2,
        initial_inertia: float | None = 1.0,
        harmonics: int = 0,
        structure: Structure = "network",
        dissipation: MakesDissipation | None = None,
        **base: Any,
    ) -> None:
        """``guess`` and ``fallback`` are those of ``RootError``."""
        lagrangian = learned_lagrangian(
            coordinates,
            width=width,
            depth=depth,
            initial_inertia=initial_inertia,
            harmonics=harmonics,
            structure=structure,
            dissipation=dissipation,
        )
        objective = RootError(guess=guess, fallback=fallback)
        super().__init__(lagrangian, objective, coordinates=coordinates, **base)
