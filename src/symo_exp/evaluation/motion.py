"""A study of motions: some long ones from fixed starts, with or without a sinusoidal input."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

import numpy as np
import torch
from torch import Tensor

from symo_exp.errors import ConfigError
from symo_exp.evaluation import measures
from symo_exp.evaluation.evaluate import Rollouts, along, roll_out
from symo_exp.evaluation.phase_space import log_volume
from symo_exp.evaluation.protocols import Model
from symo_exp.evaluation.study import Finding, Remember, afresh, check_size, starts
from symo_exp.mechanics.types import Trajectories
from symo_exp.systems.base import System
from symo_exp.systems.simulation import Solver, simulate_driven


@dataclass(frozen=True, kw_only=True)
class Motion:
    """``count`` motions of ``steps`` time steps under ``u = amplitude sin(2π t / period)``.

    ``amplitude`` [N or N m] is that of every input, ``period`` in seconds. Starts are drawn by
    ``seed`` from the system's box, the same for every model. Without ``truth`` nothing is
    simulated to compare with: what is left is the energy, and the volume of phase space.
    """

    name: str
    steps: int
    count: int = 4
    seed: int = 0
    amplitude: float = 0.0
    period: float = 10.0
    truth: bool = True

    def __post_init__(self) -> None:
        check_size(self.name, self.steps, self.count)
        if not self.period > 0 or not math.isfinite(self.amplitude):
            raise ConfigError(
                f"study.{self.name}: period={self.period} must be positive, "
                f"amplitude={self.amplitude} finite"
            )

    @torch.no_grad()
    def __call__(self, model: Model, system: System, remember: Remember = afresh) -> Finding:
        model = model.for_evaluation()
        q0, v0 = starts(system, self.count, self.seed)
        nodes = torch.arange(self.steps + 1, dtype=torch.float64) * system.time_step
        u = self._input(nodes, system).expand(self.count, -1, -1)
        if self.truth:
            rollouts = roll_out(model, system, self._true(system, q0, v0, remember))
        else:
            rollouts = self._alone(model, system, q0, v0, u)
        lagrangian = model.lagrangian or system
        volume = log_volume(model, lagrangian, rollouts.q, rollouts.v, u)
        return Finding(self._columns(rollouts, u, volume), self._measures(rollouts, volume))

    def _input(self, t: Tensor, system: System) -> Tensor:
        wave = self.amplitude * torch.sin(2 * math.pi * t / self.period)
        return wave.unsqueeze(-1).expand(*wave.shape, system.input_matrix.shape[1])

    def _true(self, system: System, q0: Tensor, v0: Tensor, remember: Remember) -> Trajectories:
        """The true motions, from a step before the first node: a start needs a pose before it."""
        h, solver = system.time_step, Solver()

        def drive(t: float) -> Tensor:
            time = torch.tensor([t - h], dtype=torch.float64)
            return self._input(time, system).expand(len(q0), -1)

        def make() -> dict[str, np.ndarray]:
            true = simulate_driven(system, q0, v0, drive, self.steps + 1, solver)
            return {name: x.numpy() for name, x in true._asdict().items()}

        recipe = {
            "system": system.identity(), "solver": asdict(solver), "steps": self.steps,
            "start": torch.cat((q0, v0), dim=1).tolist(),
            "amplitude": self.amplitude, "period": self.period,
        }  # fmt: skip
        arrays = remember(f"{type(system).__name__.lower()}-motion", recipe, make)
        return Trajectories(*(torch.from_numpy(arrays[name]) for name in Trajectories._fields))

    def _alone(self, model: Model, system: System, q0: Tensor, v0: Tensor, u: Tensor) -> Rollouts:
        place = model.input_matrix
        path = model.rollout(q0.to(place), v0.to(place), u.to(place))
        energy = along(system.energy, path.q, path.v).cpu()
        unknown = torch.full_like(path.q.cpu(), math.nan)
        return Rollouts(
            coordinates=model.coordinates,
            time_step=model.time_step,
            q=path.q.cpu(),
            v=path.v.cpu(),
            energy=energy,
            q_true=unknown,
            v_true=unknown,
            energy_true=system.energy(q0, v0)[:, None].expand_as(energy),
            converged=path.converged.cpu(),
        )

    def _columns(self, rollouts: Rollouts, u: Tensor, volume: Tensor) -> dict[str, Tensor]:
        table = rollouts.columns(truth=self.truth)
        for i in range(u.shape[-1]):
            table[f"u_{i}"] = u[..., i].flatten()
        table["energy"] = rollouts.energy.flatten()
        table["energy_true"] = rollouts.energy_true.flatten()
        table["log_volume"] = volume.flatten()
        return table

    def _measures(self, rollouts: Rollouts, volume: Tensor) -> dict[str, float]:
        found = {
            "energy_mse": measures.squared_error(rollouts.energy, rollouts.energy_true).mean(),
            "volume": volume[:, -1].exp().nanmedian(),
        }
        if self.truth:
            q, q_true = rollouts.q[:, 1:], rollouts.q_true[:, 1:]
            found["pose_mse"] = measures.rollout_pose_mse(q, q_true).mean()
            found["valid_steps"] = measures.valid_steps(q, q_true).median()
        return {f"{self.name}_{key}": value.item() for key, value in found.items()}
