"""Words of messages."""

import pytest

from symo_exp.words import counted


@pytest.mark.parametrize(
    ("count", "noun", "words"),
    [
        (1, "run", "1 run"), (0, "run", "0 runs"), (2, "finite number", "2 finite numbers"),
        (1.0, "trajectory", "1 trajectory"), (32.0, "trajectory", "32 trajectories"),
    ],
)  # fmt: skip
def test_a_noun_agrees_with_its_number(count, noun, words):
    assert counted(count, noun) == words
