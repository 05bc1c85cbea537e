"""Learned links in a plane represent chains of rigid bodies exactly."""

import pytest
import torch

from symo_exp.errors import ConfigError
from symo_exp.mechanics.types import Coordinates
from symo_exp.nets.embedding import directions
from symo_exp.nets.planar_links import PlanarLinks
from tests.systems.every import FLAT, points


def is_planar(system) -> bool:
    """Whether a system is a chain in a plane, its slides before its hinges."""
    linkage, angular = system.linkage, system.coordinates.angular
    if linkage is None or sorted(angular) != list(angular) or angular.count(False) > 1:
        return False
    axes = torch.tensor([joint.axis for joint in linkage.joints])
    hinges = axes[torch.tensor(angular)]
    turning = hinges.abs() @ hinges.abs().T
    across = (hinges @ axes[~torch.tensor(angular)].T).abs().sum()
    serial = all(joint.parent == i - 1 for i, joint in enumerate(linkage.joints))
    springs = any(joint.stiffness for joint in linkage.joints)
    return serial and not springs and bool((turning > 0.999).all()) and float(across) < 1e-9


PLANAR = {name: system for name, system in FLAT.items() if is_planar(system)}


def links_of(system) -> PlanarLinks:
    """The links of a planar chain, from the harmonics of its inertia and potential."""
    coordinates, n = system.coordinates, system.coordinates.n
    angular = torch.tensor(coordinates.angular)
    relative = torch.equal(system.linkage.matrix, torch.eye(n).double())
    links = PlanarLinks(coordinates=coordinates, relative=relative).double()
    grid = torch.arange(5).double() * (2.0 * torch.pi / 5.0)
    s = torch.cartesian_prod(*[grid] * n).view(-1, n) * angular
    back = torch.linalg.inv(links.turn)
    mass = back.T @ system.mass_matrix(s @ back.T) @ back
    phase = torch.exp(1j * (s[:, None, :] - s[:, :, None]))
    turns = (angular[:, None] | angular) & ~torch.eye(n).bool()
    waves = 1.0 + turns.double()
    products = (waves * (mass * phase.conj()).mean(0)).numpy()
    sizes, vectors = torch.linalg.eigh(torch.tensor(products))
    found = sizes.clamp(min=0.0).sqrt()[:, None] * vectors.mH
    potential = system.potential(s @ back.T)
    weights = 2.0 * (potential[:, None] * torch.exp(-1j * s)).mean(0) * angular
    with torch.no_grad():
        links.points.copy_(torch.cat((found.real.T, found.imag.T), dim=1).flatten())
        links.weights.copy_(torch.cat((weights.real, weights.imag)))
        links.inertias.zero_()
        if links.rotors is not None:
            links.rotors.zero_()
    return links


@pytest.mark.parametrize("name", PLANAR)
def test_any_chain_of_links_in_a_plane_is_represented_exactly(name):
    system = PLANAR[name]
    q, *_ = points(system, 6)
    links = links_of(system)
    torch.testing.assert_close(links.mass_matrix(q), system.mass_matrix(q), rtol=1e-9, atol=1e-8)
    height = links.potential(q) - system.potential(q)  # up to a constant
    torch.testing.assert_close(height, height[:1].expand_as(height), rtol=1e-9, atol=1e-9)


def test_rotors_turn_with_the_joints():
    """In absolute angles with the difference of two directions."""
    coordinates = Coordinates(("x", "a", "b"), (False, True, True))
    rates = torch.randn(3).double()
    for relative in (True, False):
        links = PlanarLinks(coordinates=coordinates, relative=relative).double()
        with torch.no_grad():
            for parameter in links.parameters():
                parameter.zero_()
            assert links.rotors is not None
            links.rotors.fill_(0.5)
        joints = (
            rates
            if relative
            else torch.linalg.inv(directions(coordinates.angular)).double() @ rates
        )
        energy = links.kinetic(torch.randn(1, 3).double(), rates[None])
        torch.testing.assert_close(energy, 0.5 * (0.5 * joints[2:]).square())


def test_a_negative_initial_inertia_is_refused():
    with pytest.raises(ConfigError, match=r"lagrangian\.initial_inertia=-1"):
        PlanarLinks(coordinates=Coordinates(("a",), (True,)), initial_inertia=-1.0)
