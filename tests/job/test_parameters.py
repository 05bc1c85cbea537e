"""A run with known equations keeps its parameters, their posterior, and its model in a file."""

import math
from pathlib import Path

import pytest
import torch

import symo_exp
from symo_exp.__main__ import main
from symo_exp.errors import ConfigError
from symo_exp.runs.folder import RunFolder
from tests.jobs import refusal
from tests.logs import pendulum_log

NOISE = 1e-3
LEARNED = [
    "model=symo", "lagrangian=known", "lagrangian.fixed=[gravity]", "objective=preconditioned",
    "integrator=galerkin4", "optimizer=levenberg_marquardt", "scheduler=none", "dtype=float64",
    "system=pendulum", "system.time_step=0.05", "system.mass=1.3", "system.viscous=[0.2]",
    "data=recorded", "data.path=mine.csv", "trainer.max_epochs=6", "logger=none", "pictures=false",
]  # fmt: skip


@pytest.fixture(scope="module")
def log():
    """Driven motions of a pendulum of 1 kg with friction 0.1 N m s, and noise."""
    return pendulum_log(0.1, 0.05, 60, NOISE).to_csv(index=False)


@pytest.fixture
def recordings(log, workplace):
    Path("mine.csv").write_text(log)
    return workplace


def test_known_equations_are_identified_from_recordings(recordings, capsys):
    assert main(LEARNED) == 0
    said = capsys.readouterr().out
    (path,) = (recordings / "outputs" / "default").glob("*-*")
    folder = RunFolder(path)
    rows = {row["name"]: row for row in folder.parameters()}
    for name, true in {"mass": 1.0, "length": 1.0, "theta.viscous_friction": 0.1}.items():
        row = rows[name]
        value, deviation = float(row["value"]), float(row["standard_deviation"])
        assert row["determined"] == "yes"
        assert value == pytest.approx(true, rel=0.05)
        assert 0.0 < deviation < 0.05 * true
        assert f"{name} " in said
    measures = folder.measures()
    assert 0.5 < measures["coverage_90_2s"] <= 1.0
    assert measures["width_90_2s"] > 0.0

    model = symo_exp.load(path)
    first, second = model.sample(2)
    assert not torch.equal(first.lagrangian.mass_matrix(torch.zeros(1, 1).double()),
                           second.lagrangian.mass_matrix(torch.zeros(1, 1).double()))  # fmt: skip
    lower, upper = model.rollout_interval([1.0], [0.0], steps=20)
    path_q = model.rollout([1.0], [0.0], steps=20).q
    assert lower.shape == (21, 1)
    assert bool(((lower <= path_q) & (path_q <= upper)).all())
    wider = model.rollout_interval([1.0], [0.0], steps=20, level=0.99)
    assert bool((wider.upper >= upper).all())

    mujoco = pytest.importorskip("mujoco")
    found = mujoco.MjModel.from_xml_path(str(symo_exp.export(path, recordings / "machine.xml")))
    assert found.body_mass[1] == pytest.approx(float(rows["mass"]["value"]))
    assert found.dof_damping[0] == pytest.approx(float(rows["theta.viscous_friction"]["value"]))


@pytest.mark.slow
def test_friction_that_a_system_does_not_have_is_learned(recordings):
    """From a start ten times too large, with forces as residuals at first."""
    replaced = "objective", "optimizer", "trainer.max", "system"
    words = [word for word in LEARNED if not word.startswith(replaced)]
    words += ["system=pendulum", "system.time_step=0.05", "system.mass=1.3", "objective=smoothing",
              "optimizer=total_least_squares", "optimizer.force_epochs=6", "optimizer.starts=1",
              "optimizer.start=10", "optimizer.epochs=3", "trainer.validate_every=5",
              "dissipation.missing=1.0"]  # fmt: skip
    assert main(words) == 0
    (path,) = (recordings / "outputs" / "default").glob("*-*")
    rows = {row["name"]: float(row["value"]) for row in RunFolder(path).parameters()}
    assert rows["mass"] == pytest.approx(1.0, rel=0.05)
    assert rows["theta.viscous_friction"] == pytest.approx(0.1, rel=0.05)
    assert rows["theta.dry_friction"] < 0.01


def test_a_system_without_equations_has_none_to_learn(recordings):
    words = [w for w in LEARNED if not w.startswith(("system", "lagrangian.fixed"))]
    words += ["system=recorded", "system.time_step=0.05", "system.angular=all"]
    assert "no known" in refusal(*words)


def test_a_model_without_a_posterior_has_no_interval(recordings):
    words = ["system=pendulum", "system.time_step=0.05", "data=recorded", "data.path=mine.csv",
             "model=node", "net.width=4", "trainer.max_epochs=1", "logger=none",
             "pictures=false"]  # fmt: skip
    assert main(words) == 0
    (path,) = (recordings / "outputs" / "default").glob("*-*")
    assert not (path / "parameters.csv").exists()
    with pytest.raises(ConfigError, match="no posterior"):
        symo_exp.load(path).rollout_interval([1.0], [0.0], steps=3)
    assert math.isfinite(float(symo_exp.load(path).rollout([1.0], [0.0], steps=3).q.sum()))
