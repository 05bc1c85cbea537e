"""Physical parameters read from a Lagrangian are those of the machine."""

from functools import partial

import pytest
import torch

from symo_exp.mechanics.scaled import ScaledDissipation
from symo_exp.mechanics.types import Coordinates
from symo_exp.mechanics.units import Units
from symo_exp.models.learned import learned_lagrangian
from symo_exp.nets.dissipation import LearnedDissipation
from symo_exp.nets.drag import LearnedDrag
from symo_exp.nets.known import KnownLagrangian
from symo_exp.nets.lagrangians import PlanarLagrangian
from symo_exp.nets.planar_links import PlanarLinks
from symo_exp.nets.readings import readings
from symo_exp.nets.springs import LinearSprings
from symo_exp.nets.structured_lagrangian import StructuredLagrangian
from tests.nets.test_rigid_chain import TRUTHS, of_truth
from tests.systems.every import SYSTEMS


def values(module, coordinates):
    return {r.name: (float(r.value.detach()), r.unit) for r in readings(module, coordinates)}


@pytest.mark.parametrize("name", TRUTHS)
def test_bodies_of_a_chain_are_those_of_the_machine(name):
    system = TRUTHS[name]()
    for found in (
        values(of_truth(system), system.coordinates),
        values(KnownLagrangian(system=system).double(), system.coordinates),
    ):
        for joint in system.joints:
            assert found[f"{joint.name}.mass"] == (pytest.approx(joint.mass), "kg")
            centre = [found[f"{joint.name}.centre_{axis}"][0] for axis in "xyz"]
            expected = torch.tensor(joint.centre) - torch.tensor(joint.anchor)
            torch.testing.assert_close(torch.tensor(centre), expected, rtol=1e-5, atol=1e-6)
            inertia = torch.tensor(joint.inertia)
            for entry, (i, j) in {"xx": (0, 0), "zz": (2, 2), "xy": (0, 1)}.items():
                value, unit = found[f"{joint.name}.inertia_{entry}"]
                assert value == pytest.approx(float(inertia[i, j]), rel=1e-4, abs=1e-5)
                assert unit == "kg m^2"


@pytest.mark.parametrize("relative", [False, True])
@pytest.mark.parametrize("kind", [PlanarLagrangian, PlanarLinks])
def test_coefficients_of_links_are_those_of_the_lagrangian(kind, relative):
    """Coefficients are compared with averages of inertia and potential over the angles."""
    torch.manual_seed(1)
    coordinates = Coordinates(("x", "a", "b"), (False, True, True))
    module = kind(coordinates=coordinates, relative=relative).double()
    with torch.no_grad():
        if kind is PlanarLinks:
            module.points.normal_()
            module.weights.normal_()
            module.rotors.zero_()
        else:
            last = module.net.weights[-1]
            last.copy_(0.1 * torch.randn_like(last))
    found = values(module, coordinates)
    assert found["x.inertia"][1] == "kg"
    assert found["a.inertia.x"][1] == "kg m"
    assert found["b.inertia.a"][1] == "kg m^2"
    turn = torch.eye(3).double()
    turn[2, 1] = 1.0 if relative else 0.0
    phi = (
        2.0 * torch.pi * torch.rand(20_000, 3, generator=torch.Generator().manual_seed(2)).double()
    )
    phi[:, 0] = 0.0
    back = torch.linalg.inv(turn)
    with torch.no_grad():
        mass = back.T @ module.mass_matrix(phi @ back.T) @ back
        potential = module.potential(phi @ back.T)
    close = {"rel": 0.05, "abs": 0.02}
    assert found["b.inertia"][0] == pytest.approx(float(mass[:, 2, 2].mean()), **close)
    wave = 2.0 * (phi[:, 2] - phi[:, 1]).cos()
    assert found["b.inertia.a"][0] == pytest.approx(float((mass[:, 2, 1] * wave).mean()), **close)
    moment = [2.0 * (potential * f(phi[:, 1])).mean() for f in (torch.cos, torch.sin)]
    assert found["a.gravity_moment"][0] == pytest.approx(float(torch.stack(moment).norm()), **close)


def test_a_network_has_no_physical_parameters():
    system = SYSTEMS["acrobot"]
    module = StructuredLagrangian(angular=system.coordinates.angular, width=4)
    assert readings(module, system.coordinates) == []


def test_friction_has_units_of_its_coordinate():
    coordinates = Coordinates(("x", "a"), (False, True))
    found = values(
        LearnedDissipation(coordinates=coordinates, coulomb=True, start=0.3, rest_velocity=0.2),
        coordinates,
    )
    assert found["x.viscous_friction"] == (pytest.approx(0.3), "N s/m")
    assert found["a.dry_friction"] == (pytest.approx(0.3), "N m")
    assert found["a.rest_velocity"] == (pytest.approx(0.2), "rad/s")


def test_parameters_in_other_units_are_read_in_si_units():
    """Those that the forces and the inertia have."""
    coordinates = Coordinates(("x", "a"), (False, True), units=Units(1e-3, 0.1, 1e2))
    lagrangian = learned_lagrangian(
        coordinates,
        partial(PlanarLagrangian, relative=True),
        partial(LearnedDissipation, start=0.3),
        partial(LinearSprings, start=[[3.0, 1.0], [1.0, 2.0]]),
    ).double()
    with torch.no_grad():
        last = lagrangian.conservative.inner.conservative.net.weights[-1]
        last.zero_()  # nothing but springs and a constant inertia
    found = {name: value for name, (value, _) in values(lagrangian, coordinates).items()}
    q = torch.zeros(1, 2).double()
    at = lagrangian.expand(q, q)
    stiffness, mass, damping = -at.curvature().qq[0], at.mass()[0], -at.damping()[0]
    for name, (i, j) in {"x": (0, 0), "a": (1, 1)}.items():
        assert found[f"{name}.stiffness"] == pytest.approx(float(stiffness[i, j]), rel=1e-6)
        assert found[f"{name}.inertia"] == pytest.approx(float(mass[i, j]), rel=1e-6)
        assert found[f"{name}.viscous_friction"] == pytest.approx(float(damping[i, j]), rel=1e-6)
    assert found["a.stiffness.x"] == pytest.approx(float(stiffness[1, 0]), rel=1e-6)
    assert found["x.stiffness"] == pytest.approx(3.0 * 1e2 / 0.1**2)  # kg / s²


def test_coefficients_of_drag_in_other_units_are_read_in_si_units():
    """That of one speed, ``F = −(ν + |s|) s a``, ``s = a v``, from two forces: ``ν = d / |a|²``."""
    coordinates = Coordinates(("x",), (False,), units=Units(1e-3, 0.1, 1e2))
    torch.manual_seed(0)
    drag = LearnedDrag(coordinates=coordinates, speeds=1)
    module = ScaledDissipation(drag, coordinates).double()
    v = torch.tensor([[1e-3], [2e-3]]).double()
    slow, fast = (-module.force(torch.zeros_like(v), v) / v)[:, 0].tolist()  # ν a² + a³ |v|
    cube = (fast - slow) / 1e-3
    linear = slow - cube * 1e-3
    found, _ = values(module, coordinates)["drag_1.linear"]
    assert found == pytest.approx(linear / abs(cube) ** (2 / 3), rel=1e-6)
