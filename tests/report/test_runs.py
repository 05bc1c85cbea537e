"""From a tracking store, run folders or saved files to one tidy table."""

import math

import pandas as pd
import pytest

from symo_exp.errors import ConfigError
from symo_exp.report import runs
from symo_exp.report.cells import cells
from symo_exp.tracking.publish import MlflowView
from symo_exp.tracking.store import connect, experiment_id, find
from tests.report.stores import MEASURES, add_folder, add_run, row


def test_a_damaged_store_is_refused_in_a_line(store):
    add_run(store)
    whole = store.database.read_bytes()
    store.database.write_bytes(whole[: len(whole) // 8])
    with pytest.raises(ConfigError, match="give folders of runs") as caught:
        runs.load_runs(store)
    assert store.uri in str(caught.value)


def test_a_row_for_each_measure_of_each_run(store, monkeypatch):
    for seed in (0, 1):
        add_run(store, seed=seed, system="cartpole", n_traj=8, noise_std=1e-4)
    connect(store).create_run(experiment_id(store, "thesis"), run_name="a sweep")
    monkeypatch.setattr(runs, "PAGE", 1)  # as a large store, which is read in pages
    found = runs.load_runs(store)
    assert list(found) == runs.COLUMNS
    assert len(found) == 2 * len(MEASURES)
    one = found[(found.seed == 1) & (found.metric == "test_mse")].iloc[0]
    assert (one.system, one.method, one.integrator) == ("cartpole", "symo", "midpoint")
    assert (one.n_traj, one.noise_std, one.time_step) == (8, 1e-4, 0.05)
    assert (one.value, one.seconds) == (MEASURES["test_mse"], MEASURES["training_seconds"])


def test_run_folders_are_read_as_the_store_that_they_are_published_to(store, tmp_path):
    values = {"test_mse": math.inf, "integration_std": math.nan, "training_seconds": 7.0}
    for seed, status in enumerate(("finished", "failed", "finished")):
        place = tmp_path / "outputs" / f"run_{seed}"
        folder = add_folder(place, status, values, n_traj=8, seed=seed, noise_std=None)
        MlflowView(experiment="mine", directory=store.database.parent).publish(folder)
    dead = add_folder(tmp_path / "outputs" / "more" / "dead", "running", seed=4)
    there = runs.load_runs(store)
    found = runs.load_runs([tmp_path / "outputs"])
    lost = found[found.seed == 4].iloc[0]
    assert (lost.status, "killed" in lost.reason) == ("FAILED", True)
    by = ["seed", "metric"]
    pd.testing.assert_frame_equal(
        *(table[table.seed != 4].drop(columns=["files", "run_id", "started"]).sort_values(
            by, ignore_index=True) for table in (found, there)), check_exact=True,
    )  # fmt: skip
    assert runs.load_runs([dead.path], ["mine"]).files.tolist() == [str(dead.path)]
    (tmp_path / "empty").mkdir()
    with pytest.raises(ConfigError, match="empty has no run in it"):
        runs.load_runs([tmp_path / "empty"])


@pytest.mark.parametrize(
    ("file", "content"),
    [
        ("run.json", b"{"),
        ("run.json", b'{"name": "a", "parameters": []}'),
        ("metrics.json", b'{"test_mse": 1'),
        ("metrics.json", b'{"test_mse": "abc"}'),
        ("metrics.json", b'{"test_mse": [1]}'),
        ("series.csv", b"epoch,lr\n0,abc\n"),
        ("series.csv", b"lr\n1\n"),
        ("series.csv", b"\xff\xfe\n\n"),
    ],
)
def test_a_run_with_a_damaged_file_is_named_and_the_others_are_read(
    file, content, tmp_path, caplog
):
    for name in ("whole", "damaged"):
        add_folder(tmp_path / name, "finished", MEASURES)
    (tmp_path / "damaged" / file).write_bytes(content)
    found = runs.load_runs([tmp_path])
    assert set(found.files) == {str(tmp_path / "whole")}
    (line,) = caplog.messages
    assert "damaged is left out" in line
    assert "\n" not in line


@pytest.mark.parametrize(
    ("told", "variant"),
    [({}, ""), ({"variant": ""}, ""), ({"preset": "fast"}, "fast"),
     ({"preset": "fast", "variant": "fast, x=1"}, "fast, x=1")],
)  # fmt: skip
def test_the_variant_is_the_recorded_one_or_else_the_preset(store, told, variant):
    add_run(store, told=told)
    assert set(runs.load_runs(store).variant) == {variant}


@pytest.mark.parametrize("absent", [{"n_traj": None}, {"n_traj": "8.0"}, {"noise_std": "null"}])
def test_settings_that_a_run_does_not_have_are_no_numbers(absent):
    """Recordings have no size, and some a size that is spelt as it came."""
    found = runs.tidy([row(**absent)])
    (value,) = set(found[next(iter(absent))].astype(object).fillna("none"))
    assert value == ("none" if next(iter(absent.values())) in (None, "null") else 8)
    assert len(cells(found)) == len(MEASURES)


def test_of_runs_that_are_the_same_the_last_that_finished_counts():
    failed = {"status": "FAILED", "reason": "power cut"}
    found = runs.tidy(
        [row({"test_mse": 2.0}, started="2026-01-02"), row({"test_mse": 1.0}),
         row({"test_mse": 3.0}, started="2026-01-03", **failed), row(seed=1, **failed)]
    )  # fmt: skip
    assert list(found[found.seed == 0].value) == [2.0]
    (lost,) = runs.without_result(found).to_dict("records")
    assert (lost["seed"], lost["metric"], lost["reason"]) == (1, "", "power cut")


def test_runs_are_selected_by_experiment_system_and_seed(store):
    for system, seed in (("pendulum", 0), ("acrobot", 0), ("acrobot", 1)):
        add_run(store, system=system, seed=seed)
    add_run(store, experiment="other", seed=7)
    narrowed = runs.load_runs(store, ["thesis"], systems=["acrobot"], seeds=[0, 2])
    assert set(zip(narrowed.system, narrowed.seed, strict=True)) == {("acrobot", 0)}
    assert runs.load_runs(store).run_id.nunique() == 4


def test_missing_stores_and_experiments_are_one_line(store, tmp_path):
    add_run(store, experiment="other")
    with pytest.raises(ConfigError, match=r"no experiment 'thesis' in .*; there are: other"):
        runs.load_runs(store, ["thesis"])
    with pytest.raises(ConfigError, match="no tracking store at"):
        runs.load_runs(find(None, tmp_path / "nowhere"))
    assert not (tmp_path / "nowhere").exists()


def test_a_median_of_infinite_values_is_no_undefined_one():
    values = enumerate((1.0, math.inf, math.inf))
    (cell,) = cells(runs.tidy([row({"test_mse": x}, seed=i) for i, x in values])).to_dict("records")
    assert (cell["seeds"], cell["median"], cell["low"]) == (3, math.inf, 1.0)


@pytest.mark.parametrize("name", ["runs.csv", "runs.parquet"])
def test_saved_runs_are_the_same_again(tmp_path, name):
    there = runs.tidy(
        [row({"test_mse": x}, seed=i) for i, x in enumerate((1e-300, math.inf, math.nan))]
        + [row(system="cartpole", n_traj=None, variant="learning_rate=0.001"),
           row(experiment="other", method="true_ode", integrator="rk4"),
           row(seed=9, status="FAILED", reason="out of memory")]
    )  # fmt: skip
    kept = runs.load_runs([runs.save_runs(there, tmp_path / name)])
    pd.testing.assert_frame_equal(kept, there, check_dtype=False, check_exact=True)
    again = runs.tidy([row({"test_mse": 3.0}, started="2027-01-01")])  # as another of them, later
    later = runs.save_runs(again, tmp_path / "later.csv")
    joined = runs.load_runs([later, tmp_path / name], ["thesis"], systems=["pendulum"], seeds=[0])
    assert list(joined.value) == [3.0]
    with pytest.raises(ConfigError, match=r"no experiment 'nothing'.*there are: thesis"):
        runs.load_runs([later], ["nothing"])


@pytest.mark.parametrize(("column", "written"), [("value", "much"), ("started", "once")])
def test_values_that_are_no_numbers_or_times_are_one_line(tmp_path, column, written):
    table = runs.tidy([row()])[runs.SAVED].astype(object)
    table.loc[0, column] = written
    table.to_csv(tmp_path / "edited.csv", index=False)
    with pytest.raises(ConfigError, match=rf"edited.csv cannot be read \(.*{written}"):
        runs.load_runs([tmp_path / "edited.csv"])
