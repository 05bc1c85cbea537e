"""Words of messages."""

import pytest

from symo_exp.errors import one_line
from symo_exp.report.looks import duration
from symo_exp.words import counted


@pytest.mark.parametrize(
    ("count", "noun", "words"),
    [
        (1, "run", "1 run"), (0, "run", "0 runs"), (2, "finite number", "2 finite numbers"),
        (1.0, "trajectory", "1 trajectory"), (32.0, "trajectory", "32 trajectories"),
        (2_000_001, "step", "2000001 steps"),
    ],
)  # fmt: skip
def test_a_noun_agrees_with_its_number(count, noun, words):
    assert counted(count, noun) == words


@pytest.mark.parametrize(
    ("text", "cause", "said"),
    [
        ("a study fails", "no sensor", "a study fails: no sensor"),
        ("a study fails: no sensor", "no sensor", "a study fails: no sensor"),
        ("a study fails: no sensor", "no sensor\nin a second line", "a study fails: no sensor"),
    ],
)
def test_a_cause_is_told_once(text, cause, said):
    error = RuntimeError(text)
    error.__cause__ = ValueError(cause)
    assert one_line(error) == said


@pytest.mark.parametrize(
    ("seconds", "said"),
    [(0.259, "0.26 s"), (3.0, "3 s"), (12.4, "12 s"), (108.0, "2 min"), (5.3 * 3600.0, "5 h")],
)
def test_a_duration_is_not_rounded_to_nothing(seconds, said):
    assert duration(seconds) == said
