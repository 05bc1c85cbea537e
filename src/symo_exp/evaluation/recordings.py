"""Recorded motions: a trained model over their windows, beside what it is held to."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from symo_exp.evaluation.horizon import HORIZONS, Predictions, cut, median, predict
from symo_exp.evaluation.references import ConstantVelocity, Continuous, Reference
from symo_exp.evaluation.starts import RollsOut
from symo_exp.mechanics.types import Coordinates, Trajectory
from symo_exp.models.base import DynamicsModel


@dataclass(frozen=True)
class Recorded:
    """What a model and, where there is one, a reference made of all windows, from fitted starts."""

    coordinates: Coordinates
    model: Predictions
    reference: Predictions | None

    def columns(self) -> dict[str, Tensor]:
        """A row for each node of each window: ``window``, ``trajectory``, ``start`` [s] (of the
        window, in its trajectory), ``t`` [s] (from there), ``q_<name>``, ``v_<name>`` (predicted),
        ``q_true_<name>``, ``v_true_<name>`` (measured) and, of a reference, ``q_reference_<name>``.
        """
        found = self.model
        count, nodes = found.q.shape[:2]
        there = found.q_true.isfinite().all(2)
        start = found.windows.first * found.time_step
        table = {
            "window": torch.arange(count)[:, None].expand(-1, nodes),
            "trajectory": found.windows.trajectory[:, None].expand(-1, nodes),
            "start": start[:, None].expand(-1, nodes),
            "t": (found.time_step * torch.arange(nodes).double()).expand(count, -1),
        }
        fields = {"q": found.q, "v": found.v, "q_true": found.q_true, "v_true": found.v_true}
        if self.reference is not None:
            fields["q_reference"] = self.reference.q
        for field, values in fields.items():
            for i, name in enumerate(self.coordinates.names):
                table[f"{field}_{name}"] = values[..., i]
        return {name: values[there] for name, values in table.items()}


@dataclass(frozen=True, kw_only=True)
class HeldOutErrors:
    """What a training on recordings is judged by: the geometric mean of the errors ``rmse_<T>s``
    [rad, m] of a model's rollouts over held-out motions, from fitted starts.

    Infinite where no motion has a window.
    """

    def __call__(self, model: DynamicsModel, trajectories: Sequence[Trajectory]) -> float:
        windows = cut(trajectories, model.time_step, run_in=True)
        if windows is None:
            return math.inf
        found = predict(model, windows, model.time_step, model.input_matrix)
        errors = [median(found.rmse(seconds)) for seconds in HORIZONS]
        return math.prod(errors) ** (1 / len(errors))


def on_recordings(
    model: DynamicsModel, trajectories: Sequence[Trajectory], reference: Reference | None = None
) -> tuple[dict[str, float], Recorded | None]:
    """The measures of ``horizon`` for a model in float64, for constant velocity, and for a
    reference, with prefixes of their own; those of the measured start end in ``_measured``.

    ``windows`` are how many. There is nothing where no trajectory has a window.
    """
    h, place = model.time_step, model.input_matrix
    who: dict[str, RollsOut] = {"": model, "constant_velocity_": ConstantVelocity(h)}
    if reference is not None:
        who["reference_"] = Continuous(reference, h)
    measures: dict[str, float] = {}
    recorded = None
    for suffix, run_in in (("", True), ("_measured", False)):
        windows = cut(trajectories, h, run_in=run_in)
        if windows is None:
            continue
        found = {prefix: predict(one, windows, h, place) for prefix, one in who.items()}
        measures[f"windows{suffix}"] = float(len(windows.q))
        for prefix, one in found.items():
            measures |= {f"{prefix}{key}{suffix}": x for key, x in one.measures().items()}
        if run_in:
            recorded = Recorded(model.coordinates, found[""], found.get("reference_"))
    return measures, recorded
