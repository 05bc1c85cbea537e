"""The command line: help, refusals, single runs, exit codes."""

import contextlib
import io
import shutil
import subprocess
import sys
import time

import pytest

from symo_exp.__main__ import main
from symo_exp.cli.command import CHECK_ONLY, Command
from symo_exp.cli.help import EXAMPLES
from symo_exp.runs.folder import RunFolder
from symo_exp.shipped import CONF, SWEEPS
from symo_exp.sweep.launching import Launches
from symo_exp.sweep.sweeper import watched
from tests.jobs import jobs_of, refusal, settings_of
from tests.pages import ROOT
from tests.tiny import TINY

QUIET = [*TINY, "logger=none", "pictures=false"]
LIGHT = (
    "import sys; from symo_exp.__main__ import main; code = main(sys.argv[1:]); "
    "heavy = {'torch', 'lightning', 'mlflow', 'pandas', 'matplotlib'} & set(sys.modules); "
    "sys.exit(f'{code} {heavy}' if code or heavy else 0)"
)
"""A command in a process that ends well only if nothing heavy was imported."""

# what is typed, and words that the one line of the answer must have
BAD = [
    # keys
    ("data.ntraj=8", "data.ntraj", "data.n_traj"),
    ("n_traj=8", "n_traj", "data.n_traj"),
    ("modle=symo", "modle", "model"),
    ("+data.x=1", "data.x", "n_traj"),
    ("+optimizer.learning_rate=1", "optimizer.learning_rate", "lr"),
    ("+root.training.stoping=row", "root.training.stoping", "root.training.stopping"),
    ("+nonsense.deep.inside=1", "nonsense", "--cfg job shows all"),
    ("+data.solver.metod=RK45", "data.solver.metod", "data.solver.method"),
    ("hydra.sweep.dirr=x", "dirr", "did you mean hydra.sweep.dir"),
    ("gradient_clip=1", "gradient_clip", "write learner.gradient_clip="),
    ("model.width=1", "model.width", "write net.width="),
    ("optimizer.betas=[0.9,0.99]", "optimizer.betas", "write +optimizer.betas="),
    ("data.path=a.csv", "data.path is not a setting", "it belongs to data=recorded"),
    ("model=node model.inputs=learned", "model.inputs", "it belongs to model=symo"),
    ("preset=joints optimizer=lbfgs", "LBFGS does not", "~optimizer.shortest ~optimizer.huber"),
    ("preset=thesis lagrangian=known", "lagrangian.initial_inertia", "KnownLagrangian does not"),
    # choices
    ("model=symoo", "symoo", "e2e_symo, l_node, node, residual, symo"),
    ("system=pendulun", "pendulun", "did you mean pendulum"),
    ("integrator=rk5", "rk5", "galerkin6, midpoint"),
    *((f"integrator={x}", f"integrator={x}", "possible: dopri5") for x in ("null", "3", "[rk4]")),
    ("study=[1,2]", "study=[1,2]", "none, test_trajectory"),
    ("study=[]", "study=[]", "none, test_trajectory"),
    ("study=forced study.forced=null", "forced: ", "a class (_target_)"),
    ("+model=symo", "+model=", "leave out the +"),
    ("hydra/launcher=jobli", "jobli", "joblib"),
    ("dtype=float16", "float16", "float32, float64"),
    ("learner.scheduler_monitor=loss", "monitor=loss", "train_loss or val_loss"),
    ("root.training.stopping=never", "never", "row or batch"),
    ("model=node integrator.sensitivity=magic", "magic", "direct or adjoint"),
    ("data.monitor=train", "data.monitor=train", "val, test or held_out"),
    ("trainer.accelerator=tpu", "tpu", "cpu or gpu"),
    ("objective=smoothing learner.validation.iterations=-1", "iterations=-1", "of at least 0"),
    *(
        (f"objective=smoothing learner.validation.horizons={times}", "horizons=[", "that rise")
        for times in ("[]", "[1,0.5]", "[0.5,3]", "[a]", "[0,1]")
    ),
    (
        "objective=horizon learner.validation.horizons=[1]",
        "learner.validation.horizons is not a setting",
        "write +learner.validation.horizons=",
    ),
    ("objective=smoothing optimizer.starts=-1", "optimizer.starts=-1", "from 0 to"),
    ("objective=smoothing optimizer.velocity_weight=0", "velocity_weight=0", "above 0"),
    *((f"objective=smoothing optimizer.seed={x}", f"seed={x}", "0 to") for x in (-1, 10**20)),
    ("objective=smoothing trainer=gpu", "TotalLeastSquares", "trainer=cpu"),
    *(
        (f"optimizer=adam_then_lm dtype=float64 optimizer.{x}", given, wanted)
        for x, given, wanted in [
            ("first._target_=torch.optim.LBFGS", "optimizer.first is LBFGS", "torch.optim.Adam"),
            (
                "first._target_=symo_exp.optim.lbfgs.LBFGS ~optimizer.first.lr",
                "optimizer.first is LBFGS",
                "torch.optim.Adam",
            ),
            (
                "then._target_=torch.optim.Adam ~optimizer.then.patience",
                "optimizer.then is Adam",
                "EpochOptimizer",
            ),
            (
                "then._target_=symo_exp.optim.total_least_squares.TotalLeastSquares "
                "~optimizer.then.patience",
                "optimizer.then is TotalLeastSquares",
                "optimizer=total_least_squares",
            ),
        ]
    ),
    # values
    ("data.n_traj=0", "0", "1 to 128"),
    ("~resume", "resume", "cannot be deleted"),
    ("~model", "~model", "possible: e2e_symo"),
    ("~model=node", "~model", "possible: e2e_symo"),
    ("++model=node", "++model=node", "leave out the +"),
    ("~seed", "seed", "cannot be deleted"),
    ("~nothing", "~nothing", "--cfg job shows all"),
    ("~trainer.nothing", "~trainer.nothing", "--cfg job shows all"),
    ("+seed=1", "+seed=1", "leave out the +"),
    ("-m +trainer.max_epochs=1,2", "+trainer.max_epochs=1", "leave out the +"),
    ("-m seed=1,", "seed=1,", "write seed=A,B without spaces"),
    ("-m seed=range(3,0)", "seed=range(3,0)", "range(start,stop,step)"),
    *(
        (f"{x}=1000000000000", f"{x.split()[-1]}=1", "from 1 to")
        for x in (
            "data.n_test",
            "data.integration_steps",
            "system=chain system.links",
            "study=long_term study.long_term.steps",
        )
    ),
    ("data.n_traj=129", "129", "data.n_train_max=129"),
    ("data.n_traj=8.5", "8.5", "whole number"),
    ("data.n_traj=null", "null", "whole number"),
    ("data.noise_std=-1", "-1", "at least 0"),
    ("data.noise_std=nan", "nan", "finite number"),
    ("data.batch_size=0", "0", "at least 1"),
    ("data.shuffle=perhaps", "perhaps", "true or false"),
    ("data.solver.rtol=-1", "data.solver.rtol=-1", "at least 1e-12"),
    ("trainer.max_epochs=0", "0", "at least 1"),
    ("trainer.validate_every=0", "0", "at least 1"),
    ("trainer.threads=0", "trainer.threads=0", "from 1 to"),
    ("trainer.checkpoint_every=-1", "-1", "seconds"),
    ("trainer.time_limit=-1", "trainer.time_limit=-1", "above 0"),
    ("trainer.time_limit=[1,2]", "trainer.time_limit=[1, 2]", "a number"),
    ("learning_rate=[1]", "learning_rate=[1]", "a number"),
    ("system.viscous=3", "system.viscous=3", "a list"),
    ("system.viscous={a:1}", "system.viscous={a: 1}", "a list"),
    ("model.integrator=3", "model.integrator=3", "a class (_target_)"),
    ("learner.validation=[1,2]", "learner.validation=[1, 2]", "a class (_target_)"),
    *((f"{x}=inf", f"{x}=inf", "finite") for x in ("learning_rate", "root.rollout.tolerance")),
    ("scheduler.factor=0", "scheduler.factor=0", "above 0"),
    ("scheduler.patience=-1", "scheduler.patience=-1", "at least 0"),
    *((f"+scheduler.{x}=-1", f"scheduler.{x}=-1", "at least 0") for x in ("threshold", "min_lr")),
    ("+scheduler.mode=max", "scheduler.mode='max'", "min"),
    ("+optimizer.betas=[0.9]", "optimizer", "list index out of range"),
    ("scheduler=cosine scheduler.T_max=0", "scheduler.T_max=0", "at least 1"),
    ("hydra.job.chdir=true", "hydra.job.chdir=true", "leave it out"),
    ("hydra.mode=RUN", "hydra.mode=RUN", "leave it out"),
    *((f"hydra.sweeper.params={x}", f"params={x}", "{seed: '0,1,2'}") for x in ("5", "0", "[1]")),
    ("+hydra.sweeper.params={1:2}", "params={1: 2}", "{seed: '0,1,2'}"),
    ("hydra/launcher=joblib hydra.launcher.n_jobs=0", "n_jobs=0", "-1 for one on each core"),
    ("optimizer.lr=-1", "-1", "learning rate"),
    ("optimizer._target_=torch.optim.LBFGS ~optimizer.fused", "LBFGS", "optimizer=lbfgs"),
    ("springs=linear springs.start=[[1e400]]", "springs.start=", "finite"),
    ("net.width=0", "width=0", "at least 1"),
    ("net.depth=0", "depth=0", "at least 1"),
    ("net.depth=5000000000000000000", "model", "MemoryError"),
    ("net=[]", "net: ", "a mapping with a list"),
    *((f"net={x}", "net is not one value", "give the settings of net, ") for x in ("3", "null")),
    ("springs={a:1}", "springs={a: 1}", "a class (_target_)"),
    ("study={a:1}", "study.a is not a setting", "nothing"),
    ("seed=${nowhere}", "seed refers to nowhere", "--cfg job"),
    ("~net.width", "lagrangian.width refers to net.width", "deleted by ~net.width"),
    ("~net.width=8", "~net.width=8: its value is 128", "write ~net.width"),
    ("hydra.sweep.subdir=${hydra.job.num}", "hydra.sweep.subdir refers to hydra.job.num", "--cfg"),
    ("root.training.tolerance=0", "0", "tolerance=0: expected"),
    ("root.training.max_iterations=0", "0", "max_iterations=0: expected"),
    ("system.mass=-1", "system.mass=-1", "above 0"),
    ("system.time_step=0", "system.time_step=0", "above 0"),
    ("seed=-1", "seed=-1", "from 0 to"),
    ("seed=first", "first", "whole number"),
    # combinations
    ("model=symo integrator=rk4", "integrator=rk4", "integrator=midpoint"),
    ("data=recorded", "data.path", "give it one: data.path=..."),
    ("data=recorded data.path=nowhere.csv", "nowhere.csv", "No such file"),
    ("system=recorded", "system.time_step", "give it one: system.time_step=..."),
    ("system=recorded system.time_step=0.1", "system=recorded", "data=recorded data.path=FILE"),
    ("system=recorded system.time_step=0.1 data=recorded data.path=no.csv", "no.csv", "No such"),
    ("data=recorded data.path=nowhere.csv data.columns=t", "data.columns=t", "a mapping"),
    ("data.dtype=float64", "data.dtype=float64", "give dtype=float64"),
    # places
    ("output_dir=/dev/null/here", "/dev/null", "choose another output_dir"),
    ("logger.tracking_uri=http://127.0.0.1:9", "127.0.0.1:9", "correct logger.tracking_uri"),
    ("logger.tracking_uri=sqlite:////dev/null/x/y.db", "/dev/null", "not writable"),
    ("logger.tracking_uri=carrier://pigeon", "carrier", "sqlite"),
    # what a configuration must not run
    ("model._target_=os.system", "os.system", "it may name a class of"),
    ("model._target_=symo_exp.files.os.system", "os.system", "refused"),
    ("optimizer._target_=torch.hub.load", "torch.hub.load", "refused"),
    ("optimizer._target_=torch.optim.Adom", "Adom", "cannot be found"),
    # the last job of a sweep
    ("-m data.n_traj=8,16,0", "data.n_traj=0", "1 to 128"),
    ("-m data.n_traj=8 model=node,symo integrator=rk4", "model=symo", "integrator=midpoint"),
    ("-m data.n_traj=8,16,8", "data.n_traj=8,16,8", "8 is given twice"),
    ("-m data.n_traj=8,16 seed=0,0", "seed=0,0", "0 is given twice"),
    ("-m trainer.progress=true,false", "trainer.progress=", "same run"),
    ("-m data.noise_std=interval(0,1)", "interval(0,1)", "range(...)"),
    *(
        (f"-m {x}", x, "range(start,stop,step)")
        for x in ("seed=range(0,3,0)", "net.width=range(0,3,0.0)", "seed=shuffle(range(0,3,0))")
    ),
    ("-m model=node,symoo", "model=symoo", "did you mean symo"),
    ("-m model=glob(x*)", "model=glob(x*)", "-h lists"),
    ("-cn smoke data.noise_std=0,-1", "noise_std=-1", "at least 0"),
]


ENDS = [
    ("--foo", "--foo", "-h"),
    ("--cfg jobs", "jobs", "hydra"),
    ("--info everything", "everything", "defaults-tree"),
    ("-cn nothing", "nothing", "possible: accuracy"),
    ("-cn sweeps/smoke", "sweeps/smoke", "possible: accuracy"),
    ("-sc query=bash", "query", "leave it out"),
    ("--config-dir nowhere", "nowhere", "not found"),
    ("data.n_traj", "data.n_traj", "data.n_traj="),
    ("-m model,integrator=[node,rk4],[symo,midpoint]", "model,integrator", "sweeps/tables.yaml"),
    ("hydra.sweeper=3", "hydra.sweeper=3", "hydra/sweeper=NAME"),
    ("-cn machine hydra.sweeper=null", "hydra.sweeper=null", "hydra/sweeper=NAME"),
    ("-m seed=0,1 hydra.launcher=joblib", "hydra.launcher=joblib", "hydra/launcher=NAME"),
    ("hydra.run.dir=mine", "hydra.run.dir=mine has no effect", "output_dir=FOLDER"),
    ("hydra.sweeper.check_only=perhaps", "check_only='perhaps'", "true or false"),
    ("-cn machine hydra.sweeper.clock=3", "hydra.sweeper.clock=3", "true or false"),
    ("model=node,symo model.sensitivity=adjoint", "model=symo: model.sens", "to model=l_node"),
    # composing, checking and building a job each find some
    *[row for row in BAD if row[0] in ("modle=symo", "+data.x=1", "-m data.n_traj=8,16,0")],
]  # fmt: skip
"""Errors of the command line itself, before there is a job, and some others."""


def nothing_is_left(workplace):
    return [*workplace.rglob("*.ckpt"), *workplace.rglob("*.npz")] == []


@pytest.fixture
def home(workplace, monkeypatch):
    monkeypatch.setenv("HOME", str(workplace))  # where the cache would be
    return workplace


@pytest.mark.parametrize(("typed", "given", "wanted"), BAD, ids=[typed for typed, *_ in BAD])
def test_bad_input_is_refused_in_a_line(typed, given, wanted, home):
    line = refusal(*typed.split())
    assert "\n" not in line
    assert given in line
    assert wanted in line
    assert nothing_is_left(home)


@pytest.mark.parametrize(("typed", "given", "wanted"), ENDS, ids=[typed for typed, *_ in ENDS])
def test_a_refusal_is_one_line_and_exit_code_2(typed, given, wanted, home, capsys, monkeypatch):
    monkeypatch.setattr(Launches, "run", lambda *_: pytest.fail("it started"))
    code = main(typed.split())
    out, err = capsys.readouterr()
    assert code == 2, err
    (line,) = err.strip().splitlines()
    assert line.startswith("symo_exp: error: ")
    assert given in line
    assert wanted in line
    assert out == ""
    assert nothing_is_left(home)


@pytest.mark.parametrize(
    ("typed", "named"),
    [("data.n_traj=0,8", "data.n_traj=0"), ("seed=0,1 data.n_traj=0", "seed=0: data.n_traj=0")],
)
def test_a_job_of_a_sweep_is_named_once(typed, named, home, capsys):
    assert main(["-m", *typed.split()]) == 2
    assert capsys.readouterr().err.startswith(f"symo_exp: error: {named}: expected ")


def test_a_refusal_does_not_depend_on_the_environment_of_hydra(home, capsys, monkeypatch):
    monkeypatch.setenv("HYDRA_FULL_ERROR", "0")
    assert main(["modle=symo"]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "did you mean model" in line


def test_a_setting_may_be_one_that_only_the_swept_choices_have(home):
    words = ["model=node,l_node", "model.sensitivity=adjoint", "net.width=2,4"]
    with watched() as folders:
        assert main([*QUIET, *words, CHECK_ONLY]) == 0
    assert len(folders) == 4


def test_a_pattern_stands_for_the_choices_that_it_fits(home):
    with watched() as folders:
        assert main([*QUIET, "model=glob([symo,l_n*])", CHECK_ONLY]) == 0
    assert len(folders) == 2


@pytest.mark.parametrize("flag", ["-h", "--help"])
def test_help_shows_every_choice_with_a_line(flag, workplace, capsys):
    assert main([flag]) == 0
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    for file in [*CONF.glob("*/*.yaml"), *SWEEPS.glob("*.yaml")]:
        assert any(line[0] == file.stem and len(line) > 2 for line in lines if line), file


def test_examples_of_the_help_start_runs_or_recordings():
    assert all(words[0] == "record" or Command(words).runs for words in EXAMPLES)
    assert any("data.path=mine.csv" in words for words in EXAMPLES)


@pytest.mark.parametrize("columns", [80, 100, 200])
def test_help_fits_the_terminal(columns, workplace, monkeypatch, capsys):
    """Lines are continued below their description; no word is lost."""
    assert main(["-h"]) == 0
    whole = capsys.readouterr().out
    monkeypatch.setenv("COLUMNS", str(columns))
    assert main(["-h"]) == 0
    told = capsys.readouterr().out
    assert told.split() == whole.split()
    assert max(map(len, told.splitlines())) <= columns


def test_help_and_settings_come_without_the_heavy_libraries(workplace):
    for words in (["-h"], ["model=node", "--cfg", "job"]):
        done = subprocess.run(
            [sys.executable, "-c", LIGHT, *words], capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
    assert "symo_exp.models.node.NODE" in done.stdout


def test_overrides_may_stand_on_both_sides_of_an_option():
    words = ["model=e2e_symo", "system=acrobot", "-m", "data.n_traj=8,16,32,64,128"]
    found = settings_of(*words)
    assert [config.data.n_traj for config in found] == [8, 16, 32, 64, 128]
    assert {config.model._target_ for config in found} == {"symo_exp.models.e2e_symo.E2ESyMo"}
    assert {config.system._target_ for config in found} == {"symo_exp.systems.acrobot.Acrobot"}
    labels = [job.label for job in jobs_of(*words)]
    assert labels == [f"data.n_traj={n}" for n in (8, 16, 32, 64, 128)]


def test_a_model_that_is_not_learned_is_measured_without_training(workplace):
    assert main(["model=true_variational", *QUIET]) == 0
    (folder,) = map(RunFolder, (workplace / "outputs" / "default").glob("*"))
    assert folder.measures()["inertia_mse"] == 0.0
    assert folder.measures()["test_mse"] > 0.0
    assert not (folder / "checkpoints").exists()


ONE = [*QUIET, "model=e2e_symo"]


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """Folder and output of a run."""
    place, said = tmp_path_factory.mktemp("finished"), io.StringIO()
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(said):
        patch.chdir(place)
        assert main(ONE) == 0
    return place, said.getvalue()


@pytest.fixture
def again(finished, workplace):
    """A copy of that place."""
    shutil.copytree(finished[0], workplace, dirs_exist_ok=True)
    (folder,) = (workplace / "outputs" / "default").glob("e2e_symo-pendulum-*")
    return folder


def test_a_run_ends_in_a_table_of_its_measures_and_its_folder(finished):
    place, said = finished
    header, row, units, line = said.rstrip().splitlines()
    assert header.split() == ["train", "test", "integration", "energy", "inertia", "time"]
    assert row.startswith("E2E-SyMo pendulum n=")
    assert "J²" in units
    (folder,) = (place / "outputs" / "default").glob("e2e_symo-pendulum-*")
    assert line == str(folder.relative_to(place))
    run = RunFolder(folder)
    assert run.outcome().status == "finished"
    assert "net.width=8" in run.about().variant


def test_every_file_of_a_run_is_in_the_documentation(finished):
    page = (ROOT / "docs" / "metrics.md").read_text(encoding="utf-8")
    (folder,) = (finished[0] / "outputs" / "default").glob("e2e_symo-pendulum-*")
    assert not {path.name for path in folder.glob("[!.]*") if f"`{path.name}" not in page}


def test_a_run_from_the_beginning_has_the_same_numbers_and_a_time_of_its_own(again):
    folder = RunFolder(again)
    before, hour = folder.measures(), 3600.0
    folder.record("interrupted", "interrupted by SIGINT", hour)
    assert main([*ONE, "resume=false"]) == 0
    assert folder.measures() == before
    assert 0.0 < folder.outcome().seconds < hour


def test_the_time_of_a_run_is_that_of_all_its_starts_without_that_of_waiting(again, monkeypatch):
    folder = RunFolder(again)
    before, hour = folder.outcome().seconds, 3600.0
    folder.record("interrupted", "interrupted by SIGINT", hour)
    waiting, alone, now = [], RunFolder.alone, time.perf_counter

    def alone_after_an_hour(self):
        waiting.append(hour)
        return alone(self)

    monkeypatch.setattr(RunFolder, "alone", alone_after_an_hour)
    monkeypatch.setattr(time, "perf_counter", lambda: now() + sum(waiting))
    assert main(ONE) == 0
    assert waiting
    assert folder.outcome().status == "finished"
    assert before + hour < folder.outcome().seconds < 2 * hour


def test_a_finished_command_ends_without_the_heavy_libraries(again):
    done = subprocess.run([sys.executable, "-c", LIGHT, *ONE], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_an_unforeseen_error_is_a_line_and_an_exit_code(workplace, capsys, monkeypatch):
    def broken(*_):
        raise ZeroDivisionError("oh")

    monkeypatch.setattr("symo_exp.job.recipe.evaluate", broken)
    assert main(["model=true_variational", *QUIET]) == 1
    out, err = capsys.readouterr()
    assert "ZeroDivisionError: oh" in err
    assert "Traceback" not in out + err
