"""What the evaluation asks of a model and of a dataset, whatever the method and the source."""

from __future__ import annotations

from typing import Literal, Protocol

from jaxtyping import Float
from torch import Tensor

from symo_exp.mechanics.lagrangian import Lagrangian
from symo_exp.mechanics.types import Coordinates, Trajectories, Trajectory, Windows


class States(Protocol):
    """Predicted states: of the next node (batch, n), or of a rollout, start included."""

    @property
    def q(self) -> Tensor: ...
    @property
    def v(self) -> Tensor: ...
    @property
    def converged(self) -> Tensor:
        """Whether the root of each step was found; always so for an explicit method."""


class Model(Protocol):
    """A trained model, whatever its method."""

    coordinates: Coordinates
    time_step: float

    @property
    def input_matrix(self) -> Tensor:
        """``B`` of the generalised force ``B u``."""

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

    def predict(self, windows: Windows) -> States:
        """The state at node ``k + 1``."""

    def step(
        self, q: Tensor, v: Tensor, u: Tensor | None = None, u_next: Tensor | None = None
    ) -> States:
        """One time step from a state, differentiable in it."""

    def rollout(
        self, q0: Tensor, v0: Tensor, u: Tensor | None = None, *, steps: int | None = None
    ) -> States:
        """Consecutive steps from a state."""


class Data(Protocol):
    """Training samples as the model saw them, samples of unseen trajectories, long trajectories."""

    @property
    def recorded(self) -> bool:
        """Whether somebody measured these motions."""

    def trajectories(self, part: Literal["train", "held_out", "val", "test"]) -> list[Trajectory]:
        """Whole trajectories, of any lengths."""

    @property
    def train(self) -> Windows: ...
    @property
    def test(self) -> Windows: ...
    @property
    def integration(self) -> Trajectories: ...
