"""The settings, folder, variant and name of a job."""

import shlex

import pytest

from symo_exp.job.job import describe_job
from symo_exp.shell import text_value
from symo_exp.tracking.page import COMMAND
from tests.jobs import job_of, jobs_of, planned


def test_values_are_set_as_hydra_sets_them(workplace):
    """Files that the composer shares do not change the composed configuration."""
    words = ["model=node", "system=acrobot", "data.n_traj=8", "net.width=7", "seed=3",
             "optimizer.lr=1e-3", "data.solver={rtol: 1e-3}"]  # fmt: skip
    shared = jobs_of(*words, "learner.gradient_clip=1,2")
    alone = [job_of(*words, f"++learner.gradient_clip={x}") for x in (1, 2)]
    for one, other in zip(shared, alone, strict=True):
        assert one.settings == other.settings
        assert one.folder.path == other.folder.path


def test_a_folder_belongs_to_what_is_computed(workplace):
    def folder(*words):
        return job_of(*words).folder.path

    same = ["trainer.progress=false", "logger=none", "pictures=false", "study=[long_term,forced]"]
    assert folder("seed=1") == folder("seed=1", *same) == folder("-m", "seed=1")
    assert folder("data.noise_std=0") == folder("data.noise_std=0.0") == folder()
    names = [folder(), folder("seed=1"), folder("data.n_traj=8"), folder("optimizer.lr=1e-3")]
    assert len(set(names)) == len(names)


def test_an_output_folder_may_begin_with_the_home_of_the_user(workplace, monkeypatch):
    monkeypatch.setenv("HOME", str(workplace / "me"))
    job = job_of('output_dir="~/runs"', "experiment=mine")
    assert job.folder.path.parent == workplace / "me" / "runs" / "mine"
    assert job.folder.path.name == job_of().folder.path.name


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ([], ""),
        (["seed=1", "data.n_traj=8", "data.noise_std=1e-3", "model=node", "pictures=false"], ""),
        (["model=l_node", "integrator=rk4", "system=acrobot"], ""),
        (["preset=fast"], "fast"),
        (["preset=thesis", "trainer.max_epochs=3"], "thesis, trainer.max_epochs=3"),
        (["scheduler=cosine"], "scheduler=cosine"),
        (["learning_rate=1e-2"], "learning_rate=0.01"),
        (["learner.gradient_clip=null"], "learner.gradient_clip=null"),  # as it can be typed
        (["net.width=7", "data.n_test=9"], "data.n_test=9, net.width=7"),
        (
            ["-cn", "demo", "model=node", "data.n_traj=8", "hydra/launcher=basic"],
            "trainer.max_epochs=200",
        ),
    ],
)
def test_a_run_says_how_it_differs_from_what_ships(words, told, workplace):
    with planned(*words, "logger=none") as (_, (job,)):
        assert describe_job(job.settings, job.choices, job.overrides).variant == told


@pytest.mark.parametrize(
    ("varied", "name"),
    [
        ("", "SyMo acrobot n=16"),
        ("model,data.n_traj", "SyMo acrobot n=16"),
        ("seed,optimizer.lr", "SyMo acrobot n=16 seed=3 lr=1e-3"),
    ],
)
def test_a_run_is_named_by_what_its_sweep_varies(varied, name, workplace, monkeypatch):
    monkeypatch.setenv("SYMO_EXP_VARIED", varied)
    words = ["model=symo", "system=acrobot", "data.n_traj=16", "seed=3", "optimizer.lr=1e-3"]
    with planned(*words, "logger=none") as (_, (job,)):
        about = describe_job(job.settings, job.choices, words)
    assert about.name == name


@pytest.mark.parametrize("experiment", ["2024", "null", "with a space (1), and more"])
def test_a_run_of_a_search_tells_the_command_that_repeats_it(experiment, workplace):
    with planned("model=node", "seed=3", f"experiment={text_value(experiment)}") as (_, (job,)):
        assert job.values["experiment"] == experiment
        about = describe_job(job.settings, job.choices, [])
    again = job_of(*shlex.split(about.tags[COMMAND])[3:])
    assert again.settings == job.settings
    assert again.folder.path == job.folder.path
