"""E2E-SyMo: a SyMo trained through its root finding (thesis section 5.2)."""

from typing import Literal

from torch import Tensor

from symo_exp.mechanics.roots import RootFinder
from symo_exp.mechanics.types import Coordinates
from symo_exp.mechanics.variational import VariationalIntegrator
from symo_exp.models.base import DynamicsModel
from symo_exp.models.flows import VariationalFlow
from symo_exp.models.learned import (
    MakesDissipation,
    MakesLagrangian,
    MakesSprings,
    learned_lagrangian,
)
from symo_exp.models.objectives import RootError


class E2ESyMo(DynamicsModel):
    """A learned Lagrangian in a variational integrator, trained on the error of its root.

    The root is the next configuration; it is found and differentiated in training.

    Args:
        lagrangian: Factory of the Lagrangian.
        dissipation: Factory of its dissipation; without one energy is conserved.
        springs: Factory of springs beside it.
        coordinates: Coordinates of the system.
        input_matrix: ``B`` (n, m) of the generalised force ``F = B u``.
        time_step: Time step [s].
        integrator: Variational integrator.
        root: Root finder of steps and of training.
        evaluation_root: That of the copy for evaluation; ``root`` if left out.
        rollout_root: That of rollouts; ``evaluation_root`` if left out.
        guess: Start of the search in training: see ``RootError``.
        fallback: Residual of rows without a root: see ``RootError``.
        evaluation_dtype: Precision of the copy for evaluation.
    """

    def __init__(
        self,
        lagrangian: MakesLagrangian,
        *,
        coordinates: Coordinates,
        input_matrix: Tensor,
        time_step: float,
        integrator: VariationalIntegrator,
        root: RootFinder,
        evaluation_root: RootFinder | None = None,
        rollout_root: RootFinder | None = None,
        dissipation: MakesDissipation | None = None,
        springs: MakesSprings | None = None,
        guess: Literal["datum", "inertial"] = "datum",
        fallback: bool = True,
        evaluation_dtype: Literal["float32", "float64"] = "float64",
    ) -> None:
        flow = VariationalFlow(
            learned_lagrangian(coordinates, lagrangian, dissipation, springs),
            integrator,
            time_step,
            input_matrix,
            root=root,
            evaluation_root=evaluation_root,
            rollout_root=rollout_root,
        )
        super().__init__(
            flow,
            coordinates=coordinates,
            objective=RootError(guess=guess, fallback=fallback),
            evaluation_dtype=evaluation_dtype,
        )
