"""Runs from Python: the same as those of the command."""

import sys
from math import nan

import pytest
import torch

import symo_exp
from symo_exp.errors import ConfigError
from symo_exp.runs.folder import RunFolder
from symo_exp.training.progress import ProgressBar
from tests.tiny import TINY

SMALL = ["model=symo", *TINY, "logger=none"]


def test_a_run_gives_the_measures_model_and_figures_of_its_folder(workplace):
    run = symo_exp.run(*SMALL, "pictures=false")
    assert [run.folder] == list((workplace / "outputs" / "default").glob("symo-*"))
    assert run.measures == RunFolder(run.folder).measures()
    assert run.measures["test_mse"] > 0
    assert {"trajectory", "t", "q_theta", "q_true_theta"} <= set(run.rollouts.columns)
    assert run.parameters.empty  # of a network
    path = run.model.rollout([0.1], [0.0], steps=3)
    assert path.q.shape == (4, 1)
    trained = (run.folder / "checkpoints" / "last.ckpt").stat().st_mtime_ns
    words = {"model": "symo", "data.n_traj": 2, "logger": "none"}
    again = symo_exp.run(*[word for word in TINY if "n_traj=" not in word], **words)
    assert again.folder == run.folder  # it is finished, but for the pictures
    assert (run.folder / "checkpoints" / "last.ckpt").stat().st_mtime_ns == trained
    assert run.figure("phase_portrait").size[0] > 100
    for name, told in (("nothing", "nothing"), ([], r"\[\]")):
        with pytest.raises(ConfigError, match=rf"no figure {told}; the run has: .*trajectories"):
            run.figure(name)
    again = symo_exp.Run(run.folder)
    assert torch.equal(again.model.rollout([0.1], [0.0], steps=3).q, path.q)
    before = (run.folder / "metrics.json").stat().st_mtime_ns
    assert symo_exp.run(*SMALL).folder == run.folder  # it is finished
    assert (run.folder / "metrics.json").stat().st_mtime_ns == before
    with pytest.raises(ConfigError, match="not a run folder: it does not exist"):
        symo_exp.Run("nowhere")
    with pytest.raises(ConfigError, match=r"Run\(NoneType\): expected the folder of a run"):
        symo_exp.Run(None)
    with pytest.raises(ConfigError, match=rf"no config.yaml, but {run.folder.name} in it has one"):
        symo_exp.Run(run.folder.parent)
    rows = [{"name": "mass", "value": 0.5, "unit": "kg"}, {"name": "b", "value": nan, "unit": ""}]
    RunFolder(run.folder).write_parameters(rows)
    assert symo_exp.Run(run.folder).parameters.set_index("name").value["mass"] == 0.5
    RunFolder(run.folder).record("running")
    for name in ("metrics.json", "parameters.csv"):
        (run.folder / name).unlink()
    for result in ("measures", "parameters"):
        with pytest.raises(ConfigError, match=r"metrics.json does not exist; .* 'running'"):
            getattr(symo_exp.Run(run.folder), result)


def test_measures_of_a_damaged_file_are_refused(tmp_path):
    folder = RunFolder(tmp_path / "run")
    folder.write_config({"model": {}})
    folder.record("finished")
    (folder / "metrics.json").write_text('{"test_mse": 1')
    with pytest.raises(ConfigError, match=r"metrics.json is damaged; give the command of the run"):
        assert symo_exp.Run(folder.path).measures


def test_a_sweep_gives_its_runs_in_order(workplace):
    runs = symo_exp.run(*SMALL, "-m", "pictures=false", "trainer.max_epochs=2,1")
    epochs = [len((run.folder / "series.csv").read_text().splitlines()) - 1 for run in runs]
    assert epochs == [2, 1]
    (again,) = symo_exp.run(*SMALL, "-m", "pictures=false", "trainer.max_epochs=1")
    assert again.folder == runs[1].folder


def test_errors_of_a_run_are_raised(workplace, monkeypatch):
    argv = list(sys.argv)
    for words, said in {
        ("modle=symo",): "modle",
        ("model=symo", "integrator=rk4"): "integrator=midpoint",
        ("--cfg", "job"): "starts a run",
        ("data.n_traj",): "not a setting",
        ("model=symo seed=1",): "model=symo seed=1: give each setting as a word of its own",
        (("model=symo",),): "expected words of a command",
    }.items():
        with pytest.raises(ConfigError, match=said):
            symo_exp.run(*words)
    monkeypatch.setattr("symo_exp.job.recipe.evaluate", lambda *_: 1 / 0)
    with pytest.raises(RuntimeError, match=r"failed: ZeroDivisionError.*symo_exp\.log"):
        symo_exp.run(*SMALL, "pictures=false")
    assert sys.argv == argv


def test_notebooks_have_a_progress_bar(monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: False, raising=False)
    monkeypatch.delitem(sys.modules, "ipykernel", raising=False)
    assert not ProgressBar().shown
    monkeypatch.setitem(sys.modules, "ipykernel", sys)
    assert ProgressBar().shown
