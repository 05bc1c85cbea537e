"""Pictures of a run on recordings: its windows and its learned dissipation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pandas as pd
import torch
from torch import Tensor

from symo_exp.evaluation.horizon import HORIZONS
from symo_exp.evaluation.recordings import RecordedPredictions
from symo_exp.evaluation.rollouts import along
from symo_exp.models.base import DynamicsModel
from symo_exp.report.figures import Figure, Panel
from symo_exp.report.looks import MEASURED, TRUTH, Pair, coordinate_labels, error_unit, symbol
from symo_exp.report.motions import over_time, points, ranked_as, ranking

REFERENCE: Pair = ("reference", "")
Force = Callable[[Tensor, Tensor], Tensor]
"""The generalised force of dissipation at a batch of states."""


def recording_figures(
    model: DynamicsModel, found: RecordedPredictions, method: str, title: str
) -> list[Figure]:
    """Return the windows and, of a model with dissipation, its forces in them."""
    made = [windows_figure(found, method, title)]
    learned = getattr(model, "dissipation", None)
    force: Force | None = learned and learned.force
    if force is not None:
        made.append(dissipation_figure(model, force, found, method, title))
    return [measured_figure(figure) for figure in made]


def windows_figure(found: RecordedPredictions, method: str, title: str) -> Figure:
    """Return the coordinates over time, predicted and measured, with the errors below."""
    table, errors = _table(found), found.model.rmse(HORIZONS[-1])
    chosen = {which: table[table.window == at] for which, at in ranking(errors).items()}
    above, below = [], []
    labels = coordinate_labels(found.coordinates)
    for name, label in zip(found.coordinates.names, labels, strict=True):
        for which, one in chosen.items():
            error = errors[one.window.iloc[0]]
            said = f"{ranked_as(which, errors)}RMSE {error:.2g}"
            panel = over_time({(method, ""): one}, f"q_{name}", f"q_true_{name}", label, said)
            banded = _with_interval(panel, one, name)
            above.append(_beside(banded, one, f"q_reference_{name}"))
    unit = error_unit(found.coordinates.names, found.coordinates.turning).replace("²", "")
    for one in (_with_errors(found, one) for one in chosen.values()):
        said = f"trajectory {one.trajectory.iloc[0]} from {one.start.iloc[0]:.2f} s"
        panel = over_time({(method, ""): one}, "error", None, f"RMS error [{unit}]", said, log=True)
        below.append(_beside(panel, one, "error_reference"))
    said = f"{title}: windows of the recordings"
    return Figure("windows", said, "", above + below, columns=len(chosen))


def dissipation_figure(
    model: DynamicsModel, force: Force, found: RecordedPredictions, method: str, title: str
) -> Figure:
    """Return the generalised force over velocity in all windows, over time in the median one."""
    place, v, pair = model.input_matrix, found.model.v, (method, "")
    numbers = torch.cat((found.model.q, v, found.model.q_true), dim=2)
    finite = numbers.isfinite().all(2, keepdim=True)
    states = (x.where(finite, 0.0).to(place) for x in (found.model.q, v))
    with torch.no_grad():
        values = along(force, *states).cpu().where(finite, torch.nan)
    which, nodes = ranking(found.model.rmse(HORIZONS[-1]))["median"], np.arange(v.shape[1])
    driven, panels = bool(found.model.windows.u.any()), []
    speeds = coordinate_labels(found.coordinates, velocity=True)
    for i, (name, angular) in enumerate(
        zip(found.coordinates.names, found.coordinates.turning, strict=True)
    ):
        unit = ("N m" if angular else "N") if driven else "up to a factor"  # free: no force known
        label = f"F of {symbol(name)} [{unit}]"
        cloud = points(v[..., i].flatten(), values[..., i].flatten(), pair, 10_000)
        line = points(found.model.time_step * nodes, values[which, :, i], pair)
        panels += [
            Panel("all windows", speeds[i], label, cloud, y_log=False, mark="points"),
            Panel("window of median error", "time [s]", label, line, y_log=False, mark="line"),
        ]
    return Figure("dissipation", f"{title}: learned dissipation", "", panels, columns=2)


def measured_figure(figure: Figure) -> Figure:
    """Return a figure of a recorded motion: measured, where others show the truth."""
    panels = [
        replace(
            panel, rows=panel.rows.assign(source=panel.rows.source.replace("truth", "measured")),
            only=panel.only.replace("truth", "measured"),
            title=MEASURED.label if panel.title == TRUTH.label else panel.title,
        )
        for panel in figure.panels
    ]  # fmt: skip
    return replace(figure, panels=panels)


def _with_interval(panel: Panel, table: pd.DataFrame, name: str) -> Panel:
    """Return the panel with the 90 % interval of the prediction, if there is one."""
    if f"q_lower_{name}" not in table:
        return panel
    rows = panel.rows.assign(low=panel.rows.y, high=panel.rows.y)
    own = (rows.source == "ours").to_numpy()
    for column, side in (("low", "lower"), ("high", "upper")):
        rows.loc[own, column] = np.interp(rows.x[own], table.t, table[f"q_{side}_{name}"])
    return replace(panel, rows=rows)


def _beside(panel: Panel, table: pd.DataFrame, column: str) -> Panel:
    """Return the panel with the prediction of a reference, if there is one."""
    if column not in table:
        return panel
    other = points(table.t, table[column], REFERENCE).assign(source="floor")
    return replace(panel, rows=pd.concat([panel.rows, other]))


def _with_errors(found: RecordedPredictions, table: pd.DataFrame) -> pd.DataFrame:
    """Add ``error`` of the predicted nodes and, of a reference, ``error_reference``."""
    names, errors = found.coordinates.names, {}
    for suffix in ("", "_reference"):
        if f"q{suffix}_{names[0]}" in table:
            squares = [(table[f"q{suffix}_{n}"] - table[f"q_true_{n}"]) ** 2 for n in names]
            errors[f"error{suffix}"] = np.sqrt(sum(squares) / len(names))
    return table.assign(**errors)[1:]


def _table(found: RecordedPredictions) -> pd.DataFrame:
    return pd.DataFrame({name: column.numpy() for name, column in found.columns().items()})
