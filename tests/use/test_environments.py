"""The Gymnasium environment: its contract, its motion and its pictures."""

from __future__ import annotations

import sys
import warnings

import gymnasium
import numpy as np
import pygame
import pytest
import torch
from gymnasium.utils.env_checker import check_env

from symo_exp.errors import ConfigError
from symo_exp.systems.simulation import Solver, simulate
from symo_exp.systems.table import systems
from symo_exp.use.environments import Environment, environment
from tests.systems import models
from tests.systems.every import SYSTEMS

ids = pytest.mark.parametrize("name", [kind.__name__ for kind in systems().values()])
every_system = pytest.mark.parametrize("name", SYSTEMS)


@pytest.mark.parametrize("name", models.SHIPPED)
def test_environments_of_mujoco_models_pass_the_checker(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    system = models.read(models.SHIPPED[name])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        check_env(environment(system, render_mode="rgb_array"))


@ids
def test_environments_pass_the_checker_of_gymnasium(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")  # the checker opens windows
    env = gymnasium.make(f"symo_exp/{name}-v0", disable_env_checker=True)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # unbounded observations, unnormalised torques
        check_env(env.unwrapped)
    assert env.spec is not None
    assert env.spec.max_episode_steps == 500
    assert type(env.unwrapped.system).__name__ == name


@every_system
def test_stepping_is_simulating(name: str) -> None:
    system = SYSTEMS[name]
    env = Environment(system, solver=Solver("RK45", rtol=1e-10, atol=1e-11))
    n = system.coordinates.width
    observation, _ = env.reset(seed=3)
    env.action_space.seed(3)
    controls = np.stack([env.action_space.sample() for _ in range(3)])
    observations = [observation]
    for control in controls[:-1]:
        observation, reward, *_ = env.step(control)
        observations.append(observation)
    start, u = (torch.from_numpy(x).unsqueeze(0) for x in (observations[0], controls))
    tight = Solver("DOP853", rtol=1e-12, atol=1e-13)
    exact = simulate(system, start[:, :n], start[:, n:], u, 2, tight)
    expected = torch.cat([exact.q[0], exact.v[0]], 1).numpy()
    np.testing.assert_allclose(np.stack(observations), expected, rtol=1e-7, atol=1e-7)
    assert np.abs(np.diff(expected, axis=0)).max() > 1e-2
    assert reward == pytest.approx(float(system.potential(exact.q[:, -1])), rel=1e-6)


def test_resets_are_drawn_from_the_box_and_seeded() -> None:
    system = SYSTEMS["cartpole"]
    env = Environment(system)
    starts = np.stack([env.reset(seed=seed)[0] for seed in range(200)])
    box = np.array([*system.box.q, *system.box.v])
    assert ((starts >= box[:, 0]) & (starts <= box[:, 1])).all()
    covered = (starts.max(0) - starts.min(0)) / (box[:, 1] - box[:, 0])
    assert (covered > 0.9).all()
    np.testing.assert_array_equal(env.reset(seed=5)[0], starts[5])


def test_reset_to_an_exact_state() -> None:
    env = Environment(SYSTEMS["acrobot"])
    state, _ = env.reset(options={"q": [0.1, -7.0], "v": [2.0, 3.0]})
    np.testing.assert_array_equal(state, [0.1, -7.0, 2.0, 3.0])
    state[:] = 0.0  # the caller's copy
    assert env.step(np.zeros(1))[0][1] < -6
    names = "expected a dictionary with any of q, v"
    for wrong, wanted in [
        ({"q": [0.1]}, r"q=\[0\.1\]: expected 2 finite"),
        ({"v": [0.0, np.nan]}, "v=.*nan.*: expected 2 finite"),
        ({"q": "a"}, "q=a: expected 2 finite"),
        ({"q": [1j, 0.0]}, "q=.*: expected 2 finite"),
        ({"q": [[0.0], [0.0, 1.0]]}, "q=.*: expected 2 finite"),
        ({"theta": 1.0}, f"theta.*: {names}"),
        ("q", names),
        (3, names),
    ]:
        with pytest.raises(ConfigError, match=wanted):
            env.reset(options=wrong)


def test_actions_are_clipped_to_the_range_of_the_data() -> None:
    env = Environment(SYSTEMS["pendulum"])
    ends = []
    for torque in (2.0, 50.0):
        env.reset(options={"q": [0.3], "v": [0.0]})
        ends.append(env.step(np.array([torque]))[0])
    np.testing.assert_array_equal(ends[0], ends[1])


@every_system
def test_pictures_show_the_system_moving(name: str) -> None:
    env = Environment(SYSTEMS[name], render_mode="rgb_array")
    env.reset(seed=0)
    before = env.render()
    for _ in range(3):
        env.step(env.action_space.high)
    after = env.render()
    env.close()
    assert before.shape == (480, 480, 3)
    assert before.dtype == np.uint8
    drawn = (before != before[0, 0]).any(-1).mean()
    assert 0.005 < drawn < 0.5
    assert (before != after).any(-1).mean() > 1e-3


def test_up_is_up_in_a_picture() -> None:
    env = Environment(SYSTEMS["pendulum"], render_mode="rgb_array")
    env.reset(options={"q": [0.0], "v": [0.0]})
    picture = env.render()
    rod = (picture != picture[0, 0]).any(-1)
    assert rod[:200].sum() > 100
    assert rod[280:].sum() == 0


def test_rendering_to_arrays_needs_no_display(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"):
        monkeypatch.delenv(name, raising=False)
    pygame.display.quit()
    env = Environment(SYSTEMS["pendulum"], render_mode="rgb_array")
    env.reset(seed=0)
    assert env.render().std() > 1
    assert not pygame.display.get_init()


def test_a_missing_pygame_is_reported_with_the_install_command(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "pygame", None)
    env = Environment(SYSTEMS["pendulum"], render_mode="human")
    with pytest.raises(ConfigError, match=r"pip install 'symo_exp\[render\]'"):
        env.reset(seed=0)


def test_parameters_reach_the_system() -> None:
    env = gymnasium.make(
        "symo_exp/Pendulum-v0", parameters={"mass": 2.0, "time_step": 0.02}, solver={"rtol": 1e-6}
    )
    environment = env.unwrapped
    assert environment.system.mass == 2.0
    assert environment.metadata["render_fps"] == 50
    assert environment.solver == Solver("RK45", rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("box", [[1, 2], 3, "q", {"x": [[0, 1]]}])
@every_system
def test_a_box_that_is_none_is_refused(name: str, box: object) -> None:
    with pytest.raises(ConfigError, match=r"system\.box=.*: expected"):
        environment(SYSTEMS[name], box=box)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"parameters": {"weight": 1.0}}, r"parameters=.*: expected a dictionary .* mass, length"),
        ({"parameters": {"_target_": "os.getcwd"}}, "expected a dictionary .* mass, length"),
        ({"parameters": "mass"}, "parameters='mass': expected a dictionary"),
        ({"solver": {"tolerance": 1e-6}}, r"solver=.*: expected a dictionary .* rtol, atol"),
    ],
)
def test_parameters_that_a_system_lacks_are_refused(given: dict[str, object], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        gymnasium.make("symo_exp/Pendulum-v0", **given)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"unknown": 1}, r"options={'unknown': 1}: expected .* motion, reward, render_mode"),
        ({"copies": 2, "render_mode": "human"}, "options=.* expected .* motion, reward, max_ep"),
        ({"reward": lambda q: q}, r"reward is <lambda>\(q\): expected a function of \(q, v, u\)"),
        ({"reward": 3.0}, r"reward is float: expected a function of \(q, v, u\)"),
        ({"motion": lambda q, v: q}, r"motion is .* expected a function of \(q, v, u\)"),
        ({"solver": {"rtol": 1e-3}}, "solver is dict: expected a symo_exp.systems.simulation.Solv"),
    ],
)
def test_options_that_cannot_be_used_are_refused(given: dict[str, object], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        environment(SYSTEMS["pendulum"], **given)


def test_a_motion_that_returns_no_state_is_refused_when_it_does() -> None:
    env = environment(SYSTEMS["pendulum"], motion=lambda q, v, u: (q, v))
    env.reset(seed=0)
    with pytest.raises(ConfigError, match="motion returns Tensor, Tensor: expected three tensors"):
        env.step([0.0])
