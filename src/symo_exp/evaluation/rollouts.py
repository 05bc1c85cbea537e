"""Rollouts of a model beside true trajectories."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from symo_exp.mechanics.lagrangian import Lagrangian
from symo_exp.mechanics.types import Coordinates, Trajectories
from symo_exp.mechanics.windows import cut_windows
from symo_exp.models.base import DynamicsModel

CHUNK = 1024
"""Rows evaluated at once; more need more memory and, beyond the cache, more time."""


@dataclass(frozen=True)
class Rollouts:
    """Predicted and true motions from the same starts, in float64 on the CPU.

    Node 0 is the start. Its configuration is the true one; its velocity is the model's own, which
    differs from the true one where the model does not read velocities. The energy [J] of the
    predicted and of the true states is the true system's, ``None`` where that is unknown.
    """

    coordinates: Coordinates
    time_step: float
    q: Float[Tensor, "trajectories nodes N"]
    v: Float[Tensor, "trajectories nodes n"]
    energy: Float[Tensor, "trajectories nodes"] | None
    q_true: Float[Tensor, "trajectories nodes N"]
    v_true: Float[Tensor, "trajectories nodes n"]
    energy_true: Float[Tensor, "trajectories nodes"] | None
    converged: Bool[Tensor, "trajectories steps"]

    def errors(self) -> Float[Tensor, "trajectories nodes n"]:
        """Return the errors of the configurations."""
        return self.coordinates.space.difference(self.q_true, self.q)

    def columns(self) -> dict[str, Tensor]:
        """Return a table with a row for each node.

        Its columns are those of ``state_columns`` with ``q``, ``v``, ``q_true``, ``v_true``, then
        ``squared_error`` (of ``errors``, the mean over coordinates), ``energy``, ``energy_true``
        [J] where known, and ``converged`` (whether the step that led to this node found its root).
        """
        table = state_columns(
            self.coordinates, self.time_step,
            q=self.q, v=self.v, q_true=self.q_true, v_true=self.v_true,
        )  # fmt: skip
        table["squared_error"] = self.errors().square().mean(2).flatten()
        for name, energy in {"energy": self.energy, "energy_true": self.energy_true}.items():
            if energy is not None:
                table[name] = energy.flatten()
        start = torch.ones_like(self.converged[:, :1])
        return table | {"converged": torch.cat((start, self.converged), dim=1).flatten()}


def state_columns(
    coordinates: Coordinates, time_step: float, **fields: Float[Tensor, "trajectories nodes n"]
) -> dict[str, Tensor]:
    """Return ``trajectory``, ``step``, ``t`` [s] and ``<field>_<coordinate>`` for each node."""
    trajectories, nodes, _ = next(iter(fields.values())).shape
    step = torch.arange(nodes).repeat(trajectories)
    named = by_coordinate(coordinates, fields)
    return {
        "trajectory": torch.arange(trajectories).repeat_interleave(nodes),
        "step": step,
        "t": step.double() * time_step,
    } | {name: column.flatten() for name, column in named.items()}


def by_coordinate(
    coordinates: Coordinates, fields: Mapping[str, Float[Tensor, "trajectories nodes n"]]
) -> dict[str, Float[Tensor, "trajectories nodes"]]:
    """Return ``<field>_<coordinate>`` for each field; rotations as roll, pitch and yaw [rad]."""
    table: dict[str, Tensor] = {}
    for field, x in fields.items():
        shown = coordinates.space.shown(x) if x.shape[-1] > coordinates.n else x
        table |= {f"{field}_{name}": shown[..., i] for i, name in enumerate(coordinates.names)}
    return table


@torch.no_grad()
def roll_out(model: DynamicsModel, truth: Lagrangian | None, true: Trajectories) -> Rollouts:
    """Return rollouts from node 1, the first with a predecessor, of all trajectories."""
    true = Trajectories(*(field.to(model.input_matrix) for field in true))
    v0 = model.initial_velocity(cut_windows(Trajectories(*(x[:, :3] for x in true)).each()))
    lost = ~v0.isfinite().all(1)
    path = model.rollout(true.q[:, 1], v0.masked_fill(lost[:, None], 0.0), true.u[:, 1:])
    if lost.any():  # no velocity was found to start with
        path.q[lost, 1:], path.v[lost], path.converged[lost] = torch.nan, torch.nan, False
    q_true, v_true = true.q[:, 1:], true.v[:, 1:]
    return Rollouts(
        coordinates=model.coordinates,
        time_step=model.time_step,
        q=path.q.cpu(),
        v=path.v.cpu(),
        energy=None if truth is None else along(truth.energy, path.q, path.v).cpu(),
        q_true=q_true.cpu(),
        v_true=v_true.cpu(),
        energy_true=None if truth is None else along(truth.energy, q_true, v_true).cpu(),
        converged=path.converged.cpu(),
    )


def along(function: Callable[..., Tensor], *paths: Float[Tensor, "b t n"]) -> Tensor:
    """Return a function of batched states at every node of every trajectory."""
    batch, nodes = paths[0].shape[:2]
    rows = [torch.split(path.flatten(0, 1), CHUNK) for path in paths]
    values = torch.cat([function(*chunk) for chunk in zip(*rows, strict=True)])
    return values.reshape(batch, nodes, *values.shape[1:])
