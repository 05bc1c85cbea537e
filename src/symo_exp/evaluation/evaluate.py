"""One evaluation for every method: one-step errors, long rollouts, energy, inertia."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from symo_exp.evaluation import measures
from symo_exp.evaluation.protocols import Data, Model
from symo_exp.mechanics.lagrangian import Lagrangian
from symo_exp.mechanics.types import Coordinates, Trajectories, Windows

CHUNK = 1024
"""Rows evaluated at once: more cost memory and, beyond the cache, time."""

SHORT = 100
"""Steps over which a rollout is measured as well: a chaotic motion is lost in the long one."""


@dataclass(frozen=True)
class Rollouts:
    """Predicted and true motions from the same starts, in float64 on the CPU.

    Node 0 is the start. Its pose is the true one; its velocity is the model's own, which differs
    from the true one where the model does not read velocities.
    """

    coordinates: Coordinates
    time_step: float
    q: Float[Tensor, "trajectories nodes n"]
    v: Float[Tensor, "trajectories nodes n"]
    energy: Float[Tensor, "trajectories nodes"]
    """The true system's energy [J] of the predicted states."""
    q_true: Float[Tensor, "trajectories nodes n"]
    v_true: Float[Tensor, "trajectories nodes n"]
    energy_true: Float[Tensor, "trajectories nodes"]
    converged: Bool[Tensor, "trajectories steps"]

    def columns(self, *, truth: bool = True) -> dict[str, Tensor]:
        """A table with a row for each node: ``trajectory, step, t`` [s], then for each coordinate
        ``q_<name>``, ``v_<name>`` and, with ``truth``, ``q_true_<name>``, ``v_true_<name>``."""
        table = node_columns(self.q.shape[0], self.q.shape[1], self.time_step)
        fields = {"q": self.q, "v": self.v}
        if truth:
            fields |= {"q_true": self.q_true, "v_true": self.v_true}
        for field, values in fields.items():
            for i, name in enumerate(self.coordinates.names):
                table[f"{field}_{name}"] = values[..., i].flatten()
        return table


def node_columns(trajectories: int, nodes: int, time_step: float) -> dict[str, Tensor]:
    """Which trajectory and step a node is of, and its time [s], trajectory by trajectory."""
    step = torch.arange(nodes).repeat(trajectories)
    return {
        "trajectory": torch.arange(trajectories).repeat_interleave(nodes),
        "step": step,
        "t": step.double() * time_step,
    }


@dataclass(frozen=True)
class Evaluation:
    """The measures by name (docs/metrics.md) and the rollouts behind them."""

    measures: dict[str, float]
    rollouts: Rollouts


@torch.no_grad()
def evaluate(model: Model, system: Lagrangian, data: Data) -> Evaluation:
    """Measure a trained model against the true ``system``.

    In float64 with converged roots, whatever the model was trained with, so that the measures
    tell the learned model and not the tolerance. Divergence gives infinite measures.
    """
    model = model.for_evaluation()
    results: dict[str, float] = {}
    results["train_mse"], _, _ = _one_step(model, data.train)
    results["test_mse"], results["test_mse_state"], failed = _one_step(model, data.test)
    if not model.reads_velocity:
        results["test_newton_failed"] = failed

    rollouts = roll_out(model, system, data.integration)
    unforced = not data.integration.u.any()
    results |= _rollout_measures(model, system, rollouts, unforced)
    return Evaluation(results, rollouts)


def _one_step(model: Model, samples: Windows) -> tuple[float, float, float]:
    """Errors of pose and of state, and the fraction of samples whose root was not found."""
    samples = Windows(*(field.to(model.input_matrix) for field in samples))
    predicted, velocity, converged = [], [], []
    for start in range(0, len(samples.q), CHUNK):
        step = model.predict(Windows(*(field[start : start + CHUNK] for field in samples)))
        predicted.append(step.q)
        velocity.append(step.v)
        converged.append(step.converged)
    failed = 1.0 - torch.cat(converged).double().mean().item()
    pose = measures.pose_mse(torch.cat(predicted), samples.q_next).item()
    speed = measures.pose_mse(torch.cat(velocity), samples.v_next).item()
    return pose, 0.5 * (pose + speed), failed


@torch.no_grad()
def roll_out(model: Model, system: Lagrangian, true: Trajectories) -> Rollouts:
    """All trajectories at once from their node 1, the first that has a predecessor."""
    true = Trajectories(*(field.to(model.input_matrix) for field in true))
    path = model.rollout(true.q[:, 1], model.initial_velocity(_first_window(true)), true.u[:, 1:])
    q_true, v_true = true.q[:, 1:], true.v[:, 1:]
    return Rollouts(
        coordinates=model.coordinates,
        time_step=model.time_step,
        q=path.q.cpu(),
        v=path.v.cpu(),
        energy=along(system.energy, path.q, path.v).cpu(),
        q_true=q_true.cpu(),
        v_true=v_true.cpu(),
        energy_true=along(system.energy, q_true, v_true).cpu(),
        converged=path.converged.cpu(),
    )


def _rollout_measures(
    model: Model, system: Lagrangian, motion: Rollouts, unforced: bool
) -> dict[str, float]:
    """Means over the predicted nodes, the start left out, of every trajectory."""
    q, q_true = motion.q[:, 1:], motion.q_true[:, 1:]
    initial = motion.energy_true[:, 0]
    results: dict[str, float] = {}

    def record(name: str, per_trajectory: Tensor) -> None:
        results[f"{name}_mse"], results[f"{name}_std"] = measures.mean_and_std(per_trajectory)

    pose = measures.rollout_pose_mse(q, q_true)
    record("integration", pose)
    first = measures.rollout_pose_mse(q[:, :SHORT], q_true[:, :SHORT])
    results[f"integration_mse_{SHORT}"] = first.mean().item()
    results["valid_steps"] = measures.valid_steps(q, q_true).median().item()
    speed = measures.rollout_pose_mse(motion.v[:, 1:], motion.v_true[:, 1:])
    results["integration_mse_state"] = (0.5 * (pose + speed)).mean().item()
    if unforced:  # else there is nothing to conserve
        record("energy", measures.rollout_energy_mse(motion.energy[:, 1:], initial))
    diverged = ~torch.isfinite(q).all(-1).all(-1)
    results["integration_diverged"] = diverged.double().mean().item()
    if not model.reads_velocity:
        results["integration_newton_failed"] = 1.0 - motion.converged.double().mean().item()
    if not model.reads_velocity and unforced:
        v = measures.finite_difference_velocity(motion.q, motion.time_step)
        energy = along(system.energy, q, v)
        results["energy_mse_fd"] = measures.rollout_energy_mse(energy, initial).mean().item()
    if model.lagrangian is not None:
        learned, true = model.lagrangian.mass_matrix, along(system.mass_matrix, q_true)
        device = model.input_matrix.device
        record("inertia", measures.rollout_inertia_mse(along(learned, q.to(device)).cpu(), true))
        aligned = along(learned, q_true.to(device)).cpu()
        results["inertia_mse_aligned"] = measures.rollout_inertia_mse(aligned, true).mean().item()
    return results


def _first_window(trajectories: Trajectories) -> Windows:
    """The sample at nodes 0, 1, 2 of every trajectory."""
    q, v, u = trajectories
    return Windows(
        q_prev=q[:, 0], q=q[:, 1], q_next=q[:, 2], v=v[:, 1], v_next=v[:, 2],
        u_prev=u[:, 0], u=u[:, 1], u_next=u[:, 2],
    )  # fmt: skip


def along(function: Callable[..., Tensor], *paths: Float[Tensor, "b t n"]) -> Tensor:
    """A function of batched states at every node of every trajectory."""
    batch, nodes = paths[0].shape[:2]
    rows = [torch.split(path.flatten(0, 1), CHUNK) for path in paths]
    values = torch.cat([function(*chunk) for chunk in zip(*rows, strict=True)])
    return values.reshape(batch, nodes, *values.shape[1:])
