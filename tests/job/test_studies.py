"""Studies as part of runs, and of runs that are finished already."""

import pandas as pd
import pytest

from symo_exp.__main__ import main
from symo_exp.tracking.store import connect, find
from tests.jobs import job_of, refusal
from tests.tiny import TINY

SHORT = ["study.forced.steps=4", "study.forced.count=1"]


@pytest.mark.usefixtures("store")
def test_a_finished_run_is_studied_without_training_it_again(workplace, capsys):
    words = ["model=node", "pictures=false", *TINY]
    folder = job_of(*words).folder
    assert main([*words, "study=learned_quantities"]) == 0
    # a NODE has learned no energy; that it was asked for is kept all the same
    assert [path.name for path in (folder / "studies").iterdir()] == ["learned_quantities.json"]
    trained = (folder / "checkpoints" / "last.ckpt").stat().st_mtime_ns
    measured = (folder / "metrics.json").stat().st_mtime_ns

    asked = [*words, "study=forced", *SHORT]
    assert main(asked) == 0
    assert (folder / "checkpoints" / "last.ckpt").stat().st_mtime_ns == trained
    assert (folder / "metrics.json").stat().st_mtime_ns == measured
    assert folder.outcome().status == "finished"
    table = pd.read_parquet(folder / "studies" / "forced.parquet")
    assert list(table.step) == [0, 1, 2, 3, 4]
    done = (folder / "studies" / "forced.json").stat().st_mtime_ns

    client = connect(find(None, "mlruns"))
    (experiment,) = (e for e in client.search_experiments() if e.name == "default")
    (run,) = client.search_runs([experiment.experiment_id])
    assert run.info.status == "FINISHED"
    assert run.data.metrics["forced_configuration_mse"] >= 0.0
    assert run.data.metrics["test_mse"] > 0.0
    names = {f.path for f in client.list_artifacts(run.info.run_id, "studies")}
    assert names == {
        f"studies/{x}" for x in ("learned_quantities.json", "forced.json", "forced.parquet")
    }

    capsys.readouterr()
    assert main(asked) == 0
    assert "finished already" in capsys.readouterr().out
    assert (folder / "studies" / "forced.json").stat().st_mtime_ns == done
    assert main([*asked, "study.forced.period=3"]) == 0
    assert (folder / "studies" / "forced.json").stat().st_mtime_ns > done


WRONG = """
class Wrong:
    def __call__(self, model, system, data, *, remember):
        {body}
"""


@pytest.mark.parametrize(
    ("body", "code", "told"),
    [
        ('return {"wrong_error": 1.0}', 2, "study=wrong: its result is dict: expected a symo_exp."),
        ('raise KeyError("error")', 1, "study=wrong fails: KeyError: 'error'"),
    ],
)
def test_a_study_of_a_user_that_gives_no_finding_is_named(body, code, told, workplace, capsys):
    (workplace / "mine" / "study").mkdir(parents=True)
    (workplace / "mine" / f"wrong_study_{code}.py").write_text(WRONG.format(body=body))
    file = f"# @package study.wrong\n# Wrong.\n_target_: wrong_study_{code}.Wrong\n"
    (workplace / "mine" / "study" / "wrong.yaml").write_text(file)
    words = ["--config-dir", "mine", "code=mine", "study=wrong", "model=true_ode", "measures=false"]
    assert main([*words, *TINY, "pictures=false", "logger=none"]) == code
    assert told in capsys.readouterr().err


TWICE = """
from dataclasses import dataclass
from symo_exp.evaluation.study import Finding, afresh

@dataclass
class Twice:
    measure: str

    def __call__(self, model, system, data, *, remember=afresh):
        return Finding(measures={self.measure: 1.0})
"""


@pytest.mark.slow
def test_a_study_does_not_replace_another_measure(workplace, capsys):
    (workplace / "mine" / "study").mkdir(parents=True)
    (workplace / "mine" / "twice_study.py").write_text(TWICE)
    for name in ("one", "two"):
        file = f"# @package study.{name}\n# A.\n_target_: twice_study.Twice\nmeasure: largest\n"
        (workplace / "mine" / "study" / f"{name}.yaml").write_text(file)
    words = ["--config-dir", "mine", "code=mine", "study=[one,two]", "model=true_ode"]
    words += [*TINY, "pictures=false", "logger=none"]
    for given, taken in [([], "largest"), (["study.one.measure=test_mse"], "test_mse")]:
        assert main([*words, *given]) == 2
        told = f"another measure of the run is named {taken}; rename this one"
        assert told in capsys.readouterr().err
    assert main([*words, "study.two.measure=other"]) == 0
    assert main([*words, "study.two.measure=another"]) == 0  # its own name before


@pytest.mark.parametrize(
    ("word", "wanted"),
    [("study=[forced,forcd]", "forced"), ("study=forced study.forced.steps=0", "from 1 to"),
     ("study=forced study.forced.step=3", "study.forced.step"),
     ("study=forced study.forced.period=long", "number"),
     ("study=forced study.forced._target_=os.system", "refused")],
)  # fmt: skip
def test_an_invalid_study_is_refused(word, wanted, workplace):
    assert wanted in refusal(*word.split(), "logger=none")
