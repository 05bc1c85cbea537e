"""A study of what was learned: energies and inertia along true motions, beside the true ones."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from symo_exp.evaluation import measures
from symo_exp.evaluation.evaluate import along, node_columns
from symo_exp.evaluation.protocols import Model
from symo_exp.evaluation.study import Finding, Remember, afresh, check_size, starts
from symo_exp.systems.base import System
from symo_exp.systems.simulation import Solver, simulate


@dataclass(frozen=True, kw_only=True)
class LearnedQuantities:
    """Kinetic and potential energy and the inertia, learned and true, along unforced true motions.

    A potential is known up to a constant: the learned one is shifted by its mean distance from
    the true one along each motion. A method without a Lagrangian gives nothing.
    """

    name: str
    steps: int
    count: int = 4
    seed: int = 0

    def __post_init__(self) -> None:
        check_size(self.name, self.steps, self.count)

    @torch.no_grad()
    def __call__(self, model: Model, system: System, remember: Remember = afresh) -> Finding:
        model = model.for_evaluation()
        if model.lagrangian is None:
            return Finding()
        q0, v0 = starts(system, self.count, self.seed)
        rest = torch.zeros(self.count, system.input_matrix.shape[1], dtype=torch.float64)
        true = simulate(system, q0, v0, rest, self.steps, Solver())
        found, place = model.lagrangian, model.input_matrix
        q, v = true.q.to(place), true.v.to(place)
        kinetic, kinetic_true = along(found.kinetic, q, v).cpu(), along(system.kinetic, *true[:2])
        potential, potential_true = along(found.potential, q).cpu(), along(system.potential, true.q)
        potential = potential - (potential - potential_true).mean(1, keepdim=True)
        mass, mass_true = along(found.mass_matrix, q).cpu(), along(system.mass_matrix, true.q)
        columns = node_columns(self.count, self.steps + 1, system.time_step)
        columns |= {
            "kinetic": kinetic,
            "kinetic_true": kinetic_true,
            "potential": potential,
            "potential_true": potential_true,
            "total": kinetic + potential,
            "total_true": kinetic_true + potential_true,
        }
        n = mass.shape[-1]
        for i in range(n):
            for j in range(i, n):
                columns[f"inertia_{i + 1}{j + 1}"] = mass[..., i, j]
                columns[f"inertia_{i + 1}{j + 1}_true"] = mass_true[..., i, j]
        pairs = {
            "kinetic_mse": (kinetic, kinetic_true),
            "potential_mse": (potential, potential_true),
            "inertia_mse": (mass, mass_true),
        }
        values = {
            f"{self.name}_{key}": measures.squared_error(learned, truth).mean().item()
            for key, (learned, truth) in pairs.items()
        }
        return Finding({name: x.flatten() for name, x in columns.items()}, values)
