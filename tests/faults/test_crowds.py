"""Many processes that start at once, without a store or a cache."""

import json

import pytest

from symo_exp.tracking.store import connect, find
from tests.faults.commands import Command
from tests.tiny import TINY

WORDS = [*TINY, "model=node", "pictures=false"]


def runs(folder):
    client = connect(find(None, folder / "mlruns"))
    experiments = client.search_experiments(filter_string="name = 'default'")
    assert len(experiments) == 1
    return client.search_runs([experiments[0].experiment_id])


def crowd(folder, choices):
    folder.mkdir()
    commands = [Command(folder, *WORDS, *words) for words in choices]
    ends = [(command.wait(), command.said) for command in commands]
    assert [code for code, _ in ends] == [0] * len(ends), ends
    for path in folder.glob("outputs/*/*-*/outcome.json"):
        assert json.loads(path.read_text())["status"] == "finished"
    assert {run.info.status for run in runs(folder)} == {"FINISHED"}
    assert not [*folder.rglob("*.new"), *folder.rglob(".*.npz.*")]


@pytest.mark.slow
def test_eight_that_differ(tmp_path):
    """They share the data, too, which one of them makes."""
    folder = tmp_path / "new"
    crowd(folder, [[f"seed={i}", "data.seed=0"] for i in range(8)])
    assert len(runs(folder)) == 8
    assert len([*folder.rglob("*.npz")]) == 1
    assert len([*folder.glob("outputs/*/*-*/outcome.json")]) == 8


@pytest.mark.slow
@pytest.mark.parametrize("count", [2, 4])
def test_some_that_are_the_same(count, tmp_path):
    """One does the work, the others wait for it."""
    folder = tmp_path / "new"
    crowd(folder, [["seed=0"]] * count)
    assert len(runs(folder)) == 1
    assert len([*folder.glob("outputs/*/*-*/outcome.json")]) == 1


@pytest.mark.slow
@pytest.mark.parametrize("attempt", range(5))
def test_again_and_again(attempt, tmp_path):
    crowd(tmp_path / "new", [[f"seed={i}", "data.seed=0"] for i in range(8)])
