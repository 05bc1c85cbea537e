"""Measures of a trained model on recordings, beside baselines and references."""

from __future__ import annotations

import itertools
import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from symo_exp.checks import whole_number
from symo_exp.errors import ConfigError
from symo_exp.evaluation.horizon import (
    DOUBLE,
    HORIZONS,
    Predictions,
    cut,
    median,
    noise,
    predict,
    predict_whole,
    tolerance,
    whole_error,
)  # fmt: skip
from symo_exp.evaluation.intervals import coverage, interval_of
from symo_exp.evaluation.references import ConstantVelocity, Continuous, Reference
from symo_exp.evaluation.rollouts import along, by_coordinate
from symo_exp.mechanics.types import Coordinates, Trajectory
from symo_exp.models.base import DynamicsModel
from symo_exp.models.starts import ITERATIONS, RollsOut
from symo_exp.models.uncertainty import Interval

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class RecordedPredictions:
    """Predictions of all windows from fitted starts, by a model and by a reference if given."""

    coordinates: Coordinates
    model: Predictions
    reference: Predictions | None
    interval: Interval | None = None
    dissipation: Float[Tensor, "windows nodes n"] | None = None
    """The generalised force of the learned dissipation along the predictions of the model."""
    names: Sequence[str] = ()
    """Names of the trajectories; without any they are numbered."""

    def columns(self) -> dict[str, np.ndarray]:
        """Return a table with a row for each node of each window.

        Its columns are ``window``, ``trajectory`` (its name), ``start`` [s] (of the window, in
        its trajectory), ``t`` [s] (from there), ``q_<name>``, ``v_<name>`` (predicted),
        ``q_true_<name>``, ``v_true_<name>`` (measured) and ``error`` [rad, m], the root mean
        square over coordinates; of a reference, ``q_reference_<name>`` and ``error_reference``; of
        a model with a posterior ``q_lower_<name>`` and ``q_upper_<name>``, its 90 % interval; of
        one with a learned dissipation ``dissipation_<name>``, its force.
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
        if self.interval is not None:
            fields |= {"q_lower": self.interval.lower, "q_upper": self.interval.upper}
        if self.dissipation is not None:
            fields["dissipation"] = self.dissipation
        table |= by_coordinate(self.coordinates, fields)
        table["error"] = found.distances()
        if self.reference is not None:
            table["error_reference"] = self.reference.distances()
        columns = {name: values[there].numpy() for name, values in table.items()}
        if self.names:
            columns["trajectory"] = np.array(self.names)[columns["trajectory"]]
        return columns


@dataclass(frozen=True, kw_only=True)
class HeldOutErrors:
    """Score of a training on recordings, by rollouts over held-out motions from fitted starts.

    It is that of ``held_out_error``.

    Args:
        iterations: Of the fit of starts (``fitted_start``).
        horizons: Times up to which errors count [s], rising; at most 2 s.
    """

    iterations: int = ITERATIONS
    horizons: Sequence[float] = HORIZONS

    def __post_init__(self) -> None:
        """Refuse settings with which there is no score."""
        whole_number("learner.validation.iterations", self.iterations, low=0)
        times = list(self.horizons)
        numbers = bool(times) and all(isinstance(time, int | float) for time in times)
        rise = numbers and all(a < b for a, b in itertools.pairwise([0.0, *times]))
        if not (rise and times[-1] <= HORIZONS[-1]):
            raise ConfigError(
                f"learner.validation.horizons={times}: expected times that rise, at most "
                f"{HORIZONS[-1]:g} s, such as [0.5,1,2]"
            )

    def __call__(self, model: DynamicsModel, trajectories: Sequence[Trajectory]) -> float:
        """Return the score of a model on held-out trajectories."""
        place, units = model.input_matrix, model.coordinates.sizes
        return held_out_error(model, trajectories, place, units, self.iterations, self.horizons)


def held_out_error(
    model: RollsOut,
    trajectories: Sequence[Trajectory],
    place: Tensor = DOUBLE,
    units: Float[Tensor, " n"] | float = 1.0,
    iterations: int = ITERATIONS,
    horizons: Sequence[float] = HORIZONS,
) -> float:
    """Return the geometric mean of the errors up to horizons [s], infinite without a window.

    ``units`` are those of the coordinates [rad, m]; in units in which all coordinates move by about
    one, none outweighs the others.

    Where there are recordings of 4 s or more, it includes the error over them as a whole
    (``whole_error``), which shows drifts that windows of 2 s do not; not with shorter horizons,
    which are for motions that cannot be predicted longer. ``place`` and ``iterations`` are those of
    ``predict``.
    """
    windows = cut(trajectories, model.time_step, run_in=True, seconds=horizons[-1])
    if windows is None:
        return math.inf
    found = predict(model, windows, place, units, iterations)
    errors = [median(found.rmse(seconds, units)) for seconds in horizons]
    if horizons[-1] >= HORIZONS[-1]:
        whole = whole_error(model, trajectories, place, units)
        errors += [] if whole is None else [whole]
    return math.prod(errors) ** (1 / len(errors))


def on_recordings(
    model: DynamicsModel,
    trajectories: Sequence[Trajectory],
    reference: Reference | None = None,
    names: Sequence[str] = (),
) -> tuple[dict[str, float], RecordedPredictions | None]:
    """Return the measures of recordings (docs/metrics.md) and the predictions of the windows.

    Those of constant velocity and of a reference have prefixes of their own; those of the measured
    start end in ``_measured``.

    Args:
        model: The model, in float64.
        trajectories: The recordings to predict.
        reference: A model to compare with.
        names: Those of the recordings.
    """
    h, place, units = model.time_step, model.input_matrix, model.coordinates.sizes
    who: dict[str, RollsOut] = {
        "": model,
        "constant_velocity_": ConstantVelocity(h, model.coordinates.space),
    }
    if reference is not None:
        who["reference_"] = Continuous(reference, h)
    measures: dict[str, float] = {"windows": 0.0}
    recorded = None
    for suffix, run_in in (("", True), ("_measured", False)):
        windows = cut(trajectories, h, run_in=run_in)
        if windows is None:
            continue
        found = {prefix: predict(one, windows, place, units) for prefix, one in who.items()}
        measures |= _errors(found, suffix)
        if run_in:
            recorded = _recorded(model, found[""], found.get("reference_"), names)
            if recorded.interval is not None:
                measures |= coverage(recorded.model, recorded.interval)
            usable = tolerance(windows, model.coordinates.turning, noise(trajectories))
            for prefix, one in found.items():
                measures[f"{prefix}usable_s"] = median(one.usable_seconds(usable))
    for prefix, one_model in who.items():
        errors = predict_whole(one_model, trajectories, place, units).errors()
        measures[f"{prefix}open_loop_rmse"] = errors.nanmean().sqrt().item()
    measures["noise"] = noise(trajectories).square().mean().sqrt().item()
    if recorded is None:
        log.warning(
            "no windows: the test recordings are too short for one, or nothing moves in them; "
            "there are no errors over 0.5, 1 and 2 s, only open_loop_rmse over whole recordings"
        )
    return measures, recorded


def _errors(found: Mapping[str, Predictions], suffix: str) -> dict[str, float]:
    """Return number and length of the windows, and the errors of each model by its prefix."""
    own = found[""]
    measures = {
        f"windows{suffix}": float(len(own.windows.q)),
        f"window_s{suffix}": median(own.measured_seconds()),
    }
    for prefix, one in found.items():
        measures |= {f"{prefix}{key}{suffix}": x for key, x in one.measures().items()}
    return measures


def _recorded(
    model: DynamicsModel,
    found: Predictions,
    reference: Predictions | None,
    names: Sequence[str],
) -> RecordedPredictions:
    """Return predictions with the interval and the dissipation of the model, where it has them."""
    interval = None
    if model.posterior is not None and not model.coordinates.space.rotations:
        interval = interval_of(model, model.posterior, found)
    return RecordedPredictions(
        model.coordinates, found, reference, interval, _dissipation(model, found), names
    )


def _dissipation(model: DynamicsModel, found: Predictions) -> Tensor | None:
    """Return the force of a learned dissipation, NaN where the prediction is lost."""
    if model.dissipation is None:
        return None
    finite = torch.cat((found.q, found.v), dim=2).isfinite().all(2, keepdim=True)
    states = (x.where(finite, 0.0).to(model.input_matrix) for x in (found.q, found.v))
    with torch.no_grad():
        return along(model.dissipation.force, *states).cpu().where(finite, torch.nan)
