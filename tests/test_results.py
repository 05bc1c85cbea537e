"""The scripts behind the tables of results/ and docs/ read the runs of today."""

import ast
import importlib.util
import json
import runpy
import shutil
import sys
from pathlib import Path

import pandas as pd
import pytest
import torch
import yaml

import symo_exp
from symo_exp.mechanics.types import Trajectory
from symo_exp.runs.folder import RunFolder
from tests.pages import ROOT
from tests.tiny import TINY

FOLDERS = ("results/*", "examples", "benchmarks")
SCRIPTS = sorted(script for folder in FOLDERS for script in ROOT.glob(f"{folder}/*.py"))
OURS = ("symo_exp", "benchmarks", "tests")


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda file: f"{file.parent.name}/{file.name}")
def test_a_script_imports_names_that_are_there(script):
    for node in ast.walk(ast.parse(script.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and str(node.module).startswith(OURS):
            module = importlib.import_module(str(node.module))
            for name in (alias.name for alias in node.names):
                assert hasattr(module, name) or importlib.util.find_spec(f"{node.module}.{name}")


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """A folder with one finished run of those that both tables are of."""
    folder = tmp_path_factory.mktemp("runs")
    settings = ["model=symo", "data.n_traj=32", "data.n_train_max=32", "data.noise_std=1e-2"]
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        symo_exp.run(*TINY, *settings, "logger=none", "pictures=false", f"output_dir={folder}")
    return folder / "default"


@pytest.fixture
def scripts(runs, monkeypatch):
    monkeypatch.chdir(runs)  # where the data that a script makes again are kept
    monkeypatch.syspath_prepend(ROOT / "results" / "thesis")
    yield
    for name in ("noise", "draws"):
        sys.modules.pop(name, None)


def last_row(table):
    return [cell.strip() for cell in table.strip().splitlines()[-1].strip("|").split("|")]


def test_the_table_of_losses_under_noise(runs, scripts):
    import noise

    run, level, *_, share = last_row(noise.table(runs, "pendulum"))
    assert (run, level) == ("symo", "0.01")
    assert float(share) > 0.0


def test_the_table_of_drawn_trajectories(runs, scripts, monkeypatch):
    import draws

    monkeypatch.setattr(draws, "TRAJECTORIES", 4)
    run, level, *_, low, middle, high, published, below = last_row(draws.draws(runs, "pendulum"))
    assert (run, level) == ("symo midpoint", "0.01")
    assert float(low) <= float(middle) <= float(high)
    assert float(published) > 0.0
    assert below.endswith("%")


def test_the_table_of_noise_keeps_other_runs_and_counts_none_twice(runs, tmp_path, monkeypatch):
    noise = ROOT / "results" / "noise"
    script = shutil.copy(noise / "table.py", tmp_path)
    shutil.copy(noise / "runs.csv", tmp_path)
    monkeypatch.setattr(sys, "argv", ["table.py", str(runs)])
    for _ in range(2):
        runpy.run_path(script, run_name="__main__")
    before, after = (pd.read_csv(folder / "runs.csv") for folder in (noise, tmp_path))
    assert len(after) == len(before) + 1


@pytest.mark.parametrize("table", ["noise", "hardware"])
def test_of_equal_runs_a_table_has_the_last_one(table, runs, tmp_path, monkeypatch):
    """Not the one whose folder is the first or the last by name."""
    (made,) = (path.parent for path in runs.glob("*/metrics.json"))
    outputs = tmp_path / "hardware_symo"
    for name, started, error in [("a", 1.0, 0.5), ("b", 3.0, 0.25), ("c", 2.0, 1.0)]:
        copy = RunFolder(shutil.copytree(made, outputs / name))
        config = yaml.safe_load((copy / "config.yaml").read_text(encoding="utf-8"))
        config["data"]["path"] = "arm.csv"
        (copy / "config.yaml").write_text(yaml.safe_dump(config), encoding="utf-8")
        about = json.loads((copy / "run.json").read_text(encoding="utf-8"))
        (copy / "run.json").write_text(json.dumps({**about, "started": started}), encoding="utf-8")
        copy.write_measures({"test_mse": error, "rmse_1s": error})
    script = shutil.copy(ROOT / "results" / table / "table.py", tmp_path)
    kept = tmp_path / "runs.csv"
    header = (ROOT / "results" / table / "runs.csv").read_text(encoding="utf-8").splitlines()[0]
    kept.write_text(f"{header}\n", encoding="utf-8")
    given = outputs if table == "noise" else tmp_path
    monkeypatch.setattr(sys, "argv", ["table.py", str(given)])
    runpy.run_path(script, run_name="__main__")
    found = pd.read_csv(kept)
    measure = "test_mse" if table == "noise" else "rmse_1s"
    assert found[measure].dropna().tolist() == [0.25]


def test_a_search_without_a_model_replaces_an_earlier_one_in_the_table(tmp_path, monkeypatch):
    machines = ROOT / "results" / "machines"
    script = shutil.copy(machines / "table.py", tmp_path)
    before = pd.read_csv(shutil.copy(machines / "runs.csv", tmp_path))
    earlier = before.iloc[0]
    folder = tmp_path / "outputs" / earlier.machine / str(earlier.seed)
    folder.mkdir(parents=True)
    plan = {"budget": 60.0, "cores": 2, "folds": 3}
    (folder / "plan.json").write_text(json.dumps(plan), encoding="utf-8")
    table = "candidate,chosen,error,ended_by_the_clock,failed\nrigid links,0,nan,0,diverged\n"
    (folder / "candidates.csv").write_text(table, encoding="utf-8")
    monkeypatch.setattr(sys, "argv", ["table.py", str(tmp_path / "outputs")])
    runpy.run_path(script, run_name="__main__")
    after = pd.read_csv(tmp_path / "runs.csv")
    assert len(after) == len(before)
    same = after[(after.machine == earlier.machine) & (after.seed == earlier.seed)]
    assert same.verdict.tolist() == ["no model"]
    assert same.filter(like="rmse").isna().all(axis=None)


@pytest.mark.parametrize(("there", "taken"), [(1, 1), (10, 10), (400, 300)])
def test_the_makers_equations_are_refitted_to_different_windows(there, taken):
    script = runpy.run_path(str(ROOT / "results" / "hardware" / "refit.py"))
    q = torch.arange(25.0 * there + 1.0)[:, None]  # 25 time steps are the 0.5 s of a window
    found = script["pieces"]([Trajectory(q, q, q)])
    assert found.q[:, 0].unique().numel() == len(found.q) == taken


def test_a_machine_of_the_coverage_is_not_counted_twice(tmp_path):
    kept = ROOT / "results" / "uncertainty" / "runs.csv"
    copy = Path(shutil.copy(kept, tmp_path))
    script = runpy.run_path(str(kept.with_name("coverage.py")))
    before = pd.read_csv(kept)
    script["keep"](before.tail(2).assign(held=1), copy)
    after = pd.read_csv(copy)
    assert after.tail(2).held.tolist() == [1, 1]
    assert after.drop(columns="held").equals(before.drop(columns="held"))
