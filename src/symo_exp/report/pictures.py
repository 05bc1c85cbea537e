"""Pictures of one run: predictions and learned quantities beside the truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from torch import Tensor

from symo_exp.evaluation.evaluate import Evaluation
from symo_exp.evaluation.learned import beside_true
from symo_exp.evaluation.measures import mean_squared
from symo_exp.evaluation.rollouts import Rollouts
from symo_exp.models.base import DynamicsModel
from symo_exp.report import recordings
from symo_exp.report.animation import animate
from symo_exp.report.figures import Figure, Panel
from symo_exp.report.looks import MEASURED, TRUTH, coordinate_labels, look, short
from symo_exp.report.motions import (
    LONG,
    kept,
    learned_figure,
    over_time,
    phase_rows,
    points,
    ranked_as,
    ranking,
    wrapped_lines,
)  # fmt: skip
from symo_exp.report.paper import save_figure
from symo_exp.systems.base import LagrangianSystem, System
from symo_exp.systems.recorded import Recorded
from symo_exp.words import counted

LEARNED_SECONDS = 10.0
"""Length [s] of the motion along which learned quantities are drawn, as in the thesis."""
DRAWN = 1e-16, 1e30
"""Limits of values on a logarithmic axis."""


def draw_run(
    model: DynamicsModel,
    system: System,
    found: Evaluation,
    *,
    method: str,
    title: str,
    folder: Path,
) -> list[Path]:
    """Write all pictures of a run; there is an animation of systems with a skeleton.

    Args:
        model: The trained model.
        system: The system.
        found: Its evaluation.
        method: The name of the method, which determines the look.
        title: The name of the run.
        folder: Where the files are written.

    Returns:
        The files.
    """
    rollouts, measured = found.rollouts, isinstance(system, Recorded)
    made = run_figures(model, system, rollouts, method, title)
    if measured:
        made = [recordings.measured_figure(figure) for figure in made]
    if found.recorded is not None:
        table = pd.DataFrame(found.recorded.columns())
        made += recordings.recording_figures(model, table, method, title)
    paths = [save_figure(figure, folder) for figure in made]
    if system.skeleton(rollouts.q_true[0, 0]) is not None:
        which = ranking(_errors(rollouts))["median"]
        looks = look(method), MEASURED if measured else TRUTH
        paths.append(animate(system, rollouts, which, looks, title, folder))
    return paths


def run_figures(
    model: DynamicsModel, system: System, rollouts: Rollouts, method: str, title: str
) -> list[Figure]:
    """Return the figures of a run, of energies and a learned Lagrangian only where there are."""
    made = [trajectories(rollouts, method, title), phase_portrait(rollouts, method, title)]
    if rollouts.energy is not None:
        made.append(energy_figure(rollouts, method, title))
    if model.lagrangian is not None and isinstance(system, LagrangianSystem):
        made.append(learned_quantities(model, system, rollouts, method, title))
    return made


def trajectories(rollouts: Rollouts, method: str, title: str) -> Figure:
    """Return the coordinates over time for the best, the median and the worst rollout.

    They show the first seconds, the errors below all of the rollout. Angles are wrapped where the
    truth turns over; those of rotations always are.
    """
    errors, table, pair = _errors(rollouts), _table(rollouts), (method, "")
    chosen = {which: table[table.trajectory == at] for which, at in ranking(errors).items()}
    panels, flat = [], len(rollouts.coordinates.flat)
    labels = zip(_labels(rollouts), rollouts.coordinates.turning, strict=True)
    for at, ((name, label), angular) in enumerate(labels):
        columns = f"q_{name}", f"q_true_{name}"
        for which, one in chosen.items():
            turns = angular and (flat <= at or np.ptp(one[columns[1]]) > 2 * np.pi)
            said = (
                ranked_as(which, len(errors))
                + f"MSE {short(float(errors[one.trajectory.iloc[0]]))}"
            )
            shown = over_time({pair: one[one.t <= LONG]}, *columns, label, said + _until(one))
            panels.append(wrapped_lines(shown) if turns else shown)
    unit = ", ".join(f"{unit}²" for unit in rollouts.coordinates.units_of_errors)
    label = f"squared error [{unit}]"
    for one in chosen.values():
        panels.append(over_time({pair: one}, "squared_error", None, label, log=True))
    said = f"{title}: rollouts of {_horizon(rollouts)}"
    return Figure("trajectories", said, "", panels, columns=len(chosen))


def phase_portrait(rollouts: Rollouts, method: str, title: str) -> Figure:
    """Return all rollouts in the phase plane of each coordinate, truth beside prediction.

    Angles are wrapped to (−π, π].
    """
    table, angular = _table(rollouts), rollouts.coordinates.turning
    rates = coordinate_labels(rollouts.coordinates, velocity=True)
    panels = [
        Panel(TRUTH.label if only == "truth" else look(method).label, label, rate,
              phase_rows((method, ""), table, name, wrap=wrap), y_log=False, mark="line", only=only)
        for (name, label), rate, wrap in zip(_labels(rollouts), rates, angular, strict=True)
        for only in ("truth", "ours")
    ]  # fmt: skip
    said = f"{title}: phase portrait of {_horizon(rollouts)}"
    return Figure("phase_portrait", said, "", panels, columns=2)


def energy_figure(rollouts: Rollouts, method: str, title: str) -> Figure:
    """Return the true energy of the predicted states, and its difference from the initial one."""
    assert rollouts.energy is not None
    assert rollouts.energy_true is not None
    initial, pair = rollouts.energy_true[:, :1], (method, "")
    table = _table(rollouts)
    table = table[table.trajectory == ranking(_errors(rollouts))["median"]]
    above = over_time({pair: table}, "energy", "energy_true", "E [J]", "rollout of median error")
    lost = (rollouts.energy - initial).abs().nan_to_num(nan=float("inf")).clamp(*DRAWN).numpy()
    drift = (rollouts.energy_true - initial).abs().clamp(*DRAWN).numpy()
    ours = points(table.t, np.median(lost, 0), pair, len(table))
    ours = ours.assign(low=lost.min(0), high=lost.max(0))
    both = pd.concat([points(table.t, np.median(drift, 0), None, len(table))[1:], ours[1:]])
    below = Panel("all rollouts: median and range", "time [s]", "|E − E₀| [J]", both, mark="line")
    said = f"{title}: energy of the states predicted over {_horizon(rollouts)}"
    return Figure("energy", said, "", [above, below])


def learned_quantities(
    model: DynamicsModel, system: LagrangianSystem, rollouts: Rollouts, method: str, title: str
) -> Figure:
    """Return learned and true energies and inertia along a true motion."""
    nodes = 1 + round(LEARNED_SECONDS / rollouts.time_step)
    which = ranking(_errors(rollouts))["median"]
    q, v = rollouts.q_true[which, :nodes], rollouts.v_true[which, :nodes]
    found = beside_true(model.for_evaluation(), system, q[None], v[None]).columns
    table = pd.DataFrame({name: column.numpy() for name, column in found.items()})
    said = f"{title}: learned quantities along a true motion"
    return learned_figure("learned", said, {(method, ""): table}, system.coordinates.turning)


def _errors(rollouts: Rollouts) -> Tensor:
    """Return the mean squared error of each trajectory, infinite for a lost one."""
    return mean_squared(rollouts.errors()[:, 1:])


def _table(rollouts: Rollouts) -> pd.DataFrame:
    """Return all motions, a row for each node, with predictions only until they are lost."""
    columns = {name: column.numpy() for name, column in rollouts.columns().items()}
    return kept(pd.DataFrame(columns))


def _until(one: pd.DataFrame) -> str:
    """Return when the prediction of a motion is lost, if it is."""
    gone = one[one.filter(like="q_").isna().any(axis=1)]
    return "" if gone.empty else f", lost at {gone.t.iloc[0]:.1f} s"


def _horizon(rollouts: Rollouts) -> str:
    steps, step = rollouts.q.shape[1] - 1, rollouts.time_step
    return f"{steps * step:g} s ({counted(steps, 'step')} of {step:g} s)"


def _labels(rollouts: Rollouts) -> list[tuple[str, str]]:
    coordinates = rollouts.coordinates
    return list(zip(coordinates.names, coordinate_labels(coordinates), strict=True))
