"""NODE: a neural ordinary differential equation of second order (thesis section 4.3.1)."""

from typing import Any

from torch import Tensor

from symo_exp.mechanics.types import Coordinates
from symo_exp.models.base import ExplicitModel
from symo_exp.models.fields import NetworkAcceleration
from symo_exp.models.learner import Learner
from symo_exp.models.objectives import StateError


class NODE(ExplicitModel, Learner):
    """``v̇ = MLP(s(q), v, u)``, no mechanics; trained on the error of the next state."""

    def __init__(
        self,
        *,
        coordinates: Coordinates,
        input_matrix: Tensor,
        width: int,
        depth: int = 2,
        **base: Any,
    ) -> None:
        field = NetworkAcceleration(
            angular=coordinates.angular, input_matrix=input_matrix, width=width, depth=depth
        )
        super().__init__(field, StateError(), coordinates=coordinates, **base)
