"""The pictures of a run: there for every system and outcome, and showing what they say."""

import math
import subprocess
import sys
from types import SimpleNamespace

import pytest
import torch
from PIL import Image

from symo_exp.evaluation.evaluate import Rollouts
from symo_exp.report import pictures
from symo_exp.report.style import METHODS, TRUE, look, symbol
from tests.chain import ChainPendulum
from tests.models.methods import learned
from tests.tables import choices, systems

SYSTEMS = systems() | {"chain_3": ChainPendulum(3)}
STYLE = look("symo")


def made(system, nodes=61, wrong=0.05, count=4) -> Rollouts:
    """Smooth motions, each predicted a little worse than the one before."""
    n = system.coordinates.n
    t = system.time_step * torch.arange(nodes, dtype=torch.float64)[None, :, None]
    w = 1.0 + torch.arange(n, dtype=torch.float64)
    size = 1.0 + torch.arange(count, dtype=torch.float64)[:, None, None]
    q_true, v_true = size * torch.sin(w * t), size * w * torch.cos(w * t)
    off = wrong * size.flip(0) * t
    q, v = q_true + off, v_true + off
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


NAMES = ["trajectories.png", "energy.png", "phase_portrait.png", "learned.png", "animation.gif"]


@pytest.mark.parametrize("name", SYSTEMS)
def test_every_system_has_its_pictures(name, tmp_path):
    system = SYSTEMS[name]
    found = pictures.draw_run(
        knowing(system, system), system, made(system), method="symo", title=name, folder=tmp_path
    )
    assert [path.name for path in found] == NAMES
    for path in found:
        with Image.open(path) as image:
            image.verify()


@pytest.mark.parametrize("lost", [math.nan, math.inf, 1e300, 1e12])
def test_a_prediction_that_is_lost_is_drawn_as_far_as_it_goes(lost, tmp_path):
    system = SYSTEMS["cartpole"]
    rollouts = made(system)
    for field in (rollouts.q, rollouts.v, rollouts.energy):
        field[:, 9:] = lost
    found = pictures.draw_run(
        knowing(system, None), system, rollouts, method="node", title="lost", folder=tmp_path
    )
    assert [path.name for path in found] == [name for name in NAMES if name != "learned.png"]


def lines(axes):
    return [line.get_ydata() for line in axes.get_lines()]


def test_a_potential_is_compared_up_to_its_constant_and_nothing_else_is_aligned():
    system = SYSTEMS["cartpole"]

    class Lifted(type(system)):
        def potential(self, q):
            return super().potential(q) + 7.0

        def mass_matrix(self, q):
            return 1.5 * super().mass_matrix(q)

    lifted = Lifted.__new__(Lifted)
    vars(lifted).update(vars(system))
    figure = pictures.learned_quantities(
        knowing(system, lifted), system, made(system), STYLE, "lifted"
    )
    shown = {axes.get_title(loc="left").split(" ")[0]: axes for axes in figure.axes}
    true, learned = lines(shown["potential"])
    assert learned == pytest.approx(true)
    assert "shifted by -7 J" in shown["potential"].get_title(loc="left")
    true, learned = lines(shown["kinetic"])
    assert learned == pytest.approx(1.5 * true)
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    assert titles[-3:] == [
        "inertia $H_{11}$ [kg]", "inertia $H_{12}$ [kg m]", "inertia $H_{22}$ [kg m²]",
    ]  # fmt: skip


def test_rollouts_are_ranked_by_error_and_a_lost_one_comes_last():
    rollouts = made(SYSTEMS["pendulum"])
    assert pictures.ranking(rollouts) == [3, 2, 1, 0]
    assert pictures.median(rollouts) == 2
    rollouts.q[3, 40:] = math.nan
    assert pictures.ranking(rollouts) == [2, 1, 0, 3]


def test_axes_carry_units():
    figure = pictures.trajectories(made(SYSTEMS["cartpole"]), STYLE, "t")
    labels = {axes.get_ylabel() for axes in figure.axes} | {
        axes.get_xlabel() for axes in figure.axes
    }
    assert {"$x$ [m]", r"$\theta$ [rad]", "time [s]"} <= labels


def test_a_runaway_does_not_hide_the_truth():
    rollouts = made(SYSTEMS["pendulum"], wrong=1e6)
    for axes in pictures.trajectories(rollouts, STYLE, "t").axes:
        low, high = axes.get_ylim()
        true = lines(axes)[0]
        assert low < true.min() < true.max() < high
        assert high - low < 5 * max(true.max() - true.min(), abs(true).max())


def test_wrapped_angles_leave_gaps():
    x, y = pictures._wrapped(torch.linspace(0, 7, 50).numpy(), torch.arange(50.0).numpy())
    inside = x[~torch.isnan(torch.tensor(x)).numpy()]
    assert len(x) == len(y) == 51
    assert inside.min() > -math.pi
    assert inside.max() <= math.pi


def test_the_animation_is_small_and_plays_in_real_time(tmp_path):
    system = SYSTEMS["acrobot"]
    rollouts = made(system, nodes=502)
    pictures.draw_run(
        knowing(system, None), system, rollouts, method="node", title="t", folder=tmp_path
    )
    path = tmp_path / "animation.gif"
    assert path.stat().st_size < 2_000_000
    with Image.open(path) as image:
        assert image.n_frames == 241
        assert image.info["duration"] == 50


def test_every_method_has_a_colour_of_its_own():
    assert set(METHODS) == set(learned())
    assert set(METHODS) | set(TRUE) == set(choices("model"))
    assert len({style.colour for style in METHODS.values()}) == len(METHODS)
    assert look("a_new_method").label == "a_new_method"


def test_names_become_symbols():
    assert symbol("theta") == r"$\theta$"
    assert symbol("theta_1") == symbol("theta1") == r"$\theta_{1}$"
    assert symbol("x", dotted=True) == r"$\dot{x}$"
    assert symbol("tilt") == "tilt"


def test_figures_touch_no_global_state():
    code = "import sys, symo_exp.report.pictures; assert 'matplotlib.pyplot' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)
