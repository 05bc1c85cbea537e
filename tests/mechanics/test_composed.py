"""The midpoint rule in parts of time steps."""

from dataclasses import replace

import pytest
import torch

from symo_exp.mechanics.composed import ComposedMidpoint, RefinedMidpoint
from symo_exp.mechanics.variational import VariationalMidpoint
from symo_exp.systems.chain import ChainPendulum
from tests.mechanics.motions import roll, start

DEGREES = (1, 2, 3)
STEPS, STEP = 6, 0.05


@pytest.mark.parametrize("coulomb", [0.0, 0.3])
@pytest.mark.parametrize("parts", [1, 2, 4])
@pytest.mark.parametrize("n", DEGREES)
def test_a_time_step_is_as_many_steps_of_the_midpoint_rule_as_it_has_parts(
    n: int, parts: int, coulomb: float
) -> None:
    chain = replace(ChainPendulum(n), coulomb=(coulomb,) * n).lagrangian
    q, v = start(n)
    p = chain.momentum(q, v)
    whole = roll(ComposedMidpoint(parts=parts), chain, q, p, STEPS, STEP, forced=True)
    fine = roll(VariationalMidpoint(), chain, q, p, parts * STEPS, STEP / parts, forced=True)
    for ours, theirs in zip(whole, fine, strict=True):
        torch.testing.assert_close(ours, theirs[::parts])


def test_a_machine_comes_to_rest_where_the_midpoint_rule_alternates() -> None:
    """The dry friction of a slow motion is steep: velocities decrease by a factor near -1."""
    still = replace(ChainPendulum(1), gravity=1e-9, coulomb=(2.0,), rest_velocity=0.001)
    q, v = torch.tensor([[[0.0]], [[1.02]]], dtype=torch.float64)
    speeds = {}
    for parts in 1, 4:
        rule, p = ComposedMidpoint(parts=parts), still.momentum(q, v)
        momenta = roll(rule, still.lagrangian, q, p, 40, 0.02)[1]
        speeds[parts] = momenta[-10:].detach().abs().mean()
    assert speeds[1] > 100 * speeds[4], speeds


@pytest.mark.parametrize("n", DEGREES)
def test_a_refined_rule_trains_as_the_midpoint_rule_and_predicts_in_parts(n: int) -> None:
    q, v = start(n)
    chain, rule = ChainPendulum(n), RefinedMidpoint(parts=3)
    for ours, theirs in zip(
        rule.slots(chain, q, q + STEP * v, STEP),
        VariationalMidpoint().slots(chain, q, q + STEP * v, STEP),
        strict=True,
    ):
        assert torch.equal(ours, theirs)
    predicted = roll(rule.of_rollouts(), chain, q, chain.momentum(q, v), STEPS, STEP)[0]
    composed = roll(ComposedMidpoint(parts=3), chain, q, chain.momentum(q, v), STEPS, STEP)[0]
    torch.testing.assert_close(predicted, composed)
