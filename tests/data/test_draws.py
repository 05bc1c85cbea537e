"""Starts: in the box, as announced, and where published, those that were published."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from symo_exp.data.draws import DRAWS, gym_generator, uniform
from symo_exp.data.simulate import generate
from symo_exp.errors import ConfigError
from symo_exp.systems.base import SamplingBox
from symo_exp.systems.cartpole import Cartpole
from symo_exp.systems.simulation import Solver
from tests.data.small import ready, small

BOX = SamplingBox(q=((1.0, 2.0), (-3.0, 0.0)), v=((0.0, 0.1), (5.0, 6.0)), u=((-7.0, -6.0),))
COUNTS = {"train": 2000, "val": 300, "test": 100, "integration": 50}


@pytest.mark.parametrize("interleaved", [False, True])
@pytest.mark.parametrize("name", DRAWS)
def test_draws_are_uniform_in_the_box_and_each_set_has_its_own(name, interleaved) -> None:
    starts = DRAWS[name](BOX, COUNTS, 0, interleaved=interleaved)
    assert {split: len(s.q) for split, s in starts.items()} == COUNTS
    low, high = np.array([*BOX.q, *BOX.v, *BOX.u]).T
    share = np.sort((torch.cat(starts["train"], 1).numpy() - low) / (high - low), axis=0)
    ideal = (np.arange(2000) + 0.5)[:, None] / 2000
    assert np.abs(share - ideal).max() < 1.95 / np.sqrt(2000)  # Kolmogorov-Smirnov, p = 0.001
    for field in (0, 1):  # of the rollouts, the input is not used
        values = torch.cat([s[field] for s in starts.values()])
        assert len(torch.unique(values, dim=0)) == len(values)


@pytest.mark.parametrize("name", DRAWS)
def test_other_seeds_give_other_trajectories_to_train_on(name) -> None:
    one, two = (DRAWS[name](BOX, COUNTS, seed, interleaved=False)["train"] for seed in (0, 1))
    assert not torch.isin(one.q, two.q).any()


def test_the_generator_is_that_of_old_gym() -> None:
    """The widely known first observation of CartPole-v0 after ``env.seed(0)``."""
    first = gym_generator(0).uniform(-0.05, 0.05, size=4)
    known = [-0.04456399, 0.04653909, 0.01326909, -0.02099827]
    np.testing.assert_allclose(first, known, atol=5e-9)


@pytest.mark.parametrize(
    ("split", "seed", "skipped"), [("train", 3, 0), ("test", 3, 2000), ("integration", 4, 0)]
)
def test_published_states_are_drawn_one_after_another(split, seed, skipped) -> None:
    """As a Gym environment does at every reset, and tests go on where training stopped."""
    whole, turns = gym_generator(seed), gym_generator(seed)
    for _ in range(skipped + 1):
        state = whole.uniform(*np.array([*BOX.q, *BOX.v]).T)
        in_turn = [turns.uniform(*BOX[kind][i]) for i in (0, 1) for kind in (0, 1)]
    first = DRAWS["published"](BOX, COUNTS, 3, interleaved=False)[split]
    assert [*first.q[0], *first.v[0]] == state.tolist()
    first = DRAWS["published"](BOX, COUNTS, 3, interleaved=True)[split]
    assert [first.q[0, 0], first.v[0, 0], first.q[0, 1], first.v[0, 1]] == in_turn


def test_a_published_trajectory_begins_a_step_after_its_draw() -> None:
    data = ready(draws="published", interleaved=True)
    drawn = DRAWS["published"](
        data.system.sampling_box, data.recipe()["trajectories"], 0, interleaved=True
    )
    path = generate(data.system, drawn["test"], steps=6, forced=True, solver=data.solver)
    for field, whole in zip(data.test_trajectories, path, strict=True):
        assert field.shape[1] == 6
        torch.testing.assert_close(field, whole[:, 1:], rtol=1e-12, atol=1e-12)


def test_trajectories_begin_at_their_starts_and_inputs_are_constant() -> None:
    solver, starts = Solver("RK23", 0.1, 0.1), uniform(BOX, 3, 0)
    path = generate(Cartpole(), starts, steps=1, forced=True, solver=solver)
    for field, start in zip(path, starts, strict=True):
        assert torch.equal(field[:, 0], start)
    assert torch.equal(path.u[:, 0], path.u[:, 1])
    assert path.u.any()


def test_other_draws_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"data\.draws=.mine.: .*independent.*published"):
        small(draws="mine")
