"""Starts: in the box, each set its own, and the first nodes of the trajectories."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hydra.utils import instantiate

from symo_exp.data.draws import generate, uniform
from symo_exp.errors import ConfigError
from symo_exp.systems.base import SamplingBox
from symo_exp.systems.simulation import Solver
from symo_exp.systems.table import system as stated
from tests.data.small import small
from tests.jobs import settings_of
from tests.tables import choices

BOX = SamplingBox(q=((1.0, 2.0), (-3.0, 0.0)), v=((0.0, 0.1), (5.0, 6.0)), u=((-7.0, -6.0),))
COUNTS = {"train": 2000, "val": 300, "test": 100, "integration": 50}
SYSTEMS = ("pendulum", "cartpole")  # of the published states one was drawn in another order


def draws(name: str, system: str):
    """As the configuration makes them."""
    (config,) = settings_of(f"draws={name}", f"system={system}")
    return instantiate(config.draws)


@pytest.mark.parametrize("system", SYSTEMS)
@pytest.mark.parametrize("name", choices("draws"))
def test_draws_are_uniform_in_the_box_and_each_set_has_its_own(name, system, workplace) -> None:
    starts = draws(name, system)(BOX, COUNTS, 0)
    assert {split: len(s.q) for split, s in starts.items()} == COUNTS
    low, high = np.array([*BOX.q, *BOX.v, *BOX.u]).T
    share = np.sort((torch.cat(starts["train"], 1).numpy() - low) / (high - low), axis=0)
    ideal = (np.arange(2000) + 0.5)[:, None] / 2000
    assert np.abs(share - ideal).max() < 1.95 / np.sqrt(2000)  # Kolmogorov-Smirnov, p = 0.001
    for field in (0, 1):  # of the rollouts, the input is not used
        values = torch.cat([s[field] for s in starts.values()])
        assert len(torch.unique(values, dim=0)) == len(values)


@pytest.mark.parametrize("name", choices("draws"))
def test_other_seeds_give_other_trajectories_to_train_on(name, workplace) -> None:
    one, two = (draws(name, "pendulum")(BOX, COUNTS, seed)["train"] for seed in (0, 1))
    assert not torch.isin(one.q, two.q).any()


def test_trajectories_begin_at_their_starts_and_inputs_are_constant() -> None:
    solver, starts = Solver("RK23", 0.1, 0.1), uniform(BOX, 3, 0)
    path = generate(stated("cartpole"), starts, steps=1, forced=True, solver=solver)
    for field, start in zip(path, starts, strict=True):
        assert torch.equal(field[:, 0], start)
    assert torch.equal(path.u[:, 0], path.u[:, 1])
    assert path.u.any()


def test_unknown_draws_are_refused() -> None:
    for draws in "mine", uniform:  # neither has a lead
        with pytest.raises(ConfigError, match=r"data\.draws=.*: choose with draws=NAME"):
            small(draws=draws)
