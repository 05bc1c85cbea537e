"""Pictures of runs exist for every system and outcome and have the content that they state."""

import dataclasses
import math
from types import SimpleNamespace

import pytest
import torch
from PIL import Image

from symo_exp.evaluation.evaluate import Evaluation
from symo_exp.evaluation.rollouts import Rollouts
from symo_exp.report import pictures
from symo_exp.report.animation import animate
from symo_exp.report.looks import TRUTH, look
from symo_exp.systems.chain import ChainPendulum
from tests.report.test_recordings import recorded
from tests.tables import systems

SYSTEMS = systems() | {"chain_3": ChainPendulum(3)}


def made(system, nodes=31, wrong=0.05, count=4) -> Rollouts:
    """Smooth motions, each predicted a little worse than the one before."""
    n = system.coordinates.n
    t = system.time_step * torch.arange(nodes, dtype=torch.float64)[None, :, None]
    w = 1.0 + torch.arange(n, dtype=torch.float64)
    size = 1.0 + torch.arange(count, dtype=torch.float64)[:, None, None]
    q_true, v_true = size * torch.sin(w * t), size * w * torch.cos(w * t)
    off = wrong * size.flip(0) * t
    q, v = q_true + off, v_true + off
    q, q_true = (system.coordinates.space.of_vector(x) for x in (q, q_true))
    energies = [
        system.energy(a.flatten(0, 1), b.flatten(0, 1)).view(count, nodes)
        for a, b in ((q, v), (q_true, v_true))
    ]
    converged = torch.ones(count, nodes - 1, dtype=torch.bool)
    return Rollouts(
        system.coordinates, system.time_step, q, v, energies[0], q_true, v_true, energies[1],
        converged,
    )  # fmt: skip


def knowing(system, lagrangian):
    model = SimpleNamespace(lagrangian=lagrangian, input_matrix=system.input_matrix)
    model.for_evaluation = lambda: model
    return model


KEYS = ["trajectories", "phase_portrait", "energy", "learned"]


@pytest.mark.parametrize("name", SYSTEMS)
def test_every_system_has_its_figures(name):
    system = SYSTEMS[name]
    found = pictures.run_figures(knowing(system, system), system, made(system), "symo", name)
    assert [figure.key for figure in found] == KEYS
    for panel in (panel for figure in found for panel in figure.panels):
        wanted = {panel.only or "truth", panel.only or "ours"}
        if panel.y_label.startswith("squared error"):
            wanted = {"ours"}
        assert {one.source for one in panel.traces()} == wanted


def test_a_prediction_that_is_lost_is_drawn_as_far_as_it_goes(tmp_path):
    system = SYSTEMS["pendulum"]
    rollouts = made(system)
    for field in (rollouts.q, rollouts.v, rollouts.energy):
        field[:, 9:], field[2:, 9:] = math.nan, 1e300
    found = pictures.draw_run(
        knowing(system, None), system, Evaluation({}, rollouts), method="node", title="lost",
        folder=tmp_path,
    )  # fmt: skip
    assert [path.name for path in found] == [*(f"{k}.png" for k in KEYS[:3]), "animation.gif"]
    for path in found:
        with Image.open(path) as image:
            image.verify()


def series(panel):
    return {one.source: one.rows for one in panel.traces()}


def test_quantities_that_a_system_or_run_lacks_are_not_drawn(tmp_path):
    unseen = SYSTEMS["pendulum"]
    unseen = SimpleNamespace(coordinates=unseen.coordinates, skeleton=lambda q: None)
    rollouts = dataclasses.replace(made(SYSTEMS["pendulum"]), energy=None)
    found = pictures.draw_run(
        knowing(SYSTEMS["pendulum"], None), unseen, Evaluation({}, rollouts), method="node",
        title="t", folder=tmp_path,
    )  # fmt: skip
    assert [path.name for path in found] == ["trajectories.png", "phase_portrait.png"]


def test_recordings_have_pictures_of_their_own(tmp_path):
    model, measures, found = recorded(1, for_evaluation=lambda: model, lagrangian=None)
    unseen = SimpleNamespace(coordinates=model.coordinates, skeleton=lambda q: None)
    rollouts = dataclasses.replace(made(SYSTEMS["pendulum"]), energy=None)
    drawn = pictures.draw_run(
        model, unseen, Evaluation(measures, rollouts, found), method="node", title="t",
        folder=tmp_path,
    )  # fmt: skip
    assert [path.stem for path in drawn] == ["trajectories", "phase_portrait", "windows"]


def test_a_potential_is_compared_up_to_its_constant_and_nothing_else_is_aligned():
    system = SYSTEMS["cartpole"]

    class Lifted(type(system)):
        def potential(self, q):
            return super().potential(q) + 7.0

        def mass_matrix(self, q):
            return 1.5 * super().mass_matrix(q)

    lifted = Lifted.__new__(Lifted)
    vars(lifted).update(vars(system))
    panels = pictures.learned_quantities(
        knowing(system, lifted), system, made(system), "symo", "lifted"
    ).panels
    for panel, factor in zip(panels[:2], (1.5, 1.0), strict=True):
        rows = series(panel)
        assert list(rows["ours"].y) == pytest.approx(list(factor * rows["truth"].y))
    assert [p.y_label for p in panels[:2]] == ["kinetic energy [J]", "potential energy [J]"]
    assert [p.title for p in panels[3:]] == ["inertia H11", "inertia H12", "inertia H22"]


def test_rollouts_are_ranked_by_error_and_a_lost_one_comes_last():
    rollouts = made(SYSTEMS["cartpole"])  # each motion is larger than the one before

    def drawn():
        panels = pictures.trajectories(rollouts, "symo", "t").panels[:3]
        return [round(series(panel)["truth"].y.max()) - 1 for panel in panels]

    assert drawn() == [3, 2, 0]
    rollouts.q[3, 20:] = math.nan
    assert drawn() == [2, 1, 3]


def test_axes_carry_units():
    figure = pictures.trajectories(made(SYSTEMS["cartpole"]), "symo", "t")
    labels = {p.y_label for p in figure.panels}
    assert labels == {"x [m]", "θ [rad]", "squared error [m², rad²]"}
    assert {p.x_label for p in figure.panels} == {"time [s]"}
    assert figure.title == "t: rollouts of 1.5 s (30 steps of 0.05 s)"


def test_axes_of_rotations_are_angles_body_rates_and_moments_of_inertia():
    system = SYSTEMS["quadrotor"]
    figures = pictures.run_figures(knowing(system, system), system, made(system), "symo", "t")
    labels = [{label for p in f.panels for label in (p.x_label, p.y_label)} for f in figures]
    turns = {f"{word} of R [rad]" for word in ("roll", "pitch", "yaw")}
    assert turns < labels[0]
    assert turns | {f"ω_{axis} of R [rad/s]" for axis in "xyz"} < labels[1]
    assert {"H11 [kg]", "H15 [kg m]", "H66 [kg m²]"} < labels[3]


def test_angles_of_rotations_have_gaps_where_they_jump():
    rollouts = made(SYSTEMS["rigid_body"])
    turning = torch.linspace(3.0, 3.3, 31).double()[:, None] * torch.eye(3)[2].double()
    for q in (rollouts.q, rollouts.q_true):
        q[:] = SYSTEMS["rigid_body"].coordinates.space.of_vector(turning)
    yaw = [p for p in pictures.trajectories(rollouts, "symo", "t").panels if "yaw" in p.y_label]
    assert len(yaw) == 3
    for panel in yaw:
        for one in series(panel).values():
            assert one.y.isna().sum() == 1


def test_a_runaway_does_not_hide_the_truth():
    figure = pictures.trajectories(made(SYSTEMS["pendulum"], wrong=1e6), "symo", "t")
    for panel in (panel for panel in figure.panels if not panel.y_log):
        (low, high), true = panel.limits(), series(panel)["truth"].y
        assert low < true.min() < true.max() < high
        assert high - low < 5 * max(true.max() - true.min(), abs(true).max())


def test_a_prediction_that_is_lost_is_not_painted_over_the_others():
    rollouts = made(SYSTEMS["pendulum"], wrong=0.0)
    rollouts.v[0, 12] = 1e3  # the others are as they are
    rollouts.q[0, 12:] = torch.linspace(0, 1e4, 19)[:, None]
    for figure in (pictures.trajectories, pictures.phase_portrait):
        for panel in figure(rollouts, "symo", "t").panels:
            assert series(panel).get("ours", series(panel).get("truth")).y.max() < 5
    worst = pictures.trajectories(rollouts, "symo", "t").panels[2]
    assert worst.title.endswith("lost at 1.2 s")
    assert "e+" not in worst.title
    rollouts.q[0, 12:] = torch.inf
    worst = pictures.trajectories(rollouts, "symo", "t").panels[2]
    assert "MSE diverged, lost" in worst.title
    assert series(worst)["ours"].y.notna().sum() == 12


def test_angles_that_turn_over_are_wrapped_and_others_are_not():
    rollouts = made(SYSTEMS["cartpole"])
    rollouts.q_true[:, :, 1] += torch.linspace(0, 10, 31)
    rollouts.q[:, :, :] = rollouts.q_true
    rollouts.q[:, :, 0] += 7
    panels = pictures.trajectories(rollouts, "symo", "t").panels
    of = {p.y_label: series(p)["ours"].y for p in panels}
    assert of["θ [rad]"].abs().max() <= math.pi
    assert of["θ [rad]"].isna().any()
    assert of["x [m]"].max() > 7
    assert of["squared error [m², rad²]"].notna().all()


def test_no_line_joins_the_ends_of_a_turn_where_nodes_are_left_out():
    rollouts = dataclasses.replace(made(SYSTEMS["pendulum"], nodes=4001), time_step=0.0025)
    rollouts.q_true[:] = torch.linspace(0, 50, 4001)[:, None]
    rollouts.q[:], rollouts.v[:] = rollouts.q_true, rollouts.v_true
    panel = pictures.trajectories(rollouts, "symo", "t").panels[0]
    for one in series(panel).values():
        assert len(one) < 2000
        assert one.y.diff().abs().max() < math.pi
        assert one.y.isna().sum() == 8


def test_a_phase_portrait_wraps_angles_and_has_gaps_where_they_jump():
    system = SYSTEMS["pendulum"]
    for panel in pictures.phase_portrait(made(system), "symo", "t").panels:
        rows = panel.rows.dropna(subset="y")
        assert rows.x.abs().max() <= math.pi
        joined = panel.rows.y.notna()[:-1].to_numpy()
        assert abs(panel.rows.x.diff()[1:][joined]).max() < math.pi


@pytest.mark.parametrize("speed", [2.9, -2.9, 0.3])
def test_wrapped_lines_have_all_nodes_and_go_on_to_the_edges(speed):
    """Also of fast motions, of which an angle jumps after every second or third node."""
    nodes = 41
    rollouts = dataclasses.replace(made(SYSTEMS["pendulum"], nodes), time_step=0.1)
    rollouts.q_true[:] = speed * torch.arange(nodes, dtype=torch.float64)[:, None]
    rollouts.v_true[:] = speed
    rollouts.q[:], rollouts.v[:] = rollouts.q_true, rollouts.v_true
    over_time = pictures.trajectories(rollouts, "symo", "t").panels[0]
    portrait = pictures.phase_portrait(rollouts, "symo", "t").panels[0]
    turns = int(abs(speed) * (nodes - 1) / (2 * math.pi) + 0.5)
    for panel, count in ((over_time, 1), (portrait, 4)):
        for rows in series(panel).values():
            angle = rows.y if panel is over_time else rows.x
            assert angle.notna().sum() == count * (nodes + 2 * turns)
            assert (angle.abs() == math.pi).sum() == count * 2 * turns
            if panel is over_time:  # the line is straight between the gaps
                slope = rows.y.diff() / rows.x.diff()
                assert (slope.dropna() - 10 * speed).abs().max() < 1e-6


def test_the_animation_plays_in_real_time(tmp_path):
    system = SYSTEMS["acrobot"]
    path = animate(system, made(system, nodes=21), 0, (look("node"), TRUTH), "t", tmp_path)
    with Image.open(path) as image:
        assert image.n_frames == 21
        assert image.info["duration"] == 50
