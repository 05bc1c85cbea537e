"""What a user adds is one class and one file each, found in a folder of the user's own."""

import json

import pytest
import torch

import symo_exp
from symo_exp.__main__ import main
from symo_exp.errors import ConfigError
from symo_exp.runs.folder import About
from symo_exp.sweep.recipe import build, run
from tests.jobs import job_of, refusal
from tests.tiny import TINY

CLASSES = '''
from dataclasses import dataclass
from typing import Annotated

import torch

from symo_exp.evaluation.study import Finding, afresh
from symo_exp.mechanics.explicit import RungeKutta
from symo_exp.mechanics.types import Coordinates
from symo_exp.models.learner import Learner
from symo_exp.models.l_node import LNODE
from symo_exp.models.objectives import Objective, Residual, Residuals
from symo_exp.systems.base import LagrangianSystem


@dataclass(frozen=True, kw_only=True)
class Spring(LagrangianSystem):
    mass: Annotated[float, "kg"]
    stiffness: Annotated[float, "N/m"]
    coordinates = Coordinates(names=("x",), angular=(False,))
    input_matrix = torch.tensor([[1.0]], dtype=torch.float64)

    def mass_matrix(self, q):
        return torch.full_like(q, self.mass).unsqueeze(-1)

    def potential(self, q):
        return 0.5 * self.stiffness * q[:, 0] ** 2


class Heun(RungeKutta):
    def __init__(self):
        super().__init__(name="heun", order=2, a=((), (1.0,)), b=(0.5, 0.5), c=(0.0, 1.0))


class Scaled(Objective):
    def __init__(self, *, factor: float = 10.0) -> None:
        self.factor = factor

    def __call__(self, flow, windows):
        return Residuals(self.factor * Residual()(flow, windows).values)


class Renamed(LNODE):
    """A method: here one that exists, by another name."""


@dataclass(frozen=True, kw_only=True)
class Largest:
    name: str

    def __call__(self, model, system, data, *, remember=afresh):
        error = model.predict(data.test).q - data.test.q_next
        return Finding(measures={f"{self.name}_error": float(error.abs().max())})
'''
FILES = {
    "system/spring.yaml": """# @package _global_
# A mass on a spring.
system:
  _target_: mine.Spring
  time_step: 0.1 # s
  mass: 1.0 # kg
  stiffness: 2.0 # N/m
  box: {q: [[-1, 1]], v: [[-1, 1]], u: [[-1, 1]]}
""",
    "integrator/heun.yaml": """# Heun's method, order 2.
explicit: {_target_: mine.Heun}
variational: null
sensitivity: direct
""",
    "objective/scaled.yaml": "# The residual, ten times as large.\n_target_: mine.Scaled\n",
    "model/renamed.yaml": """# L-NODE by another name.
defaults: [l_node]
_target_: mine.Renamed
""",
    "study/largest.yaml": """# @package study.largest
# The largest error of a step.
_target_: mine.Largest
name: largest
""",
}
ADDED = {
    "system": "system=spring model=symo",
    "integrator": "integrator=heun model=node",
    "objective": "objective=scaled model=symo",
    "method": "model=renamed integrator=rk4",
    "measure": "study=largest model=node",
}
QUIET = [*TINY, "logger=none", "pictures=false"]


@pytest.fixture
def mine(workplace):
    folder = workplace / "mine_own"
    for name, text in FILES.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    (folder / "mine.py").write_text(CLASSES)
    return folder


@pytest.mark.parametrize("what", ADDED)
def test_one_class_and_one_file_is_all(what, mine):
    """Composed and checked as by a command, which `test_a_run_is_not_believed` gives."""
    job = job_of("--config-dir", "mine_own", "code=mine_own", *ADDED[what].split(), *QUIET)
    folder = job.folder.path
    run(build(job.config, job.folder), job.config, job.folder, About("a b", {}))
    found = json.loads((folder / "metrics.json").read_text())
    assert found["test_mse"] >= 0.0
    model = symo_exp.load(folder, code="mine_own")
    assert torch.isfinite(model.step(torch.zeros(1), torch.zeros(1)).q).all()
    if what == "measure":
        study = json.loads((folder / "studies" / "largest.json").read_text())
        assert study["measures"]["largest_error"] > 0.0


def test_they_are_listed(mine, capsys):
    assert main(["-h", "--config-dir", "mine_own"]) == 0
    assert "spring" in capsys.readouterr().out
    assert main(["--help", "--config-dir", "mine_own"]) == 0
    told = capsys.readouterr().out
    for name in ("spring", "heun", "scaled", "renamed", "largest"):
        assert name in told
    assert "A mass on a spring." in told


def test_without_a_word_nothing_of_it_runs(mine, workplace, capsys, monkeypatch):
    monkeypatch.setattr("symo_exp.code._folders", [])
    (mine / "mine.py").write_text("open('harm', 'w').close()\n")
    assert main(["--config-dir", "mine_own", "system=spring", "model=node", *QUIET]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "mine.Spring" in line
    assert "code=FOLDER" in line
    assert not (workplace / "harm").exists()


def test_a_run_is_not_believed_that_it_may_run_code(mine, workplace, monkeypatch):
    assert main(["--config-dir", "mine_own", "code=mine_own", "system=spring", *QUIET]) == 0
    (folder,) = (workplace / "outputs" / "default").glob("*-*")
    monkeypatch.setattr("symo_exp.code._folders", [])
    with pytest.raises(ConfigError, match=r"code=FOLDER"):
        symo_exp.load(folder)


@pytest.mark.parametrize(("word", "wanted"), [("code=nowhere", "not a folder"), ("code=3", "code")])
def test_a_folder_that_is_none(word, wanted, workplace):
    assert wanted in refusal(word, "model=node", *QUIET)


def test_only_what_the_folder_defines_may_be_named(mine):
    (mine / "subprocess.py").write_text("")  # a name is not enough
    text = FILES["objective/scaled.yaml"].replace("mine.Scaled", "subprocess.Popen")
    (mine / "objective" / "scaled.yaml").write_text(text)
    words = ["--config-dir", "mine_own", "code=mine_own", "objective=scaled", "model=symo"]
    assert "refused" in refusal(*words, *QUIET)
