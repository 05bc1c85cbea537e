"""Mechanisms written as MJCF and URDF have the same dynamics in MuJoCo."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from symo_exp.errors import ConfigError
from symo_exp.systems.mjcf import mjcf, urdf
from symo_exp.systems.mujoco import mujoco_dynamics, of_model
from symo_exp.systems.mujoco_library import library
from symo_exp.systems.multibody import Multibody
from tests.systems import models
from tests.systems.every import SYSTEMS, points
from tests.systems.models import compiled

mujoco = library()
MECHANISMS = {name: of_model(compiled(text), name) for name, text in models.MODELS.items()}


@pytest.mark.parametrize("name", MECHANISMS)
def test_a_written_mechanism_is_read_back(name):
    given = MECHANISMS[name]
    system = Multibody(mechanism=given, time_step=0.05)
    model = compiled(mjcf(given))
    q, v, u = points(system, 16)
    mass, rate = mujoco_dynamics(model, system, q, 3 * v, u)
    assert (system.mass_matrix(q) - mass).abs().max() < 1e-9 * mass.abs().max()
    assert (system.acceleration(q, 3 * v, u) - rate).abs().max() < 1e-9 * rate.abs().max()
    again = Multibody(mechanism=of_model(model, "again"), time_step=0.05)
    assert again.coordinates == system.coordinates
    assert again.inputs == system.inputs
    assert again.viscous == system.viscous


def test_damping_that_couples_joints_is_written():
    given = MECHANISMS["crane"]
    n = len(given["joints"])
    root = np.random.default_rng(0).normal(size=(n, n))
    damping = root @ root.T
    model = compiled(mjcf(given, damping=damping.tolist()))
    data = mujoco.MjData(model)
    model.jnt_stiffness[:] = 0.0
    data.qvel[:] = np.arange(n)
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.qfrc_passive, -damping @ data.qvel, rtol=1e-12, atol=1e-12)


def test_an_input_that_drives_several_joints_is_written():
    given = MECHANISMS["pendulums"]
    matrix = [[10.0, 0.0], [0.0, 1.0], [0.0, -2.0]]
    inputs = {"names": ["cart", "belt"], "matrix": matrix, "ranges": [[-1, 1], [-1, 1]]}
    model = compiled(mjcf(given | {"inputs": inputs}))
    data = mujoco.MjData(model)
    data.ctrl[:] = 0.3, 0.5
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.qfrc_actuator, np.array(matrix) @ [0.3, 0.5], atol=1e-12)


@pytest.mark.parametrize("name", ["pendulums", "arm_of_seven"])
def test_a_urdf_has_the_same_bodies(name):
    given = MECHANISMS[name]
    bare = [joint | {"armature": 0.0} for joint in given["joints"]]
    system = Multibody(mechanism=given | {"joints": bare}, time_step=0.05)
    model = compiled(urdf(given))
    q, v, _ = points(system, 16)
    none = torch.zeros(len(q), 0, dtype=torch.float64)
    mass, rate = mujoco_dynamics(model, system, q, v, none)
    assert (system.mass_matrix(q) - mass).abs().max() < 1e-9 * mass.abs().max()
    still = torch.zeros(len(q), system.input_matrix.shape[1], dtype=torch.float64)
    ours = system.acceleration(q, v, still)
    assert (ours - rate).abs().max() < 1e-9 * rate.abs().max()


@pytest.mark.parametrize("name", ["acrobot", "cartpole", "pendulum"])
def test_a_urdf_of_thin_rods_is_read(name):
    """They have no inertia about themselves, which MuJoCo refuses."""
    given = models.bodies_of(SYSTEMS[name])
    read = of_model(compiled(urdf(given)), "again")
    assert [joint["limits"] for joint in read["joints"]] == [None] * len(given["joints"])


@pytest.mark.parametrize("write", [mjcf, urdf])
@pytest.mark.parametrize("seed", range(20))
def test_flat_bodies_in_any_position_are_read(write, seed):
    """Their largest moment is the sum of the others, which rounding may exceed."""
    given = MECHANISMS["arm_of_seven"]
    turn = Rotation.random(random_state=seed).as_matrix()
    inertia = turn @ np.diag([0.003, 0.05, 0.053]) @ turn.T
    joints = [joint | {"inertia": inertia.tolist()} for joint in given["joints"]]
    found = compiled(write(given | {"joints": joints}))
    np.testing.assert_allclose(
        np.sort(found.body_inertia[1:])[:, ::2], [[0.003, 0.053]] * 7, rtol=1e-7
    )


def test_a_urdf_of_shifted_references_is_refused():
    with pytest.raises(ConfigError, match=r"write \.xml"):
        urdf(MECHANISMS["crane"])


@pytest.mark.parametrize(("dashes", "written"), [("--", "- -"), ("---", "- - -"), ("-", "-")])
def test_comments_are_written(dashes, written):
    text = mjcf(MECHANISMS["pendulums"], comments=[f"not here: a {dashes} network{dashes}"])
    assert f"<!-- not here: a {written} network{written} -->" in text
    compiled(text)
