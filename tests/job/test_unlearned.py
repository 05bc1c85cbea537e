"""Forces of a system that a model cannot learn are named before the training."""

import pytest

from symo_exp.__main__ import main
from symo_exp.evaluation.forces import unlearned_forces
from symo_exp.job.parts import build
from tests.jobs import job_of
from tests.tiny import TINY

QUIET = [*TINY, "logger=none", "pictures=false"]
SPRUNG = """<mujoco><worldbody><body>
  <joint name="a" axis="0 1 0" stiffness="2"/><geom pos="0 0 -0.5" size="0.1"/>
</body></worldbody></mujoco>
"""
ROTOR = """
from dataclasses import dataclass
from symo_exp.systems.pendulum import Pendulum

@dataclass(frozen=True, kw_only=True)
class Rotor(Pendulum):
    def input_force(self, input_matrix, q, u):
        return q.cos() * u
"""
FRICTION, SPRINGS = "learns no friction", "springs on angles"
INPUTS = "constant input matrix: give lagrangian=known"
TURNED = "--config-dir . code=. system=rotor"
MOTOR = "system=mujoco system.model=sprung.xml dissipation=viscous"


def test_a_run_says_that_it_learns_no_friction(workplace, capsys):
    words = ["system=pendulum", "system.viscous=[0.1]", "model=symo", *QUIET, "measures=false"]
    assert main(words) == 0
    assert FRICTION in "".join(capsys.readouterr())


@pytest.mark.parametrize(
    ("words", "lacks"),
    [
        ("model=symo system.viscous=[0.1]", [FRICTION]),
        ("model=symo system.viscous=[0.1] dissipation=viscous", []),
        ("model=l_node system.coulomb=[0.1]", [FRICTION]),
        ("model=node system.viscous=[0.1]", []),
        ("model=symo", []),
        (f"model=symo {TURNED}", [INPUTS]),
        (f"model=symo {TURNED} lagrangian=known dtype=float64", []),
        (f"model=node {TURNED}", []),
        (f"model=symo {MOTOR}", [SPRINGS]),
        (f"model=symo {MOTOR} springs=linear dtype=float64", []),
    ],
)
def test_forces_that_a_model_cannot_learn_are_named(words, lacks, workplace):
    (workplace / "sprung.xml").write_text(SPRUNG)
    (workplace / "rotor.py").write_text(ROTOR)
    (workplace / "system").mkdir()
    (workplace / "system" / "rotor.yaml").write_text(
        "# @package _global_\ndefaults: [pendulum]\nsystem: {_target_: rotor.Rotor}\n"
    )
    job = job_of(*words.split(), *QUIET)
    parts = build(job.values, job.folder)
    found = list(unlearned_forces(parts.model, parts.system))
    assert len(found) == len(lacks), found
    assert all(part in line for part, line in zip(lacks, found, strict=True))
