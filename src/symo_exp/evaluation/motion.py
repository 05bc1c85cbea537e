"""A study of long motions from fixed starts, with or without a sinusoidal input."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from functools import partial

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from symo_exp.checks import MOST, real, whole_number
from symo_exp.data.base import DataModule
from symo_exp.evaluation import measures
from symo_exp.evaluation.rollouts import along, roll_out, state_columns
from symo_exp.evaluation.study import Finding, Remember, afresh
from symo_exp.mechanics.lagrangian import Lagrangian, jacobian
from symo_exp.mechanics.types import Trajectories
from symo_exp.models.base import DynamicsModel
from symo_exp.systems.base import LagrangianSystem, System
from symo_exp.systems.simulation import Solver, simulate


@dataclass(frozen=True, kw_only=True)
class Motion:
    """Motions under the input ``u = amplitude sin(2π t / period)``.

    They are compared with the true motions. Where these are not known, the true energy of unforced
    motions is measured, if it is known; the volume of phase space, if a Lagrangian is known or
    learned. A system without a box gives an empty finding.

    Args:
        name: Prefix of the measures.
        steps: Length of the motions.
        count: Number of motions.
        seed: Seed of their starts, which are drawn from the system's box.
        amplitude: Of every input [N or N m].
        period: Of every input [s].
        truth: Whether true motions are simulated.
    """

    name: str
    steps: int
    count: int = 4
    seed: int = 0
    amplitude: float = 0.0
    period: float = 10.0
    truth: bool = True

    def __post_init__(self) -> None:
        whole_number(f"study.{self.name}.steps", self.steps, high=MOST)
        whole_number(f"study.{self.name}.count", self.count, high=MOST)
        real(f"study.{self.name}.period", self.period, above=0)
        real(f"study.{self.name}.amplitude", self.amplitude)

    @torch.no_grad()
    def __call__(
        self, model: DynamicsModel, system: System, data: DataModule, *, remember: Remember = afresh
    ) -> Finding:
        """Return the finding; ``remember`` keeps true motions between runs."""
        if system.box is None:
            return Finding()
        model = model.for_evaluation()
        nodes = torch.arange(self.steps + 1, dtype=torch.float64) * system.time_step
        u = self._input(nodes, system).expand(self.count, -1, -1)
        if self.truth and isinstance(system, LagrangianSystem):
            found, q, v = self._beside_truth(model, system, remember)
        else:
            found, q, v = self._alone(model, system, u)
        found.columns.update((f"u_{i}", x.flatten()) for i, x in enumerate(u.unbind(-1)))
        lagrangian = model.lagrangian or system.lagrangian
        if lagrangian is not None:
            volume = log_volume(model, lagrangian, q, v, u)
            found.columns["log_volume"] = volume.flatten()
            found.measures["volume"] = volume[:, -1].exp().nanmedian().item()
        return found.named(self.name)

    def _input(self, t: Tensor, system: System) -> Tensor:
        wave = self.amplitude * torch.sin(2 * math.pi * t / self.period)
        return wave.unsqueeze(-1).expand(*wave.shape, system.input_matrix.shape[1])

    def _beside_truth(
        self, model: DynamicsModel, system: LagrangianSystem, remember: Remember
    ) -> tuple[Finding, Tensor, Tensor]:
        motion = roll_out(model, system, self._true(system, remember))
        columns = motion.columns()
        error = motion.errors()[:, 1:]
        energy_error = measures.squared(columns["energy"] - columns["energy_true"])
        values = {
            "energy_mse": energy_error.mean().item(),
            "configuration_mse": measures.mean_squared(error).mean().item(),
            "valid_steps": measures.valid_steps(error).median().item(),
        }
        return Finding(columns, values), motion.q, motion.v

    def _true(self, system: LagrangianSystem, remember: Remember) -> Trajectories:
        """Return true motions, from a step before the first node.

        A variational method needs the configuration before the start of a rollout.
        """
        h, solver = system.time_step, Solver()
        q0, v0, _ = system.points(self.count, self.seed)

        def drive(t: float) -> Tensor:
            time = torch.tensor([t - h], dtype=torch.float64)
            return self._input(time, system).expand(len(q0), -1)

        def make() -> dict[str, np.ndarray]:
            true = simulate(system, q0, v0, drive, self.steps + 1, solver)
            return {name: x.numpy() for name, x in true._asdict().items()}

        recipe = {
            "system": system.identity(), "solver": asdict(solver), "steps": self.steps,
            "start": torch.cat((q0, v0), dim=1).tolist(),
            "amplitude": self.amplitude, "period": self.period,
        }  # fmt: skip
        arrays = remember(f"{type(system).__name__.lower()}-motion", recipe, make)
        return Trajectories(*(torch.from_numpy(arrays[name]) for name in Trajectories._fields))

    def _alone(
        self, model: DynamicsModel, system: System, u: Tensor
    ) -> tuple[Finding, Tensor, Tensor]:
        place, truth = model.input_matrix, system.lagrangian
        q0, v0, _ = system.points(self.count, self.seed)
        path = model.rollout(q0.to(place), v0.to(place), u.to(place))
        q, v = path.q.cpu(), path.v.cpu()
        found = Finding(state_columns(model.coordinates, model.time_step, q=q, v=v))
        if truth is not None and self.amplitude == 0:
            energy = along(truth.energy, q, v)
            initial = truth.energy(q0, v0)[:, None].expand_as(energy)
            found.columns.update(energy=energy.flatten(), energy_true=initial.flatten())
            found.measures["energy_mse"] = measures.squared(energy - initial).mean().item()
        return found, q, v


def log_volume(
    model: DynamicsModel,
    lagrangian: Lagrangian,
    q: Float[Tensor, "trajectories nodes N"],
    v: Float[Tensor, "trajectories nodes n"],
    u: Float[Tensor, "trajectories nodes m"],
) -> Float[Tensor, "trajectories nodes"]:
    """Return ``log det ∂(q_k, p_k)/∂(q_0, p_0)`` along motions of the model.

    ``p = H(q) v`` is the model's. The result is the logarithm of how a small volume around the
    start, an area for one degree of freedom, has grown until node ``k``: the sum over the steps of
    ``log |det|`` of their derivatives.
    """
    ends = (x.to(model.input_matrix) for x in (q[:, :-1], v[:, :-1], u[:, :-1], u[:, 1:]))
    grown = along(partial(_volume_of_step, model), *ends)
    log_mass = torch.logdet(lagrangian.mass_matrix(q.flatten(0, 1))).view(q.shape[:2])
    steps = grown.cpu() + log_mass.diff(dim=1)
    return torch.cat((torch.zeros_like(log_mass[:, :1]), steps.cumsum(1)), dim=1)


def _volume_of_step(
    model: DynamicsModel, q: Tensor, v: Tensor, u: Tensor, u_next: Tensor
) -> Tensor:
    """``log |det ∂(q', v')/∂(q, v)|`` of one step."""
    space = model.coordinates.space
    with torch.enable_grad():
        state = torch.cat((space.origin(q), v), dim=1).requires_grad_()
        place, velocity = state.chunk(2, dim=1)
        step = model.step(space.point(q, place), velocity, u, u_next)
        after = space.chart(step.q.detach(), step.q)
        derivatives = jacobian(torch.cat((after, step.v), dim=1), state)
    return torch.linalg.slogdet(derivatives).logabsdet
