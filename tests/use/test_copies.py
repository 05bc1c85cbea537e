"""Vector environments and environments of models: the motion of single ones."""

import pickle
import warnings

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

from symo_exp.errors import ConfigError
from symo_exp.systems.recorded import Recorded
from symo_exp.systems.simulation import Solver
from symo_exp.use.environments import VectorEnvironment, environment
from tests.models.methods import flows, make
from tests.systems.every import SYSTEMS
from tests.tables import arguments_of

FINE = Solver("RK45", rtol=1e-10, atol=1e-11)


def model_of(system, method="symo", integrator="midpoint"):
    """An untrained model of a system, as loaded."""
    model = make(method, integrator, system.coordinates.n, **arguments_of(system)).for_evaluation()
    model.system = system
    return model


@pytest.mark.parametrize("name", SYSTEMS)
def test_copies_move_as_one_does_alone(name):
    """Of the true system and of a model of it; states, rewards and all."""
    system = SYSTEMS[name]
    model = model_of(system, "l_node", "rk4")
    pairs = [
        (environment(system, solver=FINE), environment(system, 2, solver=FINE)),
        (environment(model), environment(model, 2)),
    ]
    for one, many in pairs:
        states, _ = many.reset(seed=1)
        many.action_space.seed(1)
        actions = [many.action_space.sample() for _ in range(2)]
        told = [many.step(action)[:4] for action in actions]
        n = system.coordinates.width
        for i in range(2):
            one.reset(options={"q": states[i, :n], "v": states[i, n:]})
            for action, (observation, reward, lost, over) in zip(actions, told, strict=True):
                if np.abs(observation[i]).max() > 100.0:
                    break  # an untrained model has flown off, and roundings with it
                alone = one.step(action[i])
                np.testing.assert_allclose(alone[0], observation[i], rtol=1e-6, atol=1e-7)
                np.testing.assert_allclose(alone[1], reward[i], rtol=1e-6, atol=1e-7)
                assert (alone[2], alone[3]) == (lost[i], over[i]) == (False, False)


@pytest.mark.parametrize(("method", "integrator"), flows())
def test_the_environment_of_a_model_is_accepted_and_is_its_step(method, integrator):
    system = SYSTEMS["acrobot"]
    model = model_of(system, method, integrator)
    env = environment(model)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # unbounded observations, unnormalised torques
        check_env(env, skip_render_check=True)
    before, _ = env.reset(seed=2)
    after, reward, *_ = env.step(np.array([9.0]))  # beyond the range
    step = model.step(before[:2], before[2:], [2.0])
    np.testing.assert_allclose(after, torch.cat((step.q, step.v)), rtol=1e-12, atol=1e-12)
    assert reward == pytest.approx(float(system.potential(step.q[None])))


@pytest.mark.parametrize("known", [True, False])
def test_environments_move_alike_in_inference_mode_and_after_pickling(known):
    """That of the true equations and that of a model."""

    def made():
        if known:
            return gymnasium.make("symo_exp/Acrobot-v0").unwrapped
        return environment(model_of(SYSTEMS["acrobot"]))

    def moved(env):
        env.reset(seed=1)
        return env.step([0.5])[0]

    wanted = moved(made())
    with torch.inference_mode():
        np.testing.assert_array_equal(moved(made()), wanted)
    np.testing.assert_array_equal(moved(pickle.loads(pickle.dumps(made()))), wanted)


def test_vector_environments_are_registered_with_gymnasium():
    envs = gymnasium.make_vec("symo_exp/Cartpole-v0", num_envs=5, max_episode_steps=7)
    assert isinstance(envs, VectorEnvironment)
    assert envs.metadata["autoreset_mode"] == AutoresetMode.NEXT_STEP
    first, _ = envs.reset(seed=4)
    again, _ = envs.reset(seed=4)
    np.testing.assert_array_equal(first, again)
    assert envs.observation_space.contains(first)
    assert first.shape == (5, 4)
    ends = [envs.step(envs.action_space.sample())[3] for _ in range(15)]
    assert [end.all() for end in ends] == [k in (6, 14) for k in range(15)]
    assert not any(end.any() for k, end in enumerate(ends) if k not in (6, 14))


def test_a_copy_is_reset_at_the_step_after_its_episode_ends():
    system = SYSTEMS["pendulum"]
    lost_at = 100.0

    def motion(q, v, u):
        return q + 1.0, v, q[:, 0] < lost_at

    envs = environment(system, 3, motion=motion, max_episode_steps=None)
    envs.reset(options={"q": [[98.0], [101.0], [0.0]], "v": [0.0]})
    rest = np.zeros((3, 1))
    state, _, lost, _, _ = envs.step(rest)
    assert lost.tolist() == [False, True, False]
    assert state[:, 0].tolist() == [99.0, 101.0, 1.0]
    state, reward, lost, *_ = envs.step(rest)
    assert lost.tolist() == [False, False, False]
    assert abs(state[1, 0]) <= np.pi
    assert reward[1] == 0.0 != reward[0]
    assert state[[0, 2], 0].tolist() == [100.0, 2.0]
    one = environment(system, motion=motion)
    one.reset(options={"q": [101.0], "v": [0.5]})
    state, _, lost, *_ = one.step(rest[0])
    assert lost
    assert state.tolist() == [101.0, 0.5]


def test_thousands_of_copies_move_in_one_batch():
    model = model_of(SYSTEMS["acrobot"], "node", "rk4")
    calls = []
    step = model.flow.integrator.step
    model.flow.integrator.step = lambda *x: calls.append(len(x[1])) or step(*x)
    envs = environment(model, 4096)
    envs.reset(seed=0)
    state, reward, *_ = envs.step(envs.action_space.sample())
    assert calls == [4096]
    assert state.shape == (4096, 4)
    assert reward.shape == (4096,)


@pytest.mark.parametrize("copies", [None, 3])
def test_episodes_without_a_step_and_actions_that_are_no_numbers_are_refused(copies):
    system = SYSTEMS["pendulum"]
    for steps in (0, -1, 1.5, True, np.nan):
        with pytest.raises(ConfigError, match=f"max_episode_steps={steps}: expected a whole"):
            environment(system, copies, max_episode_steps=steps)
    env = environment(system, copies, max_episode_steps=1)
    env.reset(seed=0)
    with pytest.raises(ConfigError, match=r"action \[nan\] of copy 0: expected numbers"):
        env.step(np.full((copies or 1, 1), np.nan))
    assert np.all(env.step(np.zeros((copies or 1, 1)))[3])


@pytest.mark.parametrize("copies", [None, np.int64(3)])
def test_rewards_and_actions_may_have_any_form(copies):
    """A reward in NumPy, as a list or one number; an action as a tensor, a list or a number."""
    system, count = SYSTEMS["pendulum"], copies or 1
    rewards = [lambda q, v, u: np.cos(q[:, 0].numpy()), lambda q, v, u: [2.0] * len(q)]
    for reward in (*rewards, lambda q, v, u: 2.0):
        env = environment(system, copies, reward=reward)
        env.reset(seed=0)
        for action in (torch.zeros(count, 1), [[0.0]] * count, np.zeros(count)):
            state, found, *_ = env.step(action if copies else action[0])
            q = torch.from_numpy(state.reshape(count, 2)[:, :1])
            np.testing.assert_allclose(np.full(count, found), reward(q, q, q))
        for wrong in (np.zeros((count, 2)), ["left"] * count, None):
            with pytest.raises(ConfigError, match=rf"expected numbers of shape \({count}, 1\)"):
                env.step(wrong)
    for reward in (lambda q, v, u: -(q**2), lambda q, v, u: None, lambda q, v, u: "high"):
        env = environment(system, copies, reward=reward)
        env.reset(seed=0)
        with pytest.raises(ConfigError, match=r"reward has shape .* expected numbers of shape"):
            env.step(np.zeros((count, 1)))


def test_actions_of_several_copies_and_inputs_are_not_reshaped():
    """A row for each input in the place of one for each copy has as many numbers."""
    system = SYSTEMS["quadrotor"]
    m = system.input_matrix.shape[1]
    envs, one = environment(system, 3), environment(system)
    envs.reset(seed=0)
    one.reset(seed=0)
    for wrong in (np.zeros((m, 3)), np.zeros(3 * m)):
        with pytest.raises(ConfigError, match=rf"expected numbers of shape \(3, {m}\)"):
            envs.step(wrong)
    assert envs.step(np.zeros((3, m)))[1].shape == (3,)
    assert one.observation_space.contains(one.step(np.zeros((m, 1)))[0])


def test_models_of_recordings_need_a_box_and_may_have_a_reward():
    system = Recorded(time_step=0.05, names=("a", "b"), angular="all", inputs=("0", "1"))
    model = model_of(system)
    with pytest.raises(ConfigError, match=r"box=dict\(q="):
        environment(model)
    box = {"q": [[-1, 1]] * 2, "v": [[-2, 2]] * 2, "u": [[-3, 3]] * 2}
    env = environment(model, box=box, reward=lambda q, v, u: q[:, 0])
    state, _ = env.reset(seed=0)
    assert (abs(state) < [1, 1, 2, 2]).all()
    state, reward, *_ = env.step(env.action_space.sample())
    assert reward == state[0]
    with pytest.raises(ConfigError, match="give a model instead"):
        environment(system, box=box)
    model.system = None
    with pytest.raises(ConfigError, match=r"environment\(model, system="):
        environment(model)
    with pytest.raises(ConfigError, match=r"environment\(NoneType\): expected a system, a model"):
        environment(None)
    with pytest.raises(ConfigError, match=r"system is str: expected a symo_exp\.systems"):
        environment(model, system="pendulum")
    with pytest.raises(ConfigError, match=r"Pendulum has 1 .* the model, which has 2 and 2"):
        environment(model, system=SYSTEMS["pendulum"])
    with pytest.raises(ConfigError, match="copies=0"):
        environment(model, 0, system=system, box=box)


@pytest.mark.parametrize("flat", [(), ("x", "y", "z")])
def test_models_of_recorded_rotations_have_environments(flat):
    names = (*flat, *(f"R_{part}" for part in "wxyz"))
    system = Recorded(time_step=0.05, names=names, rotations=["R"], angular="none")
    n = len(flat) + 3
    box = {"q": [[-1, 1]] * n, "v": [[-2, 2]] * n, "u": []}
    env = environment(model_of(system), box=box, reward=lambda q, v, u: -(v**2).sum(1))
    state, _ = env.reset(seed=0)
    assert env.observation_space.contains(state)
    assert np.isfinite(env.step(env.action_space.sample())[1])
