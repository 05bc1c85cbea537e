"""Machines that turn freely: properties that their recordings show, and their candidates."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch

from symo_exp.data.weak import quasi_coordinates
from symo_exp.errors import ConfigError
from symo_exp.identify.structures import ladder
from symo_exp.identify.variations import variations
from symo_exp.mechanics.types import Coordinates, Trajectories
from symo_exp.systems.simulation import Solver, simulate
from symo_exp.systems.table import system as stated
from tests.data.small import write_recordings
from tests.jobs import planned
from tests.logs import examined

H = 0.01
FREE = Coordinates.of(("x", "y", "z"), (False,) * 3, ("R",), [(0, 0)])


@cache
def motions(name: str, count: int = 8, steps: int = 150) -> Trajectories:
    """Motions of a system under inputs that differ from node to node."""
    system = stated(name, time_step=H)
    q, v, u = system.points(count, seed=1)
    t = torch.arange(steps + 1).double()
    phases = torch.arange(count * u.shape[1]).view(count, 1, -1)
    swings = 1.0 + 0.5 * torch.sin(0.15 * t[None, :, None] + phases)
    return simulate(system, q, v, u.unsqueeze(1) * swings, steps, Solver())


def logged(name: str) -> pd.DataFrame:
    """Return the table of the motions of a system, without velocities."""
    write_recordings(Path("log.parquet"), motions(name), stated(name).coordinates, H)
    table = pd.read_parquet("log.parquet")
    return table[[c for c in table if not c.startswith("v_")]]


@pytest.mark.parametrize("name", ["rigid_body", "spherical_pendulum", "quadrotor"])
def test_a_rotation_and_what_moves_it_are_found_in_a_table(name: str, workplace: Path) -> None:
    system = stated(name)
    found = examined(logged(name))
    assert found.coordinates.names == system.coordinates.names
    assert "system.rotations=[R]" in found.settings or 'system.rotations=["R"]' in found.settings
    assert found.body
    assert found.learned_inputs == system.input_matrix.shape[1]
    assert found.explained > 0.99
    assert found.stiffness is None


def test_known_inputs_show_the_mass_and_the_radius_of_gyration_of_a_body(workplace: Path) -> None:
    system = stated("quadrotor")
    matrix = system.input_matrix.tolist()
    found = examined(logged("quadrotor"), input_matrix=matrix)
    assert found.body
    assert found.learned_inputs == 0
    (mass,) = (x.partition("=")[2] for x in found.settings if "initial_inertia" in x)
    assert float(mass) == pytest.approx(system.mass, rel=0.1)
    gyration = (np.mean(system.inertia) / system.mass) ** 0.5
    assert found.radius == pytest.approx(gyration, rel=0.3)


def test_the_time_step_resolves_a_fast_spin(workplace: Path) -> None:
    t = np.arange(0.0, 4.0, 0.001)
    for rate, step in ((5.0, 0.02), (60.0, 0.01), (200.0, 0.002)):
        quaternion = [np.cos(rate * t / 2), 0 * t, 0 * t, np.sin(rate * t / 2)]
        columns = dict(zip((f"q_R_{part}" for part in "wxyz"), quaternion, strict=True))
        found = examined(pd.DataFrame({"t": t, **columns}))
        assert found.time_step == step


def test_several_bodies_need_the_matrix_of_their_inputs(workplace: Path) -> None:
    table = logged("rigid_body")
    for part in "wxyz":
        table[f"q_S_{part}"] = table[f"q_R_{part}"]
    with pytest.raises(ConfigError, match=r"system\.input_matrix"):
        examined(table)
    table = table[[c for c in table if not c.startswith("u_")]]
    found = examined(table)
    assert (len(found.coordinates.rotations), found.body) == (2, False)
    assert {c.settings["lagrangian"] for c in ladder(found)} == {"network"}


def test_angles_beside_a_rotation_need_the_matrix_of_their_inputs(workplace: Path) -> None:
    table = logged("quadrotor").rename(columns={"q_z": "q_theta"})
    with pytest.raises(ConfigError, match=r"system\.input_matrix"):
        examined(table)


def test_a_quaternion_that_is_none_is_refused(workplace: Path) -> None:
    table = logged("rigid_body")
    table["q_R_w"] *= 1.1
    with pytest.raises(ConfigError, match="expected a unit quaternion"):
        examined(table)


@pytest.mark.parametrize(("name", "known"), [("rigid_body", False), ("quadrotor", True)])
def test_every_candidate_and_kind_of_variation_can_be_built(
    name: str, known: bool, workplace: Path
) -> None:
    matrix = stated(name).input_matrix.tolist() if known else None
    found = examined(logged(name), input_matrix=matrix)
    given = [f"system.input_matrix={str(matrix).replace(' ', '')}"] if known else []
    given += ["preset=recorded", "data=recorded", "system=recorded", "data.path=mine.csv"]
    tried = [{*one.overrides()} for one in ladder(found)]
    for one in ladder(found):
        for words in ({*x.overrides()} for x in variations(one, found)):
            if words - {*one.overrides()} - set().union(*tried):
                tried.append(words)  # a variation that has a setting of its own
    for words in tried:
        with planned(*given, *found.settings, *sorted(words), "logger=none") as (sweep, jobs):
            sweep.check(jobs)


def test_quasi_coordinates_are_sums_of_turns_and_of_steps_in_body_axes() -> None:
    """A body that turns about a fixed axis and moves along an axis of its own."""
    t = np.arange(400) * H
    angle = 3.0 * t
    zero, one, cos, sin = 0 * t, 1 + 0 * t, np.cos(angle), np.sin(angle)
    place = np.stack([sin / 3.0, (1.0 - cos) / 3.0, zero], axis=1)  # its velocity is (cos, sin, 0)
    turn = np.stack([cos, -sin, zero, sin, cos, zero, zero, zero, one], axis=1)
    path = quasi_coordinates(np.concatenate([place, turn], axis=1), FREE)
    np.testing.assert_allclose(path[:, 5], angle, atol=1e-9)  # beyond a turn
    np.testing.assert_allclose(path[:, 0], t, rtol=1e-3)
    np.testing.assert_allclose(path[:, 1:5], 0.0, atol=1e-9)
