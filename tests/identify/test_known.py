"""The search for the constants of known equations."""

import json

import pytest

from symo_exp.__main__ import main
from symo_exp.errors import ConfigError
from symo_exp.identify.recordings import examine
from symo_exp.identify.structures import ladder, structures
from symo_exp.identify.variations import variations
from symo_exp.runs.folder import RunFolder
from symo_exp.systems.table import system as stated
from tests.logs import pendulum_log

NOISE = 1e-4
VISCOUS = 0.1


@pytest.fixture
def log(workplace):
    """Driven motions of a pendulum of 1 kg with friction, and noise."""
    found = pendulum_log(VISCOUS, 0.02, 150, NOISE)
    found.to_csv("log.csv", index=False)
    return found


def test_every_candidate_has_the_known_equations(log):
    system = stated("pendulum", mass=1.3, time_step=0.02)
    machine = examine({"path": "log.csv"}, known=system)
    assert machine.known
    assert machine.coordinates.names == system.coordinates.names
    assert not any(word.startswith("system.angular") for word in machine.settings)
    (first,) = structures(machine)
    tried = [*ladder(machine), *variations(first, machine)]
    assert len(tried) > 3
    assert {one.settings["lagrangian"] for one in tried} == {"known"}
    for one in tried:  # the start of one choice of friction is no setting of another
        own = one.settings["dissipation"] == "known"
        assert ("dissipation.missing" in one.settings) == own
        assert ("dissipation.start" in one.settings) != own


def test_an_input_against_the_equations_is_refused(log):
    log.assign(u_0=-log.u_0).to_csv("log.csv", index=False)
    with pytest.raises(ConfigError, match=r"u_0 acts in the other direction.*sign of its gear"):
        examine({"path": "log.csv"}, known=stated("pendulum", time_step=0.02))


def test_a_column_of_another_name_is_refused_with_a_setting_that_renames_it(log):
    log.rename(columns={"q_theta": "q_1"}).to_csv("log.csv", index=False)
    with pytest.raises(ConfigError, match=r"q_1 belongs to no.*'data.columns=\{q_theta: q_1\}'"):
        examine({"path": "log.csv"}, known=stated("pendulum", time_step=0.02))


def test_a_mapped_column_of_another_name_is_refused_with_a_setting_that_is_accepted(log):
    log.rename(columns={"q_theta": "place", "t": "clock"}).to_csv("log.csv", index=False)
    known, mapped = stated("pendulum", time_step=0.02), {"t": "clock", "q_1": "place"}
    with pytest.raises(ConfigError, match=r"'data.columns=\{t: clock, q_theta: place\}'"):
        examine({"path": "log.csv", "columns": mapped}, known=known)
    suggested = {"t": "clock", "q_theta": "place"}
    assert examine({"path": "log.csv", "columns": suggested}, known=known).known


@pytest.mark.parametrize(("own", "other"), [("q_theta", "q_arm"), ("u_0", "u_motor")])
def test_the_columns_of_another_machine_are_refused_with_the_system_that_takes_them(
    own, other, log
):
    log.rename(columns={own: other}).to_csv("log.csv", index=False)
    with pytest.raises(ConfigError, match=f"{other} belongs to no .*give system=recorded"):
        examine({"path": "log.csv"}, known=stated("pendulum", time_step=0.02))


@pytest.mark.slow
def test_one_command_finds_the_constants_of_known_equations(log, workplace, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(workplace / "cache"))
    words = ["-cn", "machine", "data.path=log.csv", "system=pendulum", "system.mass=1.3",
             "lagrangian=known", "lagrangian.fixed=[gravity]", "budget=10s", "hydra/launcher=basic",
             "logger=none", "hydra.sweeper.clock=false"]  # fmt: skip
    assert main(words) == 0
    best = RunFolder(workplace / "outputs" / "machine_log" / "best")
    rows = {row["name"]: float(row["value"]) for row in best.parameters()}
    assert rows["mass"] == pytest.approx(1.0, rel=0.02)
    assert rows["theta.viscous_friction"] == pytest.approx(VISCOUS, rel=0.05)
    plan = json.loads((workplace / "outputs" / "machine_log" / "plan.json").read_text())
    assert plan["names"][0] == "known equations"
