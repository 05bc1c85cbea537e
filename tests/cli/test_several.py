"""A name that stands for several sweeps."""

import json
import re
import shlex
from pathlib import Path

import pytest

import symo_exp
from symo_exp.__main__ import main
from symo_exp.cli.command import CHECK_ONLY, Command
from symo_exp.errors import ConfigError
from symo_exp.shipped import SWEEPS
from symo_exp.sweep.launching import Launches
from symo_exp.sweep.sweeper import Sweep
from tests.jobs import job_of, jobs_of
from tests.tiny import TINY

ONE = """defaults: [config, {override logger: none}, _self_]
hydra: {sweeper: {params: {data.n_traj: "8,16"}}}
"""


@pytest.fixture
def folder(workplace):
    (workplace / "mine").mkdir()
    for name in ("a", "b"):
        (workplace / "mine" / f"{name}.yaml").write_text(ONE)
    (workplace / "mine" / "both.yaml").write_text("sweeps: [a, b]\n")
    return workplace / "mine"


@pytest.fixture
def started(monkeypatch):
    """The jobs that would be launched, sweep by sweep; they leave no outcome, so they fail."""
    found = []
    monkeypatch.setattr(Sweep, "check", lambda *_, **__: None)
    monkeypatch.setattr(Launches, "run", lambda _, jobs: found.append(len(jobs)) or [])
    return found


def test_the_thesis_is_all_sweeps_of_its_experiment():
    names = {command.name for command in Command(["-cn", "thesis"]).several()}
    added = Command(["--config-dir", "mine", "-cn", "thesis"]).several()
    assert {command.name for command in added} == names
    thesis = re.compile(r"experiment: thesis|^defaults:\s.*tables", re.MULTILINE)
    assert names == {file.stem for file in SWEEPS.glob("*.yaml") if thesis.search(file.read_text())}
    assert Command(["-cn", "tables"]).several() == Command([]).several() == []


def test_all_are_run_and_a_failure_does_not_stop_the_next(folder, started, capsys):
    assert main(["--config-dir", str(folder), "-cn", "both"]) == 1
    assert started == [2, 2]
    assert capsys.readouterr().out.count("== ") == 2


def test_a_search_by_another_sweeper_may_be_among_them(folder, started, monkeypatch, capsys):
    """Its trials are not known before it runs."""
    sweepers = pytest.importorskip("hydra_plugins.hydra_optuna_sweeper.optuna_sweeper")
    searched = []
    monkeypatch.setattr(
        sweepers.OptunaSweeper, "sweep", lambda *_, **__: searched.append(started[:])
    )
    search = ONE.replace("none}", "none}, {override hydra/sweeper: optuna}")
    (folder / "b.yaml").write_text(search.replace('"8,16"', "'choice(8,16)'"))
    assert main(["--config-dir", str(folder), "-cn", "both"]) == 1  # the jobs of a leave no outcome
    assert searched == [[2]]
    assert "error" not in capsys.readouterr().err


def test_the_command_line_narrows_them_all(folder):
    narrow = ["data.n_traj=8", "seed=0,1,2"]
    both = Command(["--config-dir", str(folder), "-cn", "both", *narrow]).several()
    assert [(one.name, one.overrides) for one in both] == [("a", narrow), ("b", narrow)]


@pytest.mark.parametrize(
    ("content", "wanted"),
    [("sweeps: [a, nothing]", "names the sweep nothing, which is not in"),
     ("sweeps: 3", "expected a list of names"), ("sweeps: []", "expected a list of names"),
     ("seed: 1", "both.yaml is not a sweep: expected defaults: [config, _self_]"),
     ("", "both.yaml is not a sweep"), ("sweeps: [both]", "names the sweep both"),
     ("sweeps: [a", "both.yaml cannot be read")],
)  # fmt: skip
def test_an_invalid_list_of_sweeps_is_refused(content, wanted, folder, started, capsys):
    (folder / "both.yaml").write_text(content)
    assert main(["--config-dir", str(folder), "-cn", "both.yaml"]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert wanted in line
    assert started == []


@pytest.mark.parametrize("name", ["tables", "config"])
def test_a_file_of_ones_own_does_not_hide_one_that_ships(name, folder, started, capsys):
    """Hydra would take the one that ships and not tell."""
    (folder / f"{name}.yaml").write_text(ONE)
    assert main(["--config-dir", str(folder), "-cn", "a"]) == 2
    assert f"{name}.yaml has the name of a file of symo_exp; rename it" in capsys.readouterr().err
    assert started == []


def test_shipped_sweeps_take_choices_from_a_folder_of_ones_own(folder):
    (folder / "model").mkdir()
    (folder / "model" / "mine.yaml").write_text("defaults: [node]\n")
    job = job_of("--config-dir", str(folder), "-cn", "smoke", "model=mine", "integrator=rk4",
                 "system=pendulum", "data.n_traj=2", "seed=0")  # fmt: skip
    assert job.choices["model"] == "mine"


def test_a_word_that_the_last_cannot_take_is_found_before_the_first(folder, started, capsys):
    (folder / "b.yaml").write_text(ONE.replace("data.n_traj", "data.n_trajs"))
    words = ["--config-dir", str(folder), "-cn", "both"]
    assert main(words) == 2
    assert "data.n_trajs" in capsys.readouterr().err
    with pytest.raises(ConfigError, match=r"data\.n_trajs"):
        symo_exp.run(*words)
    assert started == []


def test_a_signal_keeps_the_rest_away(folder, monkeypatch, capsys):
    given = []

    def interrupted(command, *extra):
        given.append([command.name, *extra])
        return 0 if extra else 130

    monkeypatch.setattr(Command, "execute", interrupted)
    words = ["--config-dir", str(folder), "-cn", "both"]
    assert main(words) == 130
    with pytest.raises(KeyboardInterrupt):
        symo_exp.run(*words)
    assert given == [["a", CHECK_ONLY], ["b", CHECK_ONLY], ["a"]] * 2


def test_a_sweep_and_each_of_its_jobs_say_the_command_that_repeats_them(folder):
    words = ["--config-dir", str(folder), "-cn", "a", *TINY[1:], "model=node", "pictures=false"]
    words += ["measures=false", "data.n_traj=2,3"]
    assert main(words) == 0

    def jobs(record):
        python, *typed = shlex.split(json.loads(record.read_text())["tags"]["symo_exp.command"])
        assert (python, typed[:2]) == ("python", ["-m", "symo_exp"])
        return {job.folder.path.name for job in jobs_of(*typed[2:])}

    runs = [*Path("outputs/default").glob("node-*")]
    assert len(runs) == 2
    for run in runs:
        assert jobs(run / "run.json") == {run.name}
    (sweep,) = Path("outputs/default/.sweeps").glob("*/run.json")
    assert jobs(sweep) == {run.name for run in runs}
