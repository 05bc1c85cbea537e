"""MuJoCo models: read completely, equal to MuJoCo's own numbers, or refused in one line."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml
from torch import Tensor

from symo_exp.data.datamodule import TrajectoryData
from symo_exp.errors import ConfigError
from symo_exp.runs.load import from_folder
from symo_exp.systems.chain import ChainPendulum
from symo_exp.systems.mjcf import mjcf as written
from symo_exp.systems.mjcf import urdf
from symo_exp.systems.mujoco import environment_mechanism, mujoco_dynamics, read_mechanism
from symo_exp.systems.mujoco_library import library
from symo_exp.systems.multibody import Multibody
from symo_exp.systems.simulation import Solver, simulate
from symo_exp.systems.table import system as stated
from symo_exp.use.environments import environment
from tests.systems import models
from tests.systems.every import FLAT, points
from tests.systems.models import compiled, mjcf, read
from tests.tables import CONF

mujoco = library()

ACROBOT = stated("acrobot")
OURS = FLAT | {f"chain_{n}": ChainPendulum(n, mass=0.7, length=0.8) for n in (1, 2, 3, 7)}
MODELS = models.MODELS | models.IN_FLUIDS


def numbers(text: str, q: Tensor, v: Tensor) -> tuple[Tensor, Tensor]:
    """MuJoCo's bias forces and those of springs, ``Ḣ v + ω × p − ∂ℒ/∂q``, and its energies."""
    model = compiled(text)
    model.opt.enableflags |= int(mujoco.mjtEnableBit.mjENBL_ENERGY)
    data = mujoco.MjData(model)
    bias, energy = np.zeros(v.shape), np.zeros(len(q))
    for k, state in enumerate(zip(q.numpy(), v.numpy(), strict=True)):
        data.qpos[:], data.qvel[:] = state
        mujoco.mj_forward(model, data)
        bias[k], energy[k] = data.qfrc_bias - data.qfrc_spring, data.energy.sum()
    return torch.from_numpy(bias), torch.from_numpy(energy)


@pytest.mark.parametrize("name", OURS)
def test_our_systems_written_as_mjcf_have_the_same_dynamics(name: str) -> None:
    """Mass matrix, bias forces, energy and accelerations, in our coordinates."""
    system = OURS[name]
    text = written(models.bodies_of(system))
    found, a = read(text), system.linkage.matrix
    q, v, u = points(system, 32)
    mass, _ = mujoco_dynamics(compiled(text), found, q @ a.T, v @ a.T, u)
    bias, energy = numbers(text, q @ a.T, v @ a.T)
    exact = {"rtol": 1e-10, "atol": 1e-10}
    torch.testing.assert_close(system.mass_matrix(q), a.T @ mass @ a, **exact)
    rates = system.rates(q, v)
    torch.testing.assert_close(rates.mass_rate_v - rates.q, bias @ a, **exact)
    ours = system.energy(q, v)
    torch.testing.assert_close(ours - ours[:1], energy - energy[:1], **exact)
    rate = found.acceleration(q @ a.T, v @ a.T, u)
    torch.testing.assert_close(rate, system.acceleration(q, v, u) @ a.T, rtol=1e-9, atol=1e-8)


@pytest.mark.parametrize("name", MODELS)
def test_a_model_has_the_dynamics_of_mujoco(name: str) -> None:
    """Mass matrix, bias forces, energy and accelerations, in our order of coordinates."""
    model, system = compiled(MODELS[name]), read(MODELS[name])
    q, v, u = points(system, 16)
    v = 3 * v
    mass, rate = mujoco_dynamics(model, system, q, v, u)
    bias, energy = numbers(MODELS[name], *system.model_state(q, v))
    assert (system.mass_matrix(q) - mass).abs().max() < 1e-11 * mass.abs().max()
    rates = system.rates(q, v)
    ours = rates.mass_rate_v + system.space.coadjoint(v, system.momentum(q, v)) - rates.q
    assert (ours - bias[:, system.model_order]).abs().max() < 1e-10 * bias.abs().max()
    fall = system.energy(q, v) - energy
    assert (fall - fall[0]).abs().max() < 1e-10 * energy.abs().max()
    size = rate.abs().max()
    assert (system.acceleration(q, v, u) - rate).abs().max() < 1e-10 * size
    assert size > 1


@pytest.mark.parametrize("text", [*MODELS.values(), models.SERVOS], ids=[*MODELS, "servos"])
def test_simulated_motions_are_those_of_mujoco(text: str) -> None:
    model, system = compiled(text), read(text)
    # MuJoCo 3.3's RK4 is of order 2 on ball joints: with 2e-4 s its error exceeds 1e-8
    model.opt.integrator, model.opt.timestep = int(mujoco.mjtIntegrator.mjINT_RK4), 1e-4
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_LIMIT)
    q, v, u = points(system, 2)
    path = simulate(system, q, v, u, 2, Solver(rtol=1e-11, atol=1e-11))
    start, end = system.model_state(q, v), system.model_state(path.q[:, -1], path.v[:, -1])
    for row in range(2):
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = (x[row] for x in start)
        data.ctrl[:] = u[row]
        for _ in range(1000):
            mujoco.mj_step(model, data)
        np.testing.assert_allclose(data.qvel, end[1][row], rtol=0, atol=1e-7)
        ours = mujoco.MjData(model)
        ours.qpos[:] = end[0][row]
        for one in (data, ours):
            mujoco.mj_kinematics(model, one)
        np.testing.assert_allclose(data.xpos, ours.xpos, rtol=0, atol=1e-8)
        np.testing.assert_allclose(data.xmat, ours.xmat, rtol=0, atol=1e-8)


def test_coordinates_inputs_and_forces_are_read_from_a_model() -> None:
    system = read(models.CRANE.replace('damping="0.3"', 'damping="0.3" frictionloss="0.2"'))
    assert system.coordinates.names == ("x", "joint_1", "yaw", "end", "other")
    assert system.coordinates.angular == (False, True, True, True, False)
    assert system.inputs == ("turn", "end")  # without a name that of its joint
    assert system.input_matrix.tolist() == [[0, 0], [0, 0], [3, 0], [0, 2], [0, 0]]
    assert system.viscous == (0, 0, 0.3, 0.1, 0)
    assert system.coulomb == (0, 0, 0.2, 0, 0)
    assert system.box.q[2] == (-2, 1)
    assert any("smoothed" in note for note in system.notes)
    free = read(models.CRANE, viscous=[0.0] * 5, box={"u": [[-3, 3], [0, 1]]})
    assert free.lagrangian is free
    assert free.box.u == ((-3, 3), (0, 1))


def test_drag_takes_energy_and_is_differentiable() -> None:
    system = read(models.DIVER)
    q, v, _ = points(system, 8)
    force = system.dissipation.force(q, v)
    assert ((force * v).sum(-1) < 0).all()
    assert torch.autograd.gradcheck(
        system.dissipation.force, (q[:2].requires_grad_(), v[:2].requires_grad_())
    )


def test_motions_end_at_a_joint_limit(caplog: pytest.LogCaptureFixture) -> None:
    sizes = {"n_traj": 6, "n_train_max": 6, "n_val": 1, "n_test": 1, "n_integration": 2}
    loose = Solver("RK23", rtol=1e-3, atol=1e-3)
    found = {}
    for limits in ("end", "off"):
        system = read(models.CRANE, limits=limits)
        with caplog.at_level("INFO"):
            data = TrajectoryData(system=system, integration_steps=20, solver=loose, **sizes)
            data.setup()
        found[limits] = data
    cut, whole = found["end"].trajectories("train"), found["off"].trajectories("train")
    lengths = [len(one.q) for one in cut]
    assert min(lengths) < max(len(one.q) for one in whole) == 34
    for one, entire in zip(cut, whole, strict=True):
        assert ((one.q[:, 2] >= -2) & (one.q[:, 2] <= 1)).all()
        assert torch.equal(one.q, entire.q[: len(one.q)])
        assert len(one.q) == 34 or not -2 <= entire.q[len(one.q), 2] <= 1
    assert found["end"].integration.q.shape[1] >= 3
    assert f"{sum(x < 34 for x in lengths)} of 6 train" in caplog.text
    assert "motions have the accuracy of data.solver" in caplog.text


def test_a_trained_run_needs_neither_file_nor_mujoco(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    crane = read(models.CRANE)
    system = {
        "_target_": "symo_exp.systems.multibody.Multibody", "model": "gone.xml", "time_step": 0.05,
        "mechanism": crane.mechanism,
    }  # fmt: skip
    model = {
        "_target_": "symo_exp.models.true.TrueOde", "lagrangian": system,
        "integrator": {"_target_": "symo_exp.mechanics.explicit.RK4"},
    }  # fmt: skip
    (tmp_path / "config.yaml").write_text(yaml.safe_dump({"system": system, "model": model}))
    monkeypatch.setitem(sys.modules, "mujoco", None)
    loaded = from_folder(tmp_path)
    q, v, _ = points(crane, 2)
    assert torch.isfinite(loaded.rollout(q, v, steps=3).q).all()


HINGE = '<body><joint name="arm"/><geom size="0.1"/></body>'
TWO = HINGE + '<body pos="9 0 0"><joint name="leg"/><geom size="0.1"/></body>'
MOTOR = "<actuator>{}</actuator>"
MALFORMED = {
    "no model": ("", "cannot read"),
    "no mass": (mjcf("<body><joint/></body>"), "cannot read"),
    "nothing moves": (mjcf('<geom size="1"/>'), "no joints"),
    "a sprung ball": (
        mjcf('<body><joint type="ball" stiffness="1"/><geom size="1"/></body>'), "springs of ball"
    ),
    "a push in world axes": (
        mjcf('<body><freejoint name="hull"/><geom size="1"/></body>',
             MOTOR.format('<motor name="p" joint="hull" gear="0 1 0 0 0 0"/>')), "p acts on a free",
    ),
    "a torque in axes of the parent": (
        mjcf('<body><joint type="ball" name="b"/><geom size="1"/></body>',
             MOTOR.format('<motor jointinparent="b" gear="0 1 0"/>')), "in their own axes",
    ),
    "an equality": (
        mjcf(TWO, '<equality><joint joint1="arm" joint2="leg"/></equality>'), "equality"
    ),
    "a tendon": (
        mjcf(TWO, '<tendon><fixed><joint joint="arm" coef="1"/></fixed></tendon>'), "tendon"
    ),
    "a weak servo": (mjcf(HINGE, MOTOR.format(
        '<position name="s" joint="arm" forcerange="-1 1"/>')), "s is a servo with a limited"),
    "a servo of a weak joint": (
        mjcf(HINGE.replace('"arm"', '"arm" actuatorfrcrange="-1 1"'),
             MOTOR.format('<velocity joint="arm"/>')), "is a servo with a limited force"),
    "a servo that pushes away": (mjcf(HINGE, MOTOR.format(
        '<general joint="arm" biastype="affine" biasprm="0 1 0"/>')), "negative gain"),
    "a constant force": (mjcf(HINGE, MOTOR.format(
        '<general joint="arm" biastype="affine" biasprm="1 0 -1"/>')), "constant force"),
    "a servo of a ball": (
        mjcf('<body><joint type="ball" name="b"/><geom size="1"/></body>',
             MOTOR.format('<position joint="b" gear="0 1 0"/>')), "not act on a hinge or slide",
    ),
    "a damper": (mjcf(HINGE, MOTOR.format(
        '<damper joint="arm" kv="1" ctrlrange="0 1"/>')), "neither a motor"),
    "an activation": (mjcf(HINGE, MOTOR.format(
        '<general joint="arm" dyntype="integrator"/>')), "actuators that have states"),
    "a site's motor": (
        mjcf(HINGE.replace("</body>", '<site name="p"/></body>'),
             MOTOR.format('<motor site="p"/>')),
        "not on a free body",
    ),
    "a weak motor": (mjcf(HINGE, MOTOR.format(
        '<motor name="w" joint="arm" ctrlrange="-9 9" forcerange="-1 1"/>')), "w has a forcerange"),
    "a weak joint": (
        mjcf(HINGE.replace('"arm"', '"arm" actuatorfrcrange="-1 1"'),
             MOTOR.format('<motor joint="arm" gear="5"/>')),
        "arm: its motors exceed actuatorfrcrange",
    ),
    "floating": (mjcf(HINGE.replace("<body>", '<body gravcomp="1">')), "gravity compensation"),
    "wind": (mjcf(HINGE, option='<option wind="1 0 0" density="1"/>'), "wind"),
    "a wing": (
        mjcf(HINGE.replace('size="0.1"', 'size="0.1" fluidshape="ellipsoid"'),
             option='<option density="1"/>'), "ellipsoid",
    ),
    "no actuation": (
        mjcf(HINGE, MOTOR.format('<motor joint="arm"/>'),
             option='<option><flag actuation="disable"/></option>'), "is not supported",
    ),
    "a stiff spring": (
        mjcf(HINGE.replace('"arm"', '"arm" stiffness="1 2 3"')),
        "springs and dampers|too much data",  # one number until MuJoCo 3.7
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", MALFORMED)
def test_unsupported_models_are_refused_in_one_line(case: str, tmp_path: Path) -> None:
    text, expected = MALFORMED[case]
    file = tmp_path / "robot.xml"
    file.write_text(text)
    with pytest.raises(ConfigError, match=expected) as error:
        read_mechanism(file)
    assert str(error.value).startswith(f"system.model={file}")


def test_a_missing_file_or_library_is_reported(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    with pytest.raises(ConfigError, match="no such file"):
        read_mechanism(tmp_path / "nothing.xml")
    monkeypatch.setitem(sys.modules, "mujoco", None)
    (tmp_path / "robot.xml").write_text(mjcf(HINGE))
    with pytest.raises(ConfigError, match=r"pip install 'symo_exp\[mujoco\]'"):
        read_mechanism(tmp_path / "robot.xml")


def test_contacts_are_switched_off_with_a_note() -> None:
    assert any("1 pair of" in note for note in read(mjcf(TWO)).notes)
    assert not any("contacts" in note for note in read(models.PENDULUMS).notes)


@pytest.mark.skipif(
    int(mujoco.__version__.split(".")[0]) < 4, reason="MuJoCo does not warn of it yet"
)
def test_warnings_of_mujoco_become_notes_and_no_file(workplace: Path) -> None:
    (workplace / "robot.xml").write_text(mjcf(HINGE).replace(
        'angle="radian"', 'settotalmass="2"'
    ))  # fmt: skip
    assert any("settotalmass" in note for note in read_mechanism("robot.xml")["notes"])
    assert [file.name for file in workplace.iterdir()] == ["robot.xml"]


def test_a_gymnasium_environment_is_a_system() -> None:
    pytest.importorskip("imageio")  # Gymnasium's own need
    swimmer = Multibody(mechanism=environment_mechanism("Swimmer-v5"), time_step=0.05)
    assert swimmer.input_matrix.shape == (5, 2)
    assert swimmer.dissipation is not None
    ant = Multibody(mechanism=environment_mechanism("Ant-v5"), time_step=0.05)
    assert ant.coordinates.rotations == ("root_R",)
    assert ant.input_matrix.shape == (14, 8)
    for name, reason in {
        "CartPole-v1": "not an environment with a MuJoCo model",
        "Nothing-v0": "cannot make it",
    }.items():
        with pytest.raises(ConfigError, match=reason):
            environment_mechanism(name)


def test_a_urdf_file_is_a_system(tmp_path: Path) -> None:
    file = tmp_path / "acrobot.urdf"
    file.write_text(urdf(models.bodies_of(ACROBOT, damping=0.1)))
    found = Multibody(mechanism=read_mechanism(file), time_step=0.05)
    assert found.coordinates == ACROBOT.coordinates
    assert found.viscous == (0.1, 0.1)
    assert found.input_matrix.shape == (2, 0)
    q = points(found, 8)[0]
    exact = {"rtol": 1e-10, "atol": 1e-10}
    torch.testing.assert_close(found.mass_matrix(q), ACROBOT.mass_matrix(q), **exact)
    fall = found.potential(q) - ACROBOT.potential(q)
    torch.testing.assert_close(fall, fall[:1].expand(8), **exact)
    generate = {"n_train_max": 1, "n_val": 1, "n_test": 1, "n_steps": 2, "n_integration": 1}
    data = TrajectoryData(system=found, **generate, integration_steps=2, n_traj=1, dtype="float64")
    assert data.load().train[0].u.shape == (4, 0)


def test_pictures_are_drawn_by_mujoco_or_as_a_stick_figure(tmp_path):
    file = tmp_path / "arm.xml"
    file.write_text((CONF / "system" / "arm_of_seven.xml").read_text())
    parts = {"mechanism": read_mechanism(file), "time_step": 0.05, "viscous": None, "coulomb": None}
    arm, lost = (Multibody(model=str(x), **parts) for x in (file, tmp_path / "lost.xml"))
    q = torch.zeros(7, dtype=torch.float64)
    assert lost.picture(q, 96) is None
    env = environment(lost, render_mode="rgb_array")
    env.reset(seed=0)
    stick = env.render()
    assert stick.std() > 1
    if arm.picture(q, 96) is None:
        pytest.skip("nothing draws off screen here")
    assert arm.picture(q, 96).shape == (96, 96, 3)
    assert np.array_equal(arm.picture(q, 96), arm.picture(q, 96))
    assert not np.array_equal(arm.picture(q, 96), arm.picture(q + 0.5, 96))
    env = environment(arm, render_mode="rgb_array")
    env.reset(seed=0)
    assert env.render().shape == stick.shape
    assert not np.array_equal(env.render(), stick)
