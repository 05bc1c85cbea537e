"""A study that compares learned and true energies and inertia along true motions."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from symo_exp.checks import MOST, whole_number
from symo_exp.data.base import DataModule
from symo_exp.evaluation import measures
from symo_exp.evaluation.rollouts import along, state_columns
from symo_exp.evaluation.study import Finding, Remember, afresh
from symo_exp.models.base import DynamicsModel
from symo_exp.systems.base import LagrangianSystem, System
from symo_exp.systems.simulation import Solver, simulate


@dataclass(frozen=True, kw_only=True)
class LearnedQuantities:
    """Kinetic and potential energy and the inertia, learned and true, along unforced true motions.

    A potential is known up to a constant: the learned one is shifted by its mean distance from
    the true one along each motion. Without a learned or a true Lagrangian the finding is empty.

    Args:
        name: Prefix of the measures.
        steps: Length of the motions.
        count: Number of motions.
        seed: Seed of their starts.
    """

    name: str
    steps: int
    count: int = 4
    seed: int = 0

    def __post_init__(self) -> None:
        whole_number(f"study.{self.name}.steps", self.steps, high=MOST)
        whole_number(f"study.{self.name}.count", self.count, high=MOST)

    @torch.no_grad()
    def __call__(
        self, model: DynamicsModel, system: System, data: DataModule, *, remember: Remember = afresh
    ) -> Finding:
        """Return the finding; ``remember`` keeps true motions between runs."""
        model = model.for_evaluation()
        if model.lagrangian is None or not isinstance(system, LagrangianSystem):
            return Finding()
        q0, v0, u = system.points(self.count, self.seed)
        q, v, _ = simulate(system, q0, v0, torch.zeros_like(u), self.steps, Solver())
        return beside_true(model, system, q, v).named(self.name)


@torch.no_grad()
def beside_true(
    model: DynamicsModel,
    system: LagrangianSystem,
    q_true: Float[Tensor, "trajectories nodes n"],
    v_true: Float[Tensor, "trajectories nodes n"],
) -> Finding:
    """Return learned and true quantities at every node of true motions.

    Each potential is shifted by its mean distance from the true one along the motion.
    """
    found = model.lagrangian
    assert found is not None
    q, v = q_true.to(model.input_matrix), v_true.to(model.input_matrix)
    potential_true = along(system.potential, q_true)
    potential = along(found.potential, q).cpu()
    potential -= (potential - potential_true).mean(1, keepdim=True)
    pairs = {
        "kinetic": (along(found.kinetic, q, v).cpu(), along(system.kinetic, q_true, v_true)),
        "potential": (potential, potential_true),
        "inertia": (along(found.mass_matrix, q).cpu(), along(system.mass_matrix, q_true)),
    }
    values = {
        f"{key}_mse": measures.squared(learned - true).mean().item()
        for key, (learned, true) in pairs.items()
    }
    mass = pairs.pop("inertia")
    pairs["total"] = tuple(a + b for a, b in zip(*pairs.values(), strict=True))
    n = system.coordinates.n
    for i, j in torch.triu_indices(n, n).T.tolist():
        pairs[f"inertia_{i + 1}{j + 1}"] = mass[0][..., i, j], mass[1][..., i, j]
    columns = state_columns(system.coordinates, system.time_step, q=q_true, v=v_true)
    for key, (learned, true) in pairs.items():
        columns |= {key: learned.flatten(), f"{key}_true": true.flatten()}
    return Finding(columns, values)
