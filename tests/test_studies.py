"""Studies as part of runs, and of runs that are finished already."""

import json

import pandas as pd
import pytest

from symo_exp import studies
from symo_exp.__main__ import main
from symo_exp.configuration.command import jobs_of, parse
from symo_exp.evaluation.study import Finding
from symo_exp.tracking.store import connect, find
from tests.test_main import TINY

SHORT = ["study.forced.steps=4", "study.forced.count=1"]


def folder_of(*words):
    return jobs_of(parse(list(words))).jobs[0].folder


def test_a_study_changes_no_folder(workplace):
    folders = {folder_of(*w) for w in ([], ["study=forced"], ["study=[long_term,forced]"])}
    assert len(folders) == 1


def test_a_finished_run_is_studied_without_training_it_again(workplace, capsys):
    words = ["model=l_node", "integrator=rk4", "pictures=false", *TINY]
    folder = folder_of(*words)
    assert main(words) == 0
    assert not (folder / "studies").exists()
    trained = (folder / "checkpoints" / "last.ckpt").stat().st_mtime_ns
    measured = (folder / "metrics.json").stat().st_mtime_ns
    outcome = (folder / "outcome.json").read_text()

    asked = [*words, "study=forced", *SHORT]
    assert main(asked) == 0
    assert (folder / "checkpoints" / "last.ckpt").stat().st_mtime_ns == trained
    assert (folder / "metrics.json").stat().st_mtime_ns == measured
    assert (folder / "outcome.json").read_text() == outcome
    table = pd.read_parquet(folder / "studies" / "forced.parquet")
    assert list(table.step) == [0, 1, 2, 3, 4]
    done = (folder / "studies" / "forced.json").stat().st_mtime_ns

    client = connect(find(None, "mlruns"))
    (experiment,) = (e for e in client.search_experiments() if e.name == "default")
    (run,) = client.search_runs([experiment.experiment_id])
    assert run.info.status == "FINISHED"
    assert run.data.metrics["forced_pose_mse"] >= 0.0
    assert run.data.metrics["test_mse"] > 0.0
    names = {f.path for f in client.list_artifacts(run.info.run_id, "studies")}
    assert names == {"studies/forced.json", "studies/forced.parquet"}

    capsys.readouterr()
    assert main(asked) == 0
    assert "finished already" in capsys.readouterr().out
    assert (folder / "studies" / "forced.json").stat().st_mtime_ns == done
    assert main([*asked, "study.forced.period=3"]) == 0
    assert (folder / "studies" / "forced.json").stat().st_mtime_ns > done


def test_a_run_does_its_studies_when_it_is_trained(workplace):
    words = [
        "model=node",
        "logger=none",
        "pictures=false",
        *TINY,
        "study=[forced,learned_quantities]",
    ]
    assert main([*words, *SHORT]) == 0
    folder = folder_of(*words)
    kept = {path.name for path in (folder / "studies").iterdir()}
    # a NODE has learned no energy; that it was asked for is kept all the same
    assert kept == {"forced.json", "forced.parquet", "learned_quantities.json"}


@pytest.mark.parametrize(
    ("word", "wanted"),
    [("study=[forced,forcd]", "forced"), ("study=forced study.forced.steps=0", "at least 1"),
     ("study=forced study.forced.step=3", "study.forced.step"),
     ("study=forced study.forced.period=long", "number"),
     ("study=forced study.forced._target_=os.system", "refused")],
)  # fmt: skip
def test_a_study_that_cannot_be_is_refused(word, wanted, workplace, capsys):
    assert main([*word.split(), "logger=none"]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert wanted in line


def test_a_study_is_done_with_its_settings_or_not_at_all(tmp_path):
    asked = {"forced": {"steps": 3, "period": 2.0}}
    assert studies.missing(asked, tmp_path) == ["forced"]
    studies.keep("forced", asked["forced"], Finding({}, {"forced_x": float("inf")}), tmp_path)
    assert studies.missing(asked, tmp_path) == []
    assert studies.missing({"forced": {"steps": 4, "period": 2.0}}, tmp_path) == ["forced"]
    file = tmp_path / "studies" / "forced.json"
    assert json.loads(file.read_text())["measures"] == {"forced_x": "inf"}
    file.write_text("{")
    assert studies.missing(asked, tmp_path) == ["forced"]
