"""Learned rigid bodies written as MJCF have the same dynamics in MuJoCo."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch

import symo_exp
from symo_exp.errors import ConfigError
from symo_exp.mechanics.bodies import joint_order
from symo_exp.mechanics.dissipation import DissipativeLagrangian
from symo_exp.mechanics.galerkin import Galerkin
from symo_exp.mechanics.roots import Newton
from symo_exp.mechanics.scaled import ScaledDissipation, ScaledLagrangian
from symo_exp.mechanics.types import Coordinates
from symo_exp.mechanics.units import SI, Units
from symo_exp.models.true import TrueVariational
from symo_exp.nets.dissipation import LearnedDissipation
from symo_exp.nets.embedding import directions
from symo_exp.nets.known import KnownFriction, KnownLagrangian
from symo_exp.nets.planar_links import PlanarLinks
from symo_exp.nets.rigid_body import LearnedRigidBody
from symo_exp.nets.rigid_chain import RigidChain
from symo_exp.nets.springs import LinearSprings, SprungLagrangian
from symo_exp.systems.mujoco_library import library
from tests.nets.test_planar_links import PLANAR as PLANAR_SYSTEMS
from tests.nets.test_planar_links import links_of
from tests.oscillator import oscillator
from tests.systems import models
from tests.systems.every import FLAT, SYSTEMS, points

mujoco = library()
H = 0.01


def perturbed(module):
    torch.manual_seed(7)
    with torch.no_grad():
        for p in module.parameters():
            p += 0.1 * torch.randn_like(p)
    return module.double()


def mass_of(theirs, data):
    """The mass matrix of MuJoCo, where ``mj_forward`` was last."""
    mass = np.zeros((theirs.nv, theirs.nv))
    for row, unit in zip(mass, np.eye(theirs.nv), strict=True):
        mujoco.mj_mulM(theirs, data, row, unit)
    return mass


def known(system):
    n = system.coordinates.n
    system = replace(system, viscous=tuple(0.1 * (i + 1) for i in range(n)))
    lagrangian = perturbed(KnownLagrangian(system=system))
    return DissipativeLagrangian(lagrangian, perturbed(KnownFriction(system=system))), system


def rigid(angular):
    torch.manual_seed(5)
    names = tuple(f"q{i}" for i in range(len(angular)))
    coordinates = Coordinates(names, angular)
    friction = LearnedDissipation(coordinates=coordinates, joints="neighbours")
    return DissipativeLagrangian(RigidChain(coordinates=coordinates).double(), perturbed(friction))


def planar(angular, relative=True):
    """Links in a plane whose slide has no force but the weight of what it carries."""
    coordinates = Coordinates(tuple(f"q{i}" for i in range(len(angular))), angular)
    links = perturbed(PlanarLinks(coordinates=coordinates, relative=relative))
    if not all(angular):
        gravity = -1.0 - 9.0j
        products = links.points.detach().view(len(angular), -1)
        x, y = products.chunk(2, dim=1)
        moment = torch.complex(x, y).conj() @ torch.complex(x, y).T
        weights = 1j * gravity.conjugate() * moment[0]
        weights[0] = (
            -gravity.real * links.mass_matrix(torch.zeros(1, len(angular)).double())[0, 0, 0]
        )
        with torch.no_grad():
            links.weights.copy_(torch.cat((weights.real, weights.imag)))
    friction = LearnedDissipation(coordinates=coordinates, joints="neighbours")
    return DissipativeLagrangian(links, perturbed(friction))


def sprung(angular, links=rigid):
    """Links with a spring on every joint."""
    found = links(angular)
    springs = LinearSprings(coordinates=Coordinates(tuple(map(str, angular)), angular))
    with torch.no_grad():
        diagonal = springs.places.diagonal()
        springs.stiffness[diagonal] = torch.linspace(1.0, 3.0, len(angular))
        springs.preload.uniform_(-1.0, 1.0)
    lagrangian = SprungLagrangian(found.conservative, springs.double())
    return DissipativeLagrangian(lagrangian, found.dissipation)


def pushed(angular):
    """Links in a plane on springs, with a constant force along the slide."""
    found = sprung(angular, planar)
    if not all(angular):
        with torch.no_grad():
            found.conservative.conservative.weights[0] -= 3.1
    return found


UNITS = Units(length=2.0, time=0.5, mass=3.0)


def scaled(angular):
    """Rigid links with springs, whose parameters are in other units."""
    found = sprung(angular)
    coordinates = Coordinates(tuple(map(str, angular)), angular, units=UNITS)
    return DissipativeLagrangian(
        ScaledLagrangian(found.conservative, coordinates).double(),
        ScaledDissipation(found.dissipation, coordinates).double(),
    )


LEARNED = {
    "rigid": rigid,
    "planar": planar,
    "absolute": partial(planar, relative=False),
    "pushed": pushed,
    "sprung": sprung,
    "scaled": scaled,
}
PLANAR = ("planar", "absolute", "pushed")


def model_of(lagrangian, coordinates, matrix, system=None):
    found = TrueVariational(
        lagrangian=lagrangian,
        coordinates=coordinates,
        input_matrix=matrix,
        time_step=H,
        integrator=Galerkin(stages=3),
        root=Newton(tolerance=1e-12, max_iterations=30),
    ).double()
    found.system = system
    return found


def cases():
    crane = models.read(models.CRANE)
    for name, system in (FLAT | {"crane": crane}).items():
        yield pytest.param(("known", system), id=name)
    for angular in ((True,), (False, True, True), (True,) * 4):
        for kind in (kind for kind in LEARNED if kind not in PLANAR):
            yield pytest.param((kind, angular), id=f"{kind}{len(angular)}")
    for angular in ((True,), (False,), (False, True), (True, True)):
        for kind in PLANAR:
            yield pytest.param((kind, angular), id=f"{kind}{angular}")


@pytest.fixture(params=cases())
def case(request):
    kind, given = request.param
    if kind == "known":
        lagrangian, system = known(given)
        matrix = torch.eye(system.coordinates.n).double()
        q, v, _ = points(system, 2)
        joints = system.linkage.matrix
        return model_of(lagrangian, system.coordinates, matrix), q, v, joints
    n = len(given)
    q, v = torch.randn(2, 2, n, generator=torch.Generator().manual_seed(1)).double().unbind()
    units = UNITS if kind == "scaled" else SI
    coordinates = Coordinates(tuple(f"q{i}" for i in range(n)), given, units=units)
    eye = torch.eye(n).double()
    joints = torch.linalg.inv(directions(given)).double() if kind == "absolute" else eye
    return model_of(LEARNED[kind](given), coordinates, eye), q, v, joints


def test_mujoco_has_the_same_mass_matrix_and_forces(case, tmp_path):
    model, q, v, a = case
    file = symo_exp.export(model, tmp_path / "machine.xml")
    theirs = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(theirs)
    rates = model.lagrangian.conservative.rates(q, v)
    bias, passive = rates.mass_rate_v - rates.q, model.dissipation.force(q, v)
    for k in range(len(q)):
        data.qpos[:], data.qvel[:] = (a @ q[k]).numpy(), (a @ v[k]).numpy()
        mujoco.mj_forward(theirs, data)
        at, mass = a.numpy(), mass_of(theirs, data)
        springs = data.qfrc_passive - data.qfrc_damper  # ours are part of the potential
        exact = {"rtol": 1e-9, "atol": 1e-9}
        np.testing.assert_allclose(at.T @ mass @ at, rates.mass[k].detach(), **exact)
        theirs_bias = at.T @ (data.qfrc_bias - springs)
        np.testing.assert_allclose(theirs_bias, bias[k].detach(), **exact)
        np.testing.assert_allclose(at.T @ data.qfrc_damper, passive[k].detach(), **exact)


def test_mujoco_has_the_same_motion(case, tmp_path):
    model, q, v, a = case
    file = symo_exp.export(model, tmp_path / "machine.xml")
    theirs = mujoco.MjModel.from_xml_path(str(file))
    theirs.opt.timestep = H / 20
    theirs.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_LIMIT)
    data, steps = mujoco.MjData(theirs), round(0.3 / H)
    force = 0.1 * torch.ones(len(q), steps + 1, q.shape[1]).double()
    path = model.rollout(q, v, force)
    assert path.converged.all()
    for k in range(len(q)):
        mujoco.mj_resetData(theirs, data)
        data.qpos[:], data.qvel[:] = (a @ q[k]).numpy(), (a @ v[k]).numpy()
        data.ctrl[:] = 0.1
        for _ in range(20 * steps):
            mujoco.mj_step(theirs, data)
        np.testing.assert_allclose(data.qpos, a @ path.q[k, -1], rtol=0, atol=1e-6)


# Ball joints and free bodies

EVERY = SYSTEMS | {name: models.read(text) for name, text in models.SHIPPED.items()}
TURNING = {name: system for name, system in EVERY.items() if system.space.rotations}


def learned_body(coordinates, **given):
    torch.manual_seed(2)
    found = LearnedRigidBody(coordinates=coordinates, radius=0.5, **given).double()
    with torch.no_grad():
        found.gravity.copy_(torch.tensor([1.0, 2.0, -9.0]))
    friction = KnownFriction(system=replace(SYSTEMS["rigid_body"], viscous=(0.1,) * 3))
    return found if coordinates.n > 3 else DissipativeLagrangian(found, friction.double())


def held_body(system):
    """A free body on springs, with the same friction in all directions."""
    springs = LinearSprings(coordinates=system.coordinates, start=np.diag([1.0, 2.0, 3.0]).tolist())
    with torch.no_grad():
        springs.preload.copy_(torch.tensor([0.5, -0.5, 1.0]))
    lagrangian = SprungLagrangian(learned_body(system.coordinates), springs.double())
    friction = LearnedDissipation(coordinates=system.coordinates).double()
    return DissipativeLagrangian(lagrangian, friction)


def turning_cases():
    for name, system in TURNING.items():
        n = system.coordinates.n
        system = replace(system, viscous=(0.1,) * n, coulomb=None)
        lagrangian = perturbed(KnownLagrangian(system=system))
        friction = KnownFriction(system=system).double()
        found = DissipativeLagrangian(lagrangian, friction)
        model = model_of(found, system.coordinates, system.input_matrix, system)
        yield pytest.param((model, system.linkage.joints), id=name)
    for name in ("rigid_body", "quadrotor"):
        system = SYSTEMS[name]
        for learned in (0, 2):
            found = learned_body(system.coordinates, learned_inputs=learned)
            matrix = (
                torch.zeros(system.coordinates.n, 2).double() if learned else system.input_matrix
            )
            model = model_of(found, system.coordinates, matrix)
            yield pytest.param((model, system.linkage.joints), id=f"learned {name} {learned}")
    model = model_of(held_body(system), system.coordinates, system.input_matrix)
    yield pytest.param((model, system.linkage.joints), id="on springs")


@pytest.mark.parametrize("case", list(turning_cases()))
def test_mujoco_has_the_same_equations_of_bodies_that_turn(case, tmp_path):
    model, joints = case
    file = symo_exp.export(model, tmp_path / "machine.xml")
    assert "not in this file" not in file.read_text()
    theirs = mujoco.MjModel.from_xml_path(str(file))
    theirs.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL)
    data, (n, m), lagrangian = mujoco.MjData(theirs), model.input_matrix.shape, model.lagrangian
    space, order, exact = model.flow.space, joint_order(joints), {"rtol": 1e-9, "atol": 1e-9}
    x, v = torch.randn(2, 3, n, generator=torch.Generator().manual_seed(1)).double().unbind()
    q, u = space.of_vector(x), torch.randn(3, m).double()
    free = getattr(lagrangian, "conservative", lagrangian)
    rates = free.rates(q, v)
    spin = space.coadjoint(v, (rates.mass @ v.unsqueeze(-1)).squeeze(-1))
    bias = rates.mass_rate_v - rates.q + spin
    force = free.input_force(model.input_matrix, q, u)
    passive = 0.0 * v if free is lagrangian else lagrangian.dissipation.force(q, v)
    numbers, flat = space.to_quaternions(q), n - 3 * space.rotations
    quaternions, lengths = iter(range(flat, numbers.shape[1], 4)), iter(range(flat))
    places = []
    for joint in joints:
        places += range(k := next(quaternions), k + 4) if joint.axes else [next(lengths)]
    for k in range(len(q)):
        data.qpos[:], data.qvel[order] = numbers[k, places], v[k]
        data.ctrl[:] = u[k]
        mujoco.mj_forward(theirs, data)
        springs = data.qfrc_passive - data.qfrc_damper
        found = (
            mass_of(theirs, data)[order][:, order],
            *(y[order] for y in (data.qfrc_bias - springs, data.qfrc_damper, data.qfrc_actuator)),
        )
        for ours, there in zip((rates.mass, bias, passive, force), found, strict=True):
            np.testing.assert_allclose(there, ours[k].detach(), **exact)


def test_friction_that_differs_about_the_axes_of_a_ball_joint_is_reported(tmp_path):
    system = replace(SYSTEMS["rigid_body"], viscous=(0.1, 0.2, 0.6))
    found = DissipativeLagrangian(KnownLagrangian(system=system), KnownFriction(system=system))
    model = model_of(found.double(), system.coordinates, system.input_matrix, system)
    file = symo_exp.export(model, tmp_path / "top.xml")
    assert "friction of ball joints is its mean" in file.read_text()
    damping = mujoco.MjModel.from_xml_path(str(file)).dof_damping
    np.testing.assert_allclose(damping, 0.3, rtol=1e-6)


@pytest.mark.parametrize("d", [0.1, 0.2, 0.7])
def test_a_body_with_the_same_friction_in_all_directions_has_a_free_joint(d, tmp_path):
    system = replace(SYSTEMS["quadrotor"], viscous=(d,) * 6, coulomb=(d,) * 6)
    model = model_of(system.lagrangian, system.coordinates, system.input_matrix, system)
    theirs = mujoco.MjModel.from_xml_path(str(symo_exp.export(model, tmp_path / "drone.xml")))
    assert theirs.jnt_type.tolist() == [int(mujoco.mjtJoint.mjJNT_FREE)]
    assert set(theirs.dof_damping) == set(theirs.dof_frictionloss) == {d}


def test_inputs_of_a_small_body_keep_their_digits(tmp_path):
    system = SYSTEMS["rigid_body"]
    matrix = 1e-9 * torch.rand(3, 2, generator=torch.Generator().manual_seed(0)).double()
    model = model_of(KnownLagrangian(system=system).double(), system.coordinates, matrix)
    file = symo_exp.export(model, tmp_path / "top.xml")
    gear = mujoco.MjModel.from_xml_path(str(file)).actuator_gear[:, :3]
    np.testing.assert_allclose(gear.T, model.input_matrix, rtol=1e-9)


def test_an_input_of_a_ball_joint_and_another_is_reported(tmp_path):
    system = TURNING["ball_arm"]
    matrix = torch.ones(system.coordinates.n, 1).double()
    model = model_of(KnownLagrangian(system=system).double(), system.coordinates, matrix)
    file = symo_exp.export(model, tmp_path / "arm.xml")
    assert "the input 0 is not in this file" in file.read_text()
    assert mujoco.MjModel.from_xml_path(str(file)).nu == 0


@pytest.mark.parametrize("name", ["machine.urdf", "machine.xml"])
def test_rotations_that_no_file_can_hold_are_refused(name, tmp_path):
    coordinates = SYSTEMS["rigid_body"].coordinates
    networks = {} if name.endswith("urdf") else {"learned_inputs": 2, "input_width": 3}
    model = model_of(learned_body(coordinates, **networks), coordinates, torch.zeros(3, 2).double())
    with pytest.raises(ConfigError, match=r"no ball joints.*\.xml|networks of the rotation"):
        symo_exp.export(model, tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_a_network_that_is_left_out_is_reported(tmp_path, caplog):
    system = SYSTEMS["cartpole"]
    friction = LearnedDissipation(coordinates=system.coordinates, coulomb=True, width=4)
    lagrangian = DissipativeLagrangian(KnownLagrangian(system=system), friction).double()
    model = model_of(lagrangian, system.coordinates, system.input_matrix, system)
    file = symo_exp.export(model, tmp_path / "cart.xml")
    told = "the network of the dissipation"
    assert told in file.read_text()
    assert told in caplog.text
    found = mujoco.MjModel.from_xml_path(str(file))
    np.testing.assert_allclose(found.dof_frictionloss, 0.01, rtol=1e-6)
    np.testing.assert_allclose(found.actuator_ctrlrange[0], system.box.u[0])


def test_a_file_that_cannot_be_written_is_refused(tmp_path):
    (tmp_path / "file").touch()
    system = SYSTEMS["cartpole"]
    model = model_of(
        KnownLagrangian(system=system).double(), system.coordinates, system.input_matrix
    )
    with pytest.raises(ConfigError, match="cannot be written"):
        symo_exp.export(model, tmp_path / "file" / "arm.xml")


def test_a_model_without_bodies_is_refused(tmp_path):
    truth = oscillator(2)
    coordinates = Coordinates(("a", "b"), (False, False))
    model = model_of(truth, coordinates, torch.eye(2).double())
    with pytest.raises(ConfigError, match="this model does not consist of rigid bodies"):
        symo_exp.export(model, tmp_path / "machine.xml")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", PLANAR_SYSTEMS)
@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_links_in_a_plane_of_any_number_are_bodies_as_far_as_the_machine_is(
    name, noise, tmp_path, caplog
):
    system = PLANAR_SYSTEMS[name]
    links, n = links_of(system), system.coordinates.n
    torch.manual_seed(0)
    with torch.no_grad():
        links.inertias.fill_(0.1)  # of a body, which points have not
        links.points += noise * links.points.abs().max() * torch.randn_like(links.points)
    model = model_of(links, system.coordinates, torch.eye(n).double())
    theirs = mujoco.MjModel.from_xml_path(str(symo_exp.export(model, tmp_path / "machine.xml")))
    data = mujoco.MjData(theirs)
    q, *_ = points(system, 1)
    a = system.linkage.matrix
    data.qpos[:] = (a @ q[0]).numpy()
    mujoco.mj_forward(theirs, data)
    found = a.numpy().T @ mass_of(theirs, data) @ a.numpy()
    expected = links.mass_matrix(q)[0].detach().numpy()
    apart = float(abs(found - expected).max()) / abs(expected).max()
    rigid = "not exactly rigid" not in caplog.text
    assert apart < (1e-8 if rigid else 20.0 * noise)
    assert rigid == (not noise or n < 3)


@pytest.mark.parametrize("angular", [(True,), (True, True), (False, True)])
@pytest.mark.parametrize("weightless", ["all", "last"])
def test_links_without_a_weight_are_bodies_of_possible_sizes(angular, weightless, tmp_path):
    """On vertical axes, or balanced: what is learned of their weight is almost zero."""
    n = len(angular)
    lagrangian = planar(angular)
    links = lagrangian.conservative
    with torch.no_grad():
        if weightless == "all":
            links.weights *= 1e-9
        else:
            links.weights[n - 1 :: n] *= 1e-9
            links.points.view(n, -1)[-1] *= 1e-9
    coordinates = Coordinates(tuple("abc"[:n]), angular)
    model = model_of(lagrangian, coordinates, torch.eye(n).double())
    theirs = mujoco.MjModel.from_xml_path(str(symo_exp.export(model, tmp_path / "machine.xml")))
    data = mujoco.MjData(theirs)
    q = torch.linspace(0.5, 1.0, n).double()[None]
    data.qpos[:] = q[0].numpy()
    mujoco.mj_forward(theirs, data)
    expected = links.rates(q, torch.zeros_like(q))
    mass = mass_of(theirs, data)
    np.testing.assert_allclose(mass, expected.mass[0].detach(), rtol=1e-9, atol=1e-12)
    assert abs(theirs.body_ipos).max() < 1e3
    if all(angular):
        np.testing.assert_allclose(data.qfrc_bias, -expected.q[0].detach(), rtol=1e-6, atol=0)


def test_three_learned_links_that_are_no_bodies_are_refused(tmp_path):
    angular = (True,) * 3
    coordinates = Coordinates(("a", "b", "c"), angular)
    model = model_of(planar(angular), coordinates, torch.eye(3).double())
    with pytest.raises(ConfigError, match="learned links differ from rigid bodies"):
        symo_exp.export(model, tmp_path / "machine.xml")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("length", [1e-6, 1e-3])
def test_a_body_too_light_for_a_file_is_reported(length, tmp_path):
    """MuJoCo refuses it, so that the file has a heavier one."""
    coordinates = Coordinates(("q",), (True,), units=Units(length=length, mass=1e-3))
    chain = ScaledLagrangian(RigidChain(coordinates=Coordinates(("q",), (True,))), coordinates)
    model = model_of(chain.double(), coordinates, torch.eye(1).double())
    file = symo_exp.export(model, tmp_path / "mirror.xml")
    theirs = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(theirs)
    mujoco.mj_forward(theirs, data)
    learned = chain.mass_matrix(torch.zeros(1, 1).double()).item()
    same = mass_of(theirs, data).item() == pytest.approx(learned, rel=1e-9, abs=0.0)
    assert ("body of q is heavier in this file: at least 1e-13" in file.read_text()) != same


def test_a_constant_force_along_a_slide_is_reported(tmp_path, caplog):
    angular = (False, True)
    coordinates = Coordinates(("x", "a"), angular)
    lagrangian = planar(angular)
    with torch.no_grad():
        lagrangian.conservative.weights[0] -= 3.0
    symo_exp.export(
        model_of(lagrangian, coordinates, torch.eye(2).double()), tmp_path / "machine.xml"
    )
    assert "constant force of 3 N along x is not in this file" in caplog.text


def test_dry_friction_of_other_units_is_in_si_units(tmp_path):
    plain = Coordinates(("x", "q"), (False, True))
    coordinates = plain._replace(units=UNITS)
    friction = perturbed(LearnedDissipation(coordinates=plain, coulomb=True))
    chain = RigidChain(coordinates=plain).double()
    model = model_of(
        DissipativeLagrangian(
            ScaledLagrangian(chain, coordinates).double(),
            ScaledDissipation(friction, coordinates).double(),
        ),
        coordinates,
        torch.eye(2).double(),
    )
    theirs = mujoco.MjModel.from_xml_path(str(symo_exp.export(model, tmp_path / "machine.xml")))
    q, v = torch.zeros(1, 2).double(), torch.full((1, 2), 1e4).double()
    dry = model.dissipation.force(q, 2.0 * v) - 2.0 * model.dissipation.force(q, v)
    np.testing.assert_allclose(theirs.dof_frictionloss, dry[0].detach(), rtol=1e-5)
