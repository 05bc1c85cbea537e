"""Logs in any unit of length and force have equally good models."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from symo_exp.__main__ import main
from symo_exp.errors import ConfigError
from symo_exp.identify.recordings import examine
from symo_exp.identify.structures import ladder
from symo_exp.identify.table import unit_of_held_out
from symo_exp.identify.validation import fold_error
from symo_exp.mechanics.types import Coordinates
from symo_exp.runs.folder import RunFolder
from symo_exp.systems.recorded import Recorded
from tests.logs import examined, pushes

FACTORS = [(1.0, 1.0), (1e3, 1.0), (1e-6, 1e-6), (1e-5, 1.0), (0.03, 1e4)]
"""Units of a log: factors of lengths and of forces."""
REST = 0.1
"""Velocity below which dry friction fades [m/s]."""
SHORT = [
    "preset=recorded", "data=recorded", "system=recorded", "data.fold=[0,3]", "optimizer.start=20",
    "trainer.validate_every=${optimizer.epochs}", "trainer.compile=false",
    "pictures=false", "measures=false", "logger=none",
]  # fmt: skip
EPOCHS = 15
"""Of a stage, which has then converged, so that the start no longer matters."""


def sprung(length, force, h=0.02, steps=20):
    """Recordings of a mass on a spring, with a motor and friction."""
    t, rng = np.arange(0.0, 8.0, h), np.random.default_rng(0)
    u = pushes(t)
    x, v, path = 0.0, 0.0, []
    for now in u:
        path.append(x)
        for _ in range(steps):
            v += h / steps * (2.0 * now - 2.0 * v - 30.0 * x - 0.3 * np.tanh(100.0 * v)) / 1.3
            x += h / steps * v
    x = np.array(path) + 1e-4 * rng.normal(size=len(t))
    parts = np.repeat(np.arange(5), len(t) // 5)
    return pd.DataFrame({"trajectory": parts, "t": t, "q_x": length * x, "u_x": force * u})


def errors(length, force, folder):
    """Errors of the first two candidates on a fold, over the unit of length.

    Dry friction fades below the same velocity in all units, since it never becomes much sharper.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        machine, found = examined(sprung(length, force)), {}
        for k, candidate in enumerate(ladder(machine)[:2]):
            effort = f"optimizer.starts={candidate.starts}", f"optimizer.epochs={EPOCHS}"
            words = [*SHORT, "data.path=mine.csv", *machine.settings, f"experiment=of_{k}", *effort]
            rest = f"dissipation.rest_velocity={REST * length / machine.units.length}"
            assert main([*words, *candidate.overrides(), rest]) == 0
            (run,) = Path(f"outputs/of_{k}").iterdir()
            found[candidate.name] = fold_error(RunFolder(run)) * machine.units.length / length
    return found


@pytest.fixture(scope="module")
def in_metres(tmp_path_factory):
    return errors(1.0, 1.0, tmp_path_factory.mktemp("metres"))


@pytest.mark.slow
@pytest.mark.parametrize(("length", "force"), FACTORS[1:])
def test_a_log_in_any_unit_has_the_same_best_candidate_and_error(
    length, force, tmp_path, in_metres
):
    found, expected = errors(length, force, tmp_path), in_metres
    best = min(found, key=found.get)
    assert best == min(expected, key=expected.get) == "rigid links, springs"
    assert found[best] == pytest.approx(expected[best], rel=0.05)
    assert found[best] < 0.01
    if np.log10(length) % 3 == 0.0:  # the units of parameters have the same prefixes
        assert found == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize(("length", "force"), FACTORS)
def test_a_log_in_any_unit_is_of_order_one_in_the_units_of_its_parameters(length, force, workplace):
    frame = sprung(length, force)
    machine = examined(frame)
    units, settings = machine.units, dict(word.split("=") for word in machine.settings)
    assert 1 / 32 < np.ptp(frame.q_x) / units.length < 32
    inertia = float(settings["lagrangian.initial_inertia"])
    assert inertia * units.mass == pytest.approx(0.65 * force / length, rel=0.1)
    assert 0.01 <= inertia <= 100.0
    stiffness = machine.stiffness[0][0] * units.mass / units.time**2
    assert stiffness == pytest.approx(15.0 * force / length, rel=0.1)
    unseen = machine.unseen * units.length / length
    assert 0.95e-4 < unseen < max(1.1e-4, 1.1e-3 * np.std(sprung(1.0, 1.0).q_x))


@pytest.mark.parametrize("scale", [{"length": 1.0, "mass": 1.0}, {"time": 1e-3}, {"mass": 1e-9}])
def test_a_search_starts_in_the_units_that_are_given(scale, workplace):
    """A light slide, whose units would be another length and mass."""
    sprung(1e-6, 1e-12).to_csv("mine.csv", index=False)
    plain, found = (examine({"path": "mine.csv"}, scale=given) for given in ({}, scale))
    assert found.units == plain.units._replace(**scale)
    sizes = []
    for one in (plain, found):
        settings, units = dict(word.split("=") for word in one.settings), one.units
        inertia = float(settings["lagrangian.initial_inertia"]) * units.mass
        stiffness = one.stiffness[0][0] * units.size("N/m")
        sizes.append((inertia, stiffness, one.unseen * units.length))
        told = (settings.get(f"system.scale.{name}", "1") for name in units._fields)
        assert tuple(map(float, told)) == units
    assert sizes[1] == pytest.approx(sizes[0], rel=0.1)


@pytest.mark.parametrize("word", ["system.scale.length=0.01", "system.scale={length:0.01}"])
def test_a_search_says_which_units_it_was_given(word, workplace, capsys):
    sprung(1.0, 1.0).to_csv("mine.csv", index=False)
    words = ["-cn", "machine", "data.path=mine.csv", "hydra.sweeper.check_only=true"]
    assert main([*words, "logger=none", word]) == 0
    assert "units: parameters are learned in 0.01 m, 1 s and 1 kg\n" in capsys.readouterr().out


@pytest.mark.parametrize("start", [30.0, 1e3])
def test_where_a_length_is_counted_from_changes_nothing(start, workplace):
    """Absolute encoders of long axes count from afar."""
    frame = sprung(1.0, 1.0)
    frame.to_csv("near.csv", index=False)
    frame.assign(q_x=start + frame.q_x).to_csv("far.csv", index=False)
    near, far = (examine({"path": name}) for name in ("near.csv", "far.csv"))
    assert far.settings == near.settings
    assert far.explained == pytest.approx(near.explained, abs=1e-4)
    assert near.stiffness[0][0] > 1.0
    assert far.stiffness == ((0.0,),)  # its force would be huge there: a training finds it


@pytest.mark.parametrize("start", [100.0, 2e3])
def test_where_a_length_is_counted_from_changes_nothing_if_a_push_is_left_out(start, workplace):
    h, x, v, path = 0.01, 0.5, 0.0, []
    t = np.arange(0.0, 60.0, h)
    u = 2.0 * np.cos(3.1 * t)
    for force in u + 25.0 * np.sin(9.0 * t) * (np.abs(t - 30.3) < 0.3):
        path.append(x)
        v += h * (force - 0.3 * v - 36.0 * x)
        x += h * v
    noise = 1e-5 * np.random.default_rng(0).normal(size=len(t))
    found = []
    for place in 0.0, start:
        frame = pd.DataFrame({"t": t, "q_x": place + np.array(path) + noise, "u_x": u})
        frame.to_csv(f"{place}.csv", index=False)
        found.append(examine({"path": f"{place}.csv"}))
    near, far = found
    assert any(word.startswith("data.leave_out=") for word in near.settings)
    assert far.settings == near.settings
    assert far.explained == pytest.approx(near.explained, abs=1e-6)


def test_a_length_too_far_from_zero_is_refused_unless_it_never_moves(workplace):
    frame = sprung(1.0, 1.0)
    frame.assign(q_x=1e5 + frame.q_x).to_csv("mine.csv", index=False)
    with pytest.raises(ConfigError, match=r"q_x goes from 99999\.\d+ to 100000\.\d+, too far"):
        examine({"path": "mine.csv"})
    still = np.round(np.random.default_rng(0).normal(size=len(frame)), 1)
    assert examined(frame.assign(q_lift=1e5 + still, u_lift=0.0)).moves


@pytest.mark.parametrize(
    ("length", "force", "unit"),
    [(1.0, 1.0, "m"), (1e3, 1.0, "km"), (1e-6, 1e-6, "µm")],
)
def test_held_out_errors_are_in_the_unit_of_length_of_the_parameters(
    length, force, unit, workplace
):
    machine = examined(sprung(length, force))
    assert unit_of_held_out(machine.coordinates, machine.units) == unit
    both = Coordinates(("x", "theta"), (False, True))
    assert unit_of_held_out(both, machine.units) == f"{unit}, rad"


@pytest.mark.parametrize(
    ("name", "unit"), [("x_mm", "mm"), ("x [cm]", "cm"), ("x_m", "m"), ("x m", "m"), ("x", "m")]
)
def test_lengths_in_another_unit_by_their_names_are_told(name, unit, workplace):
    """Also if a setting gives the column another name."""
    sprung(1.0, 1.0).rename(columns={"q_x": f"q_{name}", "u_x": f"u_{name}"}).to_csv("mine.csv")
    mapped = {"q_slide": f"q_{name}", "u_slide": f"u_{name}"}
    for shown, columns in {name: None, "slide": mapped}.items():
        notes = examine({"path": "mine.csv", "columns": columns}).notes
        assert any(f"positions [{unit}]: {shown} (by names" in note for note in notes)
        told = f"they are in {unit}, and kg is N s^2/{unit}; convert them"
        assert any(told in note for note in notes) == (unit != "m")


@pytest.mark.parametrize(("decimals", "told"), [(0, True), (2, False)])
def test_lengths_in_whole_numbers_are_told(decimals, told, workplace):
    notes = examined(sprung(1e5, 1.0).round({"q_x": decimals})).notes
    assert any("lengths of x are whole numbers" in note for note in notes) == told


@pytest.mark.parametrize(("name", "degrees"), [("Winkel [°]", True), ("Winkel [rad]", False)])
def test_angles_in_degrees_by_their_names_in_the_file_are_read(name, degrees, workplace):
    """Though they move so little that nothing else shows it."""
    table = sprung(1.0, 1.0).rename(columns={"q_x": name})
    machine = examined(table, {"columns": {"q_a": name, "u_a": "u_x"}})
    assert machine.coordinates.angular == (True,)
    assert ("data.degrees=true" in machine.settings) == degrees


@pytest.mark.parametrize("scale", [{"length": 0.0}, {"length": "mm"}, {"size": 1.0}, 1e-3])
def test_a_scale_that_is_none_is_refused(scale):
    with pytest.raises(ConfigError, match=r"system\.scale.*expected"):
        Recorded(names=["x"], angular="none", time_step=0.01, scale=scale)


@pytest.mark.parametrize(
    ("factor", "name", "told"), [(1e3, "x", True), (1.0, "x", False), (1e3, "x_mm", False)]
)
def test_a_length_that_is_hardly_in_metres_is_told(factor, name, told, tmp_path):
    table = sprung(factor, 1.0).rename(columns={"q_x": f"q_{name}"})
    table.to_csv(tmp_path / "mine.csv", index=False)
    notes = examine({"path": tmp_path / "mine.csv"}, input_matrix=[[1]]).notes
    assert any("m, as its name states no unit" in note for note in notes) == told
