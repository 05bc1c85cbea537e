"""The published draws of initial states."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from symo_exp.data.draws import generate
from symo_exp.thesis.draws import Published, gym_generator
from tests.data.small import ready
from tests.data.test_draws import BOX, COUNTS


def test_the_generator_is_that_of_gym_before_its_change() -> None:
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
    first = Published()(BOX, COUNTS, 3)[split]
    assert [*first.q[0], *first.v[0]] == state.tolist()
    first = Published(interleaved=True)(BOX, COUNTS, 3)[split]
    assert [first.q[0, 0], first.v[0, 0], first.q[0, 1], first.v[0, 1]] == in_turn


def test_a_published_trajectory_begins_a_step_after_its_draw() -> None:
    draws = Published(interleaved=True)
    data = ready(draws=draws)
    drawn = draws(data.system.box, data.recipe()["trajectories"], 0)
    path = generate(data.system, drawn["test"], steps=6, forced=True, solver=data.solver)
    for found, whole in zip(data.trajectories("test"), path.each(), strict=True):
        for field, drawn_ in zip(found, whole, strict=True):
            assert len(field) == 6
            torch.testing.assert_close(field, drawn_[1:], rtol=1e-12, atol=1e-12)
