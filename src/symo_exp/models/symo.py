"""SyMo: a symplectic-momentum network (thesis section 5.1)."""

from typing import Literal

from torch import Tensor

from symo_exp.checks import one_of
from symo_exp.errors import ConfigError
from symo_exp.mechanics.roots import RootFinder
from symo_exp.mechanics.types import Coordinates
from symo_exp.mechanics.variational import VariationalIntegrator
from symo_exp.models.base import DynamicsModel
from symo_exp.models.flows import VariationalFlow
from symo_exp.models.horizon import HorizonError
from symo_exp.models.learned import (
    MakesDissipation,
    MakesLagrangian,
    MakesSprings,
    learned_lagrangian,
)
from symo_exp.models.objectives import Objective, Residual
from symo_exp.nets.inputs import LearnedInputs


class SyMo(DynamicsModel):
    """A learned Lagrangian in a variational integrator.

    It is trained on the residual of the discrete Euler-Lagrange equations at the data, and finds
    roots only to predict.

    Args:
        lagrangian: Factory of the Lagrangian.
        dissipation: Factory of its dissipation; without one energy is conserved.
        springs: Factory of springs beside it.
        coordinates: Coordinates of the system.
        input_matrix: ``B`` (n, m) of the generalised force ``F = B u``.
        inputs: Whether ``B`` is as given or learned, near the given one.
        time_step: Time step [s].
        integrator: Variational integrator.
        root: Root finder of steps.
        evaluation_root: That of the copy for evaluation; ``root`` if left out.
        rollout_root: That of rollouts; ``evaluation_root`` if left out.
        objective: Residuals to be minimised, of a variational flow.
        evaluation_dtype: Precision of the copy for evaluation.

    Raises:
        ConfigError: If the objective is the error of predictions.
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
        inputs: Literal["given", "learned"] = "given",
        objective: Objective | None = None,
        evaluation_dtype: Literal["float32", "float64"] = "float64",
    ) -> None:
        if isinstance(objective, HorizonError):
            raise ConfigError(
                "objective=horizon: SyMo is trained without predictions; with the error of "
                "predictions it is E2E-SyMo by definition: choose model=e2e_symo"
            )
        one_of("model.inputs", inputs, ("given", "learned"))
        flow = VariationalFlow(
            learned_lagrangian(coordinates, lagrangian, dissipation, springs),
            integrator,
            time_step,
            input_matrix if inputs == "given" else LearnedInputs(input_matrix, coordinates),
            root=root,
            evaluation_root=evaluation_root,
            rollout_root=rollout_root,
        )
        super().__init__(
            flow,
            coordinates=coordinates,
            objective=objective or Residual(),
            evaluation_dtype=evaluation_dtype,
        )
