"""Pictures of a run on recordings: its windows and its learned dissipation.

Their data are the table of windows, with a row for each node (``RecordedPredictions.columns``).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pandas as pd
import torch

from symo_exp.evaluation.parameters import ABSENT
from symo_exp.models.base import DynamicsModel
from symo_exp.report.figures import Figure, Panel
from symo_exp.report.looks import (
    MEASURED,
    TRUTH,
    Pair,
    coordinate_labels,
    short,
    symbol,
)  # fmt: skip
from symo_exp.report.motions import over_time, points, ranked_as, ranking

REFERENCE: Pair = ("reference", "")
LONGEST_NAME = 24
"""Characters of the name of a recording that fit above a panel."""


def recording_figures(
    model: DynamicsModel, table: pd.DataFrame, method: str, title: str, key: str = ""
) -> list[Figure]:
    """Return the windows and, of a model that has found dissipation, its forces in them.

    Args:
        model: The model that predicts.
        table: The windows.
        method: The name of the method, which determines the look.
        title: The name of the run.
        key: Prefix of the names of the files.
    """
    made = [windows_figure(model, table, method, title)]
    forces = table.filter(regex="^dissipation_").abs().max().max()  # NaN without a dissipation
    if forces > ABSENT * model.coordinates.units.size("N m"):
        made.append(dissipation_figure(model, table, method, title))
    return [replace(measured_figure(figure), key=f"{key}{figure.key}") for figure in made]


def windows_figure(model: DynamicsModel, table: pd.DataFrame, method: str, title: str) -> Figure:
    """Return the coordinates over time, predicted and measured, with the errors below."""
    errors, chosen = _ranked(table)
    known = model.coordinates
    above, below = [], []
    for name, label in zip(known.names, coordinate_labels(known), strict=True):
        for which, one in chosen.items():
            error = errors[one.window.iloc[0]]
            said = f"{ranked_as(which, len(errors))}RMSE {short(error)}"
            panel = over_time({(method, ""): one}, f"q_{name}", f"q_true_{name}", label, said)
            banded = _with_interval(panel, one, name)
            above.append(_beside(banded, one, f"q_reference_{name}"))
    unit = ", ".join(known.units_of_errors)
    for one in (window[1:] for window in chosen.values()):
        name = str(one.trajectory.iloc[0])  # none if it is alone
        name = f"trajectory {name}" if name.isdecimal() else name
        if len(name) > LONGEST_NAME:  # names of files differ at their ends
            name = f"{name[:8]}…{name[9 - LONGEST_NAME :]}"
        said = f"{name}, " * bool(name) + f"from {one.start.iloc[0]:.2f} s"
        panel = over_time({(method, ""): one}, "error", None, f"RMS error [{unit}]", said, log=True)
        below.append(_beside(panel, one, "error_reference"))
    intervals = ", with 90 % intervals" * any(str(c).startswith("q_lower_") for c in table)
    said = f"{title}: windows of the recordings{intervals}"
    return Figure("windows", said, "", above + below, columns=len(chosen))


def dissipation_figure(
    model: DynamicsModel, table: pd.DataFrame, method: str, title: str
) -> Figure:
    """Return the generalised force over velocity in all windows, over time in the median one."""
    known, pair, median = model.coordinates, (method, ""), _ranked(table)[1]["median"]
    driven, panels = model.input_matrix.shape[1] > 0, []
    speeds = coordinate_labels(known, velocity=True)
    for name, angular, speed in zip(known.names, known.turning, speeds, strict=True):
        unit = ("N m" if angular else "N") if driven else "up to a factor"  # free: no force known
        label = f"F of {symbol(name)} [{unit}]"
        cloud = points(table[f"v_{name}"], table[f"dissipation_{name}"], pair, 10_000)
        line = points(median.t, median[f"dissipation_{name}"], pair)
        panels += [
            Panel("all windows", speed, label, cloud, y_log=False, mark="points"),
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


def _ranked(table: pd.DataFrame) -> tuple[pd.Series, Mapping[str, pd.DataFrame]]:
    """Return the RMSE of each window, and the windows of best, median and worst RMSE."""
    squares = table[table.t > 0].groupby("window").error
    errors = squares.apply(lambda error: float(np.sqrt(np.mean(np.square(error)))))
    order = ranking(torch.tensor(errors.to_numpy()))
    chosen = {which: table[table.window == errors.index[at]] for which, at in order.items()}
    return errors, chosen
