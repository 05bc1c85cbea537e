"""Measures of every run: one-step errors, long rollouts, energy and inertia, a function each.

Measures that need the true Lagrangian are absent where the system has none. A measure of a user is
a study (``evaluation.study``).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import torch

from symo_exp.data.base import DataModule
from symo_exp.evaluation import measures
from symo_exp.evaluation.recordings import RecordedPredictions, on_recordings
from symo_exp.evaluation.references import Reference
from symo_exp.evaluation.rollouts import CHUNK, Rollouts, along, roll_out
from symo_exp.mechanics.dissipation import DissipativeLagrangian
from symo_exp.mechanics.lagrangian import Lagrangian
from symo_exp.mechanics.types import Windows
from symo_exp.mechanics.windows import cut_windows
from symo_exp.models.base import DynamicsModel
from symo_exp.systems.base import System

SHORT = 100
"""Steps of a short rollout, which a model can follow even where the motion is chaotic."""


class Case(NamedTuple):
    """A model for evaluation and its rollouts along ``data.integration``."""

    model: DynamicsModel
    truth: Lagrangian | None
    data: DataModule
    rollouts: Rollouts


@dataclass(frozen=True)
class Evaluation:
    """Measures of a run, and the predictions that they were computed from.

    Attributes:
        measures: Values by name (docs/metrics.md).
        rollouts: Long rollouts.
        recorded: Windows of recordings, ``None`` for simulated data.
    """

    measures: dict[str, float]
    rollouts: Rollouts
    recorded: RecordedPredictions | None = None


@torch.no_grad()
def evaluate(
    model: DynamicsModel, system: System, data: DataModule, reference: Reference | None = None
) -> Evaluation:
    """Return the measures of a trained model.

    By default they are computed in float64 with converged roots, so that they do not depend on
    tolerances of the training (``preset=thesis``: in float32 with tolerances of the thesis).
    Divergence gives infinite measures.

    Args:
        model: The trained model.
        system: The system, whose true Lagrangian is used where it is known.
        data: Its data; recordings are also predicted in windows (``horizon``).
        reference: A model to compare with on recordings.
    """
    model = model.for_evaluation()
    rollouts = roll_out(model, system.lagrangian, data.integration)
    case = Case(model, system.lagrangian, data, rollouts)
    turning = model.coordinates.turning
    found = {"coordinates": float(len(turning)), "angles": float(sum(turning))}
    for measure in (one_step, rollout, energy, inertia):
        found |= measure(case)
    if not data.recorded:
        return Evaluation(found, rollouts)
    test = data.trajectories("test")
    errors, recorded = on_recordings(model, test, reference, data.test_names)
    return Evaluation(found | errors, rollouts, recorded)


def one_step(case: Case) -> dict[str, float]:
    """Return errors of the next configuration and state, and the fraction of roots not found."""
    # in float64, unlike the samples for training, whose rounding is an error of its own
    samples, unseen = (cut_windows(case.data.trajectories(part)) for part in ("train", "test"))
    train, _, _ = _one_step(case.model, samples)
    test, state, failed = _one_step(case.model, unseen)
    step = case.model.coordinates.space.difference(unseen.q, unseen.q_next)
    moved = step.square().mean().item()
    found = {"train_mse": train, "test_mse": test, "test_mse_state": state}
    found["test_relative"] = math.sqrt(test / moved) if moved > 0 else math.inf
    return found if case.model.reads_velocity else found | {"test_newton_failed": failed}


def rollout(case: Case) -> dict[str, float]:
    """Return errors along the rollouts, means over the predicted nodes."""
    motion = case.rollouts
    error = motion.errors()[:, 1:]
    configuration = measures.mean_squared(error)
    velocity = measures.mean_squared(motion.v[:, 1:] - motion.v_true[:, 1:])
    first = measures.mean_squared(error[:, :SHORT])
    diverged = ~error.isfinite().all(-1).all(-1)
    found = measures.mean_and_std("integration", configuration) | {
        f"integration_mse_{SHORT}": first.mean().item(),
        "valid_steps": measures.valid_steps(error).median().item(),
        "integration_mse_state": (0.5 * (configuration + velocity)).mean().item(),
        "integration_diverged": diverged.double().mean().item(),
    }
    if not case.model.reads_velocity:
        found["integration_newton_failed"] = 1.0 - motion.converged.double().mean().item()
    return found


def energy(case: Case) -> dict[str, float]:
    """Return errors of the true energy along the rollouts.

    Expected is the energy of the start, or with friction that of the true motion. Driven rollouts
    have none.
    """
    motion = case.rollouts
    driven = case.data.integration.u.any()
    if case.truth is None or motion.energy is None or motion.energy_true is None or driven:
        return {}
    expected = motion.energy_true[:, 1:]
    if not isinstance(case.truth, DissipativeLagrangian):
        expected = motion.energy_true[:, :1].expand_as(expected)
    found = measures.mean_and_std("energy", measures.mean_squared(motion.energy[:, 1:] - expected))
    if not case.model.reads_velocity:
        space = motion.coordinates.space
        q = motion.q[:, 1:]
        # the thesis pairs this with q, though it is the velocity of half a step earlier
        v = space.difference(motion.q[:, :-1], q) / motion.time_step
        values = along(case.truth.energy, q, v)
        found["energy_mse_fd"] = measures.mean_squared(values - expected).mean().item()
    return found


def inertia(case: Case) -> dict[str, float]:
    """Return errors of the learned inertia, along the predicted and the true motion."""
    if case.model.lagrangian is None or case.truth is None:
        return {}
    learned, place = case.model.lagrangian.mass_matrix, case.model.input_matrix.device
    q, q_true = (x[:, 1:] for x in (case.rollouts.q, case.rollouts.q_true))
    true = along(case.truth.mass_matrix, q_true)
    predicted, aligned = (along(learned, x.to(place)).cpu() for x in (q, q_true))
    error = measures.mean_squared(aligned - true).mean().item()
    return measures.mean_and_std("inertia", measures.mean_squared(predicted - true)) | {
        "inertia_mse_aligned": error
    }


def _one_step(model: DynamicsModel, samples: Windows) -> tuple[float, float, float]:
    """Errors of configuration and state, and the fraction of samples whose root was not found."""
    samples = Windows(*(field.to(model.input_matrix) for field in samples))
    parts = [
        model.predict(samples.rows(slice(start, start + CHUNK)))
        for start in range(0, len(samples.q), CHUNK)
    ]
    failed = 1.0 - torch.cat([part.converged for part in parts]).double().mean().item()
    q_next = torch.cat([part.q for part in parts])
    v_next = torch.cat([part.v for part in parts])
    off = model.coordinates.space.difference(samples.q_next, q_next)
    q = measures.squared(off).mean().item()
    v = measures.squared(v_next - samples.v_next).mean().item()
    return q, 0.5 * (q + v), failed
