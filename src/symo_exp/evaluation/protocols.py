"""What the evaluation asks of a model and of a dataset; every method and source has the same."""

from __future__ import annotations

from typing import Protocol

from jaxtyping import Bool, Float
from torch import Tensor

from symo_exp.mechanics.lagrangian import Lagrangian
from symo_exp.mechanics.types import Coordinates, Trajectories, Windows


class Prediction(Protocol):
    """One step of a model."""

    @property
    def q(self) -> Float[Tensor, "batch n"]:
        """Pose at the next node."""

    @property
    def v(self) -> Float[Tensor, "batch n"]:
        """Velocity at the next node."""

    @property
    def converged(self) -> Bool[Tensor, " batch"]:
        """Rows whose root was found (all of them for an explicit method)."""


class Path(Protocol):
    """A rollout of a model, its start included."""

    @property
    def q(self) -> Float[Tensor, "batch nodes n"]:
        """Poses."""

    @property
    def v(self) -> Float[Tensor, "batch nodes n"]:
        """Velocities at the same nodes."""

    @property
    def converged(self) -> Bool[Tensor, "batch nodes-1"]:
        """Steps whose root was found."""


class Model(Protocol):
    """A trained model, whatever its method."""

    coordinates: Coordinates
    time_step: float
    input_matrix: Tensor

    @property
    def lagrangian(self) -> Lagrangian | None:
        """The learned Lagrangian, if the method has one."""

    @property
    def reads_velocity(self) -> bool:
        """Whether the state holds a measured velocity; a variational method has momenta instead."""

    def for_evaluation(self) -> Model:
        """A float64 copy whose roots are converged."""

    def initial_velocity(self, windows: Windows) -> Float[Tensor, "batch n"]:
        """The velocity at node ``k`` with which a rollout starts."""

    def predict(self, windows: Windows) -> Prediction:
        """The pose at node ``k + 1``."""

    def step(
        self, q: Tensor, v: Tensor, u: Tensor | None = None, u_next: Tensor | None = None
    ) -> Prediction:
        """One time step from a state, differentiable in it."""

    def rollout(
        self, q0: Tensor, v0: Tensor, u: Tensor | None = None, *, steps: int | None = None
    ) -> Path:
        """Consecutive steps from a state."""


class Data(Protocol):
    """The samples and trajectories a model is judged on."""

    @property
    def train(self) -> Windows:
        """Training samples, as the model saw them."""

    @property
    def test(self) -> Windows:
        """Samples of unseen trajectories."""

    @property
    def integration(self) -> Trajectories:
        """Long unforced trajectories."""
