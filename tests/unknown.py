"""A machine of which only recordings are known."""

from dataclasses import dataclass

import torch

from symo_exp.mechanics.types import Coordinates
from symo_exp.systems.base import System


@dataclass(frozen=True, kw_only=True)
class Unknown(System):
    """The coordinates and inputs of a chain of two, and nothing else."""

    coordinates = Coordinates(("theta_1", "theta_2"), (True, True))
    input_matrix = torch.tensor([[1.0, -1.0], [0.0, 1.0]], dtype=torch.float64)
