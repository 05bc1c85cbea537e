"""The learned Lagrangian: its structure and its start."""

import pytest
import torch

from symo_exp.errors import ConfigError
from symo_exp.mechanics.types import Coordinates
from symo_exp.nets.lagrangians import NetworkLagrangian
from symo_exp.nets.structured_lagrangian import StructuredLagrangian
from symo_exp.systems.chain import ChainPendulum
from tests.learned import learned_lagrangian
from tests.nets.test_closed_forms import NETWORKS
from tests.systems.models import DRONE, read


@pytest.fixture(params=NETWORKS, ids=str)
def learned(request):
    angular, kind = request.param
    return learned_lagrangian(angular, **kind)


def test_angles_are_periodic_and_translations_are_not(learned):
    generator = torch.Generator().manual_seed(3)
    q, v = torch.randn(2, 9, learned.head.n, dtype=torch.float64, generator=generator)
    q = learned.space.of_vector(q)
    owner = learned.embedding.owner.tolist()  # an angle owns a cosine and a sine
    for i in range(len(learned.embedding.selection.T)):
        turned = q.clone()
        turned[:, i] += 2 * torch.pi
        same = torch.allclose(learned.energy(turned, v), learned.energy(q, v), atol=1e-9)
        assert same == (owner.count(i) == 2)


def test_harmonics_of_rotations_are_refused():
    coordinates = Coordinates.of(("a",), (True,), ("R",))
    with pytest.raises(ConfigError, match="harmonics are of angles"):
        NetworkLagrangian(coordinates=coordinates, width=4, harmonics=1)


def test_forces_on_free_bodies_turn_with_them():
    """Those of a network are those of the system, wherever its pose is among the coordinates."""
    system = read(DRONE)
    q, _, u = system.points(5, seed=0)
    learned = NetworkLagrangian(coordinates=system.coordinates, width=4)
    force = learned.input_force(system.input_matrix, q, u)
    torch.testing.assert_close(force, system.input_force(system.input_matrix, q, u))
    assert not torch.allclose(force, u @ system.input_matrix.T)


@pytest.mark.parametrize("initial_inertia", [0.2, 1.0, 30.0, 1e7])
@pytest.mark.parametrize("angular", [(True,), (False, True), (True,) * 5])
def test_training_starts_near_the_given_inertia(angular, initial_inertia):
    learned = StructuredLagrangian(angular=angular, width=64, initial_inertia=initial_inertia)
    q = 2.0 * torch.pi * torch.rand(200, len(angular))
    spectrum = torch.linalg.eigvalsh(learned.mass_matrix(q) / initial_inertia)
    assert spectrum.min() > 0.1
    assert spectrum.max() < 10.0


@pytest.mark.parametrize("initial_inertia", [1e-12, 1e-3, 50.0])
@pytest.mark.parametrize("angular", [(True,), (False, True), (True,) * 3])
def test_the_initial_inertia_is_the_scale_of_inertia_and_potential(angular, initial_inertia):
    """So that free motions at the start of training do not depend on it."""
    q = 2.0 * torch.pi * torch.rand(20, len(angular), dtype=torch.float64)
    scale = {"squares": {}, "factor": {}}
    for kind in scale:
        for inertia in (1.0, initial_inertia):
            torch.manual_seed(0)
            learned = StructuredLagrangian(
                angular=angular, width=8, initial_inertia=inertia, squares=kind == "squares"
            ).double()
            mass = learned.mass_matrix(q).diagonal(dim1=1, dim2=2)
            scale[kind][inertia] = mass / inertia, learned.potential(q) / inertia
    for kind, tolerance in (("squares", 1e-4), ("factor", 0.5)):
        one, other = scale[kind].values()
        torch.testing.assert_close(one, other, rtol=tolerance, atol=1e-6)


@pytest.mark.parametrize("wrong", [{"initial_inertia": 0.0}, {"harmonics": -1}])
def test_invalid_settings_are_refused(wrong):
    with pytest.raises(ConfigError, match=f"lagrangian.{next(iter(wrong))}=.*expected"):
        StructuredLagrangian(angular=(True,), width=4, **wrong)


def test_default_initialisation_is_that_of_the_published_code():
    """Hidden layers Xavier-uniform with the gain 5/3 of tanh, the last as PyTorch has it."""
    learned = StructuredLagrangian(angular=(True, True), width=256, initial_inertia=None)
    *hidden, (last, last_bias) = learned.net.layers()
    for weight, bias in hidden:
        bound = 5 / 3 * (6 / sum(weight.shape)) ** 0.5
        assert weight.abs().max() <= bound
        assert weight.std().item() == pytest.approx(bound / 3**0.5, rel=0.1)
        assert not bias.any()
    assert last.abs().max() <= 1 / 16
    assert last.std().item() == pytest.approx(1 / 16 / 3**0.5, rel=0.1)
    assert 0 < last_bias.abs().max() <= 1 / 16


@pytest.mark.parametrize("links", [1, 2, 3])
@pytest.mark.parametrize("relative", [False, True])
def test_links_in_a_plane_are_represented_exactly(links, relative):
    """A chain on a slide with rotors in its joints, represented without a hidden layer."""
    angles = torch.eye(links + 1)[1:]
    if relative:
        angles = angles.cumsum(0)  # of the links in the coordinates
    angular = (False,) + (True,) * links
    learned = StructuredLagrangian(
        angular=angular, width=1, squares=True, relative=relative
    ).double()
    ((weight, bias),) = learned.net.layers()
    with torch.no_grad():
        weight.zero_(), bias.zero_()
        rows = weight[:-1].view(links + 1, -1, 1 + 2 * links)  # of L: 2n columns, one of its own
        constant = bias[:-1].view(links + 1, -1)
        constant[0, :links], constant[:, -1] = 1.0, 0.5  # the slide moves every mass
        for mass in range(links):
            for link in range(mass + 1):
                for coordinate in angles[link].nonzero().flatten():
                    rows[coordinate, mass, 1 + link] = 1.0  # cos, sideways
                    rows[coordinate, links + mass, 1 + links + link] = 1.0  # sin, up
        weight[-1, 1 : 1 + links] = -torch.arange(links, 0, -1)
    chain = ChainPendulum(links, gravity=1.0)
    q = torch.randn(50, links + 1, dtype=torch.float64)
    turned = q @ angles.double().T
    jacobian = angles[:, 1:].double()
    expected = jacobian.T @ chain.mass_matrix(turned) @ jacobian + 0.25 * torch.eye(links)
    torch.testing.assert_close(learned.mass_matrix(q)[:, 1:, 1:], expected, atol=1e-8, rtol=0)
    torch.testing.assert_close(learned.potential(q), chain.potential(turned))
