"""Many processes that start at once, without a store or a cache."""

import pytest

from tests.faults.commands import Command, statuses, stored
from tests.tiny import TINY

WORDS = [*TINY, "model=node", "pictures=false"]


def crowd(folder, choices):
    folder.mkdir()
    commands = [Command(folder, *WORDS, *words) for words in choices]
    ends = [(command.wait(), command.said) for command in commands]
    assert [code for code, _ in ends] == [0] * len(ends), ends
    assert set(statuses(folder)) == {"finished"}
    assert {run.info.status for run in stored(folder)[1]} == {"FINISHED"}
    assert not [*folder.rglob("*.new"), *folder.rglob(".*.npz.*")]


@pytest.mark.slow
def test_eight_different_runs_at_once(tmp_path):
    """They share the data, too, which one of them makes."""
    folder = tmp_path / "new"
    crowd(folder, [[f"seed={i}", "data.seed=0"] for i in range(8)])
    assert len(stored(folder)[1]) == 8
    assert len([*folder.rglob("*.npz")]) == 1
    assert len(statuses(folder)) == 8


@pytest.mark.slow
@pytest.mark.parametrize("count", [2, 4])
def test_equal_runs_at_once_are_one_run(count, tmp_path):
    """One does the work, the others wait for it."""
    folder = tmp_path / "new"
    crowd(folder, [["seed=0"]] * count)
    assert len(stored(folder)[1]) == 1
    assert len(statuses(folder)) == 1


@pytest.mark.slow
@pytest.mark.parametrize("attempt", range(5))
def test_eight_different_runs_at_once_in_every_attempt(attempt, tmp_path):
    crowd(tmp_path / "new", [[f"seed={i}", "data.seed=0"] for i in range(8)])
