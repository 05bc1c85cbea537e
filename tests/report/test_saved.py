"""Runs that a report saved stand for the store they are from."""

import math

import pandas as pd
import pytest

from symo_exp.errors import ConfigError
from symo_exp.report import saved
from symo_exp.report.runs import read
from tests.report.stores import add_run
from tests.report.test_report import made

PLAIN = ("--formats",)
"""No pictures."""


@pytest.fixture
def reported(store, tmp_path):
    """A store with what is hard to write down, and the folder of its report."""
    for seed, value in enumerate((1e-300, math.inf, math.nan)):
        add_run(store, seed=seed, metrics={"test_mse": value, "training_seconds": 2.0})
    add_run(store, seed=0, system="cartpole", noise_std=1e-4)
    add_run(store, seed=0, system="cartpole", parameters={"learning_rate": "0.001"})
    add_run(store, experiment="other", seed=0, method="true_ode", integrator="rk4")
    words = ["--experiment", "thesis", "other", "--no-page"]
    assert made(store, *words, out=tmp_path / "first", formats=PLAIN) == 0
    return tmp_path / "first"


@pytest.mark.parametrize("name", ["runs.csv", "runs.parquet"])
def test_they_are_the_runs_of_the_store(store, reported, name):
    kept = saved.load([reported / name]).measures.drop(columns="files")
    there = read(store, ["thesis", "other"]).measures.drop(columns="files")
    by = ["run_id", "metric"]
    pd.testing.assert_frame_equal(
        kept.sort_values(by, ignore_index=True), there.sort_values(by, ignore_index=True),
        check_dtype=False, check_exact=True,
    )  # fmt: skip


@pytest.mark.parametrize("name", ["runs.csv", "runs.parquet"])
def test_they_give_the_same_report(reported, tmp_path, store, name):
    words = ["--runs", str(reported / name), "--no-page"]
    assert made(store, *words, out=tmp_path / "again", formats=PLAIN) == 0
    assert _texts(tmp_path / "again") == _texts(reported)


def _texts(folder):
    """By name; of the report, all but what it says it is from."""
    texts = {str(p.relative_to(folder)): p.read_text() for p in folder.rglob("*.md")}
    return texts | {"report.md": texts["report.md"].partition("\n## ")[2]}


def test_files_join_and_of_the_same_runs_the_last_counts(store, reported, tmp_path):
    again = add_run(store, seed=0, metrics={"test_mse": 3.0})
    assert made(store, "--no-page", out=tmp_path / "later", formats=PLAIN) == 0
    files = [tmp_path / "later" / "runs.parquet", reported / "runs.csv"]
    joined = saved.load(files).measures
    cell = joined[(joined.system == "pendulum") & (joined.seed == 0) & (joined.method == "symo")]
    assert list(cell.run_id) == [again]
    assert set(joined.experiment) == {"thesis", "other"}
    assert not joined.duplicated(["run_id", "metric"]).any()


def test_they_are_narrowed_as_a_store_is(reported):
    files = [reported / "runs.csv"]
    found = saved.load(files, ["thesis"], systems=["pendulum"], seeds=[0, 2]).table
    assert sorted(found.seed) == [0, 2]
    assert set(found.system) == {"pendulum"}
    with pytest.raises(ConfigError, match=r"no experiment 'nothing'.*they have: other, thesis"):
        saved.load(files, ["nothing"])


@pytest.mark.parametrize(("column", "written"), [("value", "much"), ("started", "once")])
def test_what_is_no_number_or_no_time_is_said_in_a_line(reported, column, written):
    table = pd.read_csv(reported / "runs.csv").astype({column: object})
    table.loc[0, column] = written
    table.to_csv(reported / "edited.csv", index=False)
    with pytest.raises(ConfigError, match=rf"edited.csv cannot be read \(.*{written}"):
        saved.load([reported / "edited.csv"])
