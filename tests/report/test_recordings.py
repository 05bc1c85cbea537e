"""Pictures of recorded motions, for 1, 2 and 3 degrees of freedom."""

import math
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import torch

from symo_exp.evaluation.recordings import on_recordings
from symo_exp.evaluation.references import ConstantVelocity, Continuous
from symo_exp.mechanics.types import Coordinates, Trajectories, Trajectory
from symo_exp.report import recordings
from symo_exp.report.motions import ranking
from symo_exp.report.paper import save_figure

H = 0.02


@pytest.fixture(autouse=True)
def _coarse(monkeypatch):
    monkeypatch.setattr(
        "symo_exp.evaluation.recordings.Continuous", partial(Continuous, substeps=1)
    )


def recorded(n: int, lost: bool = False, **more: object):
    """A model of constant velocity, lost from a time on in windows that begin far out."""

    def rollout(q0, v0, u):
        path = ConstantVelocity(H).rollout(q0, v0, u)
        far = (q0.abs().sum(1) > 0.6 * n)[:, None, None] & (torch.arange(u.shape[1]) > 20)[:, None]
        gone = far.clone()
        gone[:, :40] = False
        if not lost:
            return path
        return Trajectories(*(x.where(~far, 1e300).where(~gone, math.nan) for x in path[:2]), u)

    t = H * torch.arange(200, dtype=torch.float64)[:, None]
    speed = 1.0 + torch.arange(n, dtype=torch.float64)
    q, v = torch.sin(speed * t), speed * torch.cos(speed * t)
    trajectories = [Trajectory(q, v, 0.0 * q), Trajectory(q[:60], v[:60], 0.0 * q[:60])]
    model = SimpleNamespace(
        coordinates=Coordinates(tuple(f"theta_{i + 1}" for i in range(n)), (True,) * n),
        time_step=H, input_matrix=torch.eye(n, dtype=torch.float64), rollout=rollout,
        posterior=None, **({"dissipation": None} | more),
    )  # fmt: skip
    reference = SimpleNamespace(acceleration=lambda q, v, u: -q)
    return model, *on_recordings(model, trajectories, reference)


def rows_of(found):
    return pd.DataFrame(found.columns())


DAMPED = SimpleNamespace(force=lambda q, v: -0.3 * v)


@pytest.mark.parametrize("n", [1, 2, 3])
def test_windows_show_prediction_measurement_and_reference(n):
    model, _, found = recorded(n)
    (figure,) = recordings.recording_figures(model, rows_of(found), "symo", "run")
    assert len(figure.panels) == 3 * (n + 1)
    for panel in figure.panels[: 3 * n]:
        assert {one.source for one in panel.traces()} == {"measured", "ours", "floor"}
    errors = found.model.rmse(2.0)
    chosen = ranking(errors)
    assert errors[chosen["best"]] == errors.min()
    assert errors[chosen["worst"]] == errors.max()


def test_windows_of_a_slow_machine_are_drawn():
    """Of one whose time step is longer than the windows of others."""
    model, _, found = recorded(1)
    table = rows_of(found)
    slow = table.assign(t=table.t * 5.0 / H)
    (figure,), (usual,) = (
        recordings.recording_figures(model, rows, "symo", "run") for rows in (slow, table)
    )
    assert [panel.title for panel in figure.panels] == [panel.title for panel in usual.panels]
    assert f"RMSE {found.model.rmse(2.0).median():.3g}" in figure.panels[1].title


def test_the_title_of_windows_names_the_intervals_that_are_drawn():
    model, _, found = recorded(1)
    table = rows_of(found)
    banded = table.assign(q_lower_theta_1=table.q_theta_1 - 0.1, q_upper_theta_1=table.q_theta_1)
    for rows, there in ((table, False), (banded, True)):
        (figure,) = recordings.recording_figures(model, rows, "symo", "run")
        assert ("90 % intervals" in figure.title) == there
        assert any(one.band for panel in figure.panels for one in panel.traces()) == there


def test_a_dissipation_that_vanished_is_not_drawn():
    model, _, found = recorded(2, dissipation=SimpleNamespace(force=lambda q, v: -1e-160 * v))
    (figure,) = recordings.recording_figures(model, rows_of(found), "symo", "run")
    assert figure.key == "windows"


@pytest.mark.parametrize("n", [1, 2, 3])
def test_a_dissipation_is_drawn_over_velocity_and_time(n):
    model, _, found = recorded(n, dissipation=DAMPED)
    _, figure = recordings.recording_figures(model, rows_of(found), "symo", "run")
    assert len(figure.panels) == 2 * n
    for over_velocity in figure.panels[::2]:
        assert torch.allclose(
            torch.tensor(over_velocity.rows.y.dropna().to_numpy()),
            torch.tensor(-0.3 * over_velocity.rows.x[over_velocity.rows.y.notna()].to_numpy()),
        )


def test_lost_predictions_are_drawn_until_they_are_lost(tmp_path):
    model, measures, found = recorded(2, lost=True, dissipation=DAMPED)
    assert measures["pooled_rmse_2s"] > 1e100
    made = recordings.recording_figures(model, rows_of(found), "node", "lost")
    assert [save_figure(figure, tmp_path).name for figure in made] == [
        "windows.png", "dissipation.png",
    ]  # fmt: skip


def test_the_table_has_no_rows_after_the_end_of_a_trajectory():
    _, measures, found = recorded(2)
    rows = rows_of(found)
    assert np.isfinite(rows.q_true_theta_1).all()
    assert (rows.trajectory == 1).sum() == 60 - 9
    assert rows.window.max() + 1 == measures["windows"]


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (["swing", "push"], "swing, from 1.62 s"),
        (["7", "8"], "trajectory 7, from 1.62 s"),
        (["", ""], "from 0.18 s"),
        (["direct_method_swing_1", "direct_method_swing_10000"], "direct_m…hod_swing_10000, from"),
    ],
)
def test_windows_are_titled_by_the_names_of_the_recordings(names, said):
    model, _, found = recorded(1)
    table = rows_of(replace(found, names=names))
    assert set(table.trajectory) == set(names)
    (figure,) = recordings.recording_figures(model, table, "symo", "run")
    assert any(panel.title.startswith(said) for panel in figure.panels)
