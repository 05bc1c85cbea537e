"""Sweeps: failed jobs, their parent in the store, and jobs that are not repeated."""

import contextlib
import io
import os
import re
import shutil
import signal

import pytest
from hydra.core.plugins import Plugins

from symo_exp.__main__ import main
from symo_exp.errors import ConfigError
from symo_exp.job import job, parts
from symo_exp.job.checks import check_folder
from symo_exp.job.job import end
from symo_exp.process import stopping
from symo_exp.process.stopping import Interrupted
from symo_exp.runs.folder import DIED, RunFolder
from symo_exp.sweep.compose import Job
from symo_exp.sweep.launching import Launches
from symo_exp.sweep.parent import parent
from symo_exp.tracking.nowhere import Nowhere
from symo_exp.tracking.page import NOTE
from symo_exp.tracking.publish import MlflowView
from symo_exp.tracking.store import connect, find
from tests.jobs import planned
from tests.limits import no_file_larger_than
from tests.tiny import TINY, copy_store

SWEPT = [*TINY, "pictures=false", "experiment=study", "model=node", "-m"]
RATES = "optimizer.lr=1e-3,1e30,1e-4"
"""A rate of 1e30 overflows in the first steps."""


@pytest.fixture(scope="module")
def swept(tmp_path_factory, database):
    """Folder, exit code and output of a sweep in which one run fails."""
    place, said = tmp_path_factory.mktemp("swept"), io.StringIO()
    copy_store(database, place)
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(said):
        patch.chdir(place)
        code = main([*SWEPT, RATES])
    return place, code, said.getvalue()


def test_a_failing_job_does_not_stop_the_others(swept):
    place, code, out = swept
    assert code == 1
    files = (place / "outputs" / "study").glob("*/outcome.json")
    outcomes = {file.parent: RunFolder(file.parent).outcome() for file in files}
    assert sorted(o.status for o in outcomes.values()) == ["failed", "finished", "finished"]
    ((folder, failed),) = [(f, o) for f, o in outcomes.items() if o.status == "failed"]
    assert "loss" in failed.reason
    assert "optimizer.lr" in failed.reason  # what to try
    (line,) = [line for line in out.splitlines() if line.startswith("failed: ")]
    assert "optimizer.lr=1e+30" in line
    log = folder / "symo_exp.log"
    assert str(log.relative_to(place)) in line
    assert "Traceback" in log.read_text()
    assert "Traceback" not in out


@pytest.mark.parametrize(
    ("words", "without_effect"),
    [
        (["model=node", "lagrangian=absolute", "root.guess=inertial", "root=broyden"], 3),
        (["model=node", "objective=preconditioned", "net.width=8", "integrator=rk4"], 1),
        (["model=node,symo", "lagrangian=relative", "objective=preconditioned", "-m"], 0),
        (["model=symo", "lagrangian=absolute", "root.guess=inertial", "net.width=8"], 2),
        (["model=l_node", "objective=smoothing", "dtype=float64"], 0),  # the optimizer
        (["model=e2e_symo", "objective=horizon", "objective.horizon=5"], 0),
        (["optimizer=lbfgs", "scheduler=none", "learning_rate=1e-2"], 2),
        (
            [
                "optimizer=adam_then_lm",
                "dtype=float64",
                "scheduler=cosine",
                "scheduler.T_max=9",
                "learner.scheduler_monitor=val_loss",
                "learner.gradient_clip=1",
            ],
            3,
        ),
        (["optimizer=adam,lbfgs", "scheduler=plateau", "scheduler.patience=9", "-m"], 0),
        (["model=true_ode", "optimizer=adamw", "learning_rate=1e-2", "learner.gradient_clip=1"], 3),
        (["draws=published", "draws.interleaved=true", "springs=linear", "seed=1"], 0),
    ],
)
def test_words_of_a_command_that_no_run_reads_are_found(words, without_effect):
    with planned(*words) as (sweep, jobs):
        sweep.check(jobs)
        found = sweep.unread(jobs, words, {})
    assert len(found) == without_effect, found


def test_a_word_without_effect_is_told(workplace, capsys):
    assert main([*TINY, "model=node", "root.guess=inertial", "measures=false"]) == 0
    assert "root.guess=inertial has no effect" in capsys.readouterr().out


def test_a_multirun_is_one_parent_with_its_children(swept):
    from mlflow import MlflowClient

    client = MlflowClient(f"sqlite:///{swept[0]}/mlruns/mlflow.db")
    experiment = client.get_experiment_by_name("study")
    runs = client.search_runs([experiment.experiment_id])
    (parent,) = [r for r in runs if "mlflow.parentRunId" not in r.data.tags]
    children = {r.data.params["optimizer.lr"]: r for r in runs if r is not parent}
    assert {r.data.tags["mlflow.parentRunId"] for r in children.values()} == {parent.info.run_id}
    ended = {rate: r.info.status for rate, r in children.items()}
    assert ended == {"0.001": "FINISHED", "1e+30": "FAILED", "0.0001": "FINISHED"}
    assert parent.info.status == "FAILED"
    finished = [rate for rate, status in ended.items() if status == "FINISHED"]
    best = min(finished, key=lambda rate: children[rate].data.metrics["test_mse"])
    assert re.search(rf"test_mse \S+ \(optimizer\.lr={best}\)", parent.data.tags[NOTE])


def test_another_store_gets_a_sweep_with_its_finished_runs(swept, workplace, database):
    shutil.copytree(swept[0] / "outputs", workplace / "outputs")
    copy_store(database, workplace)
    assert main([*SWEPT, RATES]) == 1
    client = connect(find(None, workplace / "mlruns"))
    experiment = client.get_experiment_by_name("study")
    runs = client.search_runs([experiment.experiment_id])
    (parent,) = [r for r in runs if "mlflow.parentRunId" not in r.data.tags]
    children = [r for r in runs if r is not parent]
    assert len(children) == 3
    assert {r.data.tags["mlflow.parentRunId"] for r in children} == {parent.info.run_id}


def test_finished_jobs_are_not_repeated(swept, workplace, capsys, monkeypatch):
    shutil.copytree(swept[0] / "outputs", workplace / "outputs")
    words = [*SWEPT, "logger=none"]
    known = {f: f.stat().st_mtime_ns for f in workplace.rglob("metrics.json")}
    assert main([*words, "optimizer.lr=1e-3,1e-4,1e-2"]) == 0
    out, _ = capsys.readouterr()
    assert "2 of 3 runs are finished already" in out
    assert len([line for line in out.splitlines() if line.startswith("lr=")]) == 3
    assert "3 of 3: NODE pendulum n=2 lr=0.01  test " in out
    assert known == {f: f.stat().st_mtime_ns for f in known}
    assert len([*workplace.rglob("metrics.json")]) == 3

    monkeypatch.setattr(Launches, "run", lambda *_: pytest.fail("it started"))
    assert main([*words, "optimizer.lr=1e-4"]) == 0  # the same run outside of the sweep
    assert "finished already" in capsys.readouterr().out


def test_a_finished_run_hides_no_resume_that_is_neither_true_nor_false(
    swept, workplace, capsys, monkeypatch
):
    """``no`` is a text, which counts as true in Python: the run was not started anew."""
    shutil.copytree(swept[0] / "outputs", workplace / "outputs")
    monkeypatch.setattr(Launches, "run", lambda *_: pytest.fail("it started"))
    assert main([*SWEPT, "logger=none", "optimizer.lr=1e-4", "resume=no"]) == 2
    assert "resume=no has the wrong type: expected true or false" in capsys.readouterr().err


def launched_by(launch, monkeypatch):
    """Replace the launcher of Hydra by a function of the overrides of the jobs."""

    class Launcher:
        def launch(self, job_overrides, initial_job_idx):
            launch(job_overrides)

    monkeypatch.setattr(Plugins, "instantiate_launcher", lambda *_, **__: Launcher())


def test_a_killed_worker_is_told_once(workplace, monkeypatch, caplog):
    """Its neighbours that had not begun are started before it, in a round in which none dies."""
    rounds = []

    def launch(several):
        rounds.append([words[-1] for words in several])
        for words in several:
            begins = len(rounds) > 1 or words[-1] == "seed=0"
            folders[words[-1]].record("running" if begins else "waiting")
            if len(rounds) > 1:
                folders[words[-1]].record("finished")

    launched_by(launch, monkeypatch)
    with planned(*SWEPT, "logger=none", "seed=0,1,2") as (sweep, jobs):
        folders = {one.overrides[-1]: one.folder for one in jobs}
        assert sweep.launches.run(jobs) == []
    assert rounds == [["seed=0", "seed=1", "seed=2"], ["seed=1", "seed=2"], ["seed=0"]]
    told = [r.getMessage() for r in caplog.records if "was killed" in r.getMessage()]
    assert told == ["a worker was killed: the command starts 3 runs again"]


@pytest.mark.parametrize(("signum", "told"), [(None, 1), (signal.SIGINT, 0)])
def test_what_a_signal_breaks_in_the_launcher_is_not_an_error(
    signum, told, workplace, monkeypatch, caplog
):
    """Workers that are interrupted while they start cannot read their task."""

    def launch(_):
        monkeypatch.setattr(stopping, "requested", lambda: signum)
        raise RuntimeError("A task has failed to un-serialize")

    launched_by(launch, monkeypatch)
    with planned(*SWEPT, "logger=none", "seed=0,1") as (sweep, jobs):
        assert sweep.launches.run(jobs) == []
    assert caplog.text.count("no run was started") == told


@pytest.mark.parametrize(
    ("moment", "finished"), [pytest.param("before", 0, marks=pytest.mark.slow), ("after", 1)]
)
def test_a_signal_beside_the_training_ends_the_sweep_and_keeps_what_is_finished(
    moment, finished, workplace, store, monkeypatch, capsys
):
    """Before a job begins, or while its results go to the store: the command sums up as usual."""
    changed, published, words = job.changed_recordings, MlflowView.publish, [*SWEPT, "seed=0,1"]

    def changed_stopped(*given, **options):
        os.kill(os.getpid(), signal.SIGINT)
        return changed(*given, **options)

    def published_stopped(view, folder):
        if folder.outcome().status == "finished":
            os.kill(os.getpid(), signal.SIGINT)
        return published(view, folder)

    with monkeypatch.context() as patch:
        if moment == "before":
            patch.setattr(job, "changed_recordings", changed_stopped)
        else:
            patch.setattr(MlflowView, "publish", published_stopped)
        assert main(words) == 130
    known = {path: path.stat().st_mtime_ns for path in workplace.rglob("metrics.json")}
    assert len(known) == finished
    assert capsys.readouterr().out.count("\nwaiting: seed=") == 2 - finished

    assert main(words) == 0  # the rest, and what the store lacks
    assert known == {path: path.stat().st_mtime_ns for path in known}
    client = connect(store)
    runs = client.search_runs([client.get_experiment_by_name("study").experiment_id])
    assert [run.info.status for run in runs] == ["FINISHED"] * 3  # with the sweep


def test_a_signal_while_a_job_is_built_is_not_taken_for_bad_input(workplace, monkeypatch):
    """Libraries answer an interruption of theirs with an error of their own."""
    build = parts.build

    def build_stopped(settings, folder):
        if folder.outcome().status == "running":  # not when the command checks the job
            try:
                os.kill(os.getpid(), signal.SIGINT)
            except BaseException as error:
                raise KeyError("flag") from error
        return build(settings, folder)

    monkeypatch.setattr(parts, "build", build_stopped)
    assert main([*SWEPT, "logger=none", "seed=0"]) == 130
    (outcome,) = (RunFolder(file.parent).outcome() for file in workplace.rglob("outcome.json"))
    assert (outcome.status, outcome.reason) == ("interrupted", "interrupted by SIGINT")


@pytest.mark.parametrize(
    ("error", "told"),
    [
        (OSError(28, "No space left on device"), ("failed", "OSError: [Errno 28] No space left")),
        (Interrupted(signal.SIGINT), ("interrupted", "interrupted by SIGINT")),
    ],
)
def test_a_sweep_that_ends_early_tells_why_in_words(error, told, tmp_path):
    """Not in the notation of Python."""
    one = Job("seed=0", [], None, {}, {}, RunFolder(tmp_path / "run"))
    with pytest.raises(type(error)), parent([one], "sweep", "", Nowhere()):
        raise error
    (folder,) = map(RunFolder, (tmp_path / ".sweeps").iterdir())
    assert folder.outcome().status == told[0]
    assert folder.outcome().reason.startswith(told[1])


def test_a_sweep_ends_with_its_table_on_a_disk_that_has_become_full(tmp_path, caplog):
    one = Job("seed=0", [], None, {}, {}, RunFolder(tmp_path / "run"))
    one.folder.write_measures({"test_mse": 1.0})
    with contextlib.ExitStack() as stack, parent([one], "sweep", "", Nowhere()):
        stack.enter_context(no_file_larger_than(5))
    (folder,) = map(RunFolder, (tmp_path / ".sweeps").iterdir())
    assert folder.outcome().status == "waiting"
    assert "(failed: 1 of 1 runs failed) cannot be written" in caplog.text


def test_a_killed_run_on_a_full_disk_is_left_to_the_next_command(tmp_path):
    folder = RunFolder(tmp_path / "run")
    folder.record("running")
    with no_file_larger_than(5):
        end(folder, None, "failed", DIED)
    assert folder.outcome().status == "waiting"


def test_an_output_folder_on_a_full_disk_is_refused(tmp_path):
    check_folder(tmp_path / "outputs")
    with (
        no_file_larger_than(5),
        pytest.raises(ConfigError, match=r"written .*output_dir"),
    ):
        check_folder(tmp_path / "outputs")
