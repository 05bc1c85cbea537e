"""The learned Lagrangian: closed forms against automatic differentiation, and its structure."""

import pytest
import torch

from symo_exp.errors import ConfigError
from symo_exp.mechanics.lagrangian import AutodiffExpansion, Lagrangian
from symo_exp.mechanics.types import Coordinates
from symo_exp.nets.embedding import Embedding
from symo_exp.nets.lagrangians import NetworkLagrangian
from symo_exp.nets.structured_lagrangian import StructuredLagrangian
from symo_exp.systems.chain import ChainPendulum
from tests.learned import assert_each_sample_alone, assert_same, learned_lagrangian
from tests.systems.models import DRONE, read

ANGULAR = [(True,), (False,), (False, True), (True, True), (True, False, True), (True,) * 4]
KINDS = [
    {},
    {"harmonics": 2},
    {"squares": True},
    {"squares": True, "relative": True},
    {"relative": True},
]
CASES = [
    *((angular, kind) for angular in ANGULAR for kind in KINDS),
    *(((True, False), {"depth": depth}) for depth in (1, 3)),
    *((angular, {"rotations": r}) for angular, r in (((), 1), ((True, False), 1), ((True,), 2))),
]


class Plain(Lagrangian):
    """The same Lagrangian without its closed forms: the oracle."""

    def __init__(self, learned):
        self.learned = learned

    @property
    def space(self):
        return self.learned.space

    def mass_matrix(self, q):
        return self.learned.mass_matrix(q)

    def potential(self, q):
        return self.learned.potential(q)


@pytest.fixture(params=CASES, ids=str)
def learned(request):
    angular, kind = request.param
    return learned_lagrangian(angular, **kind)


def points(learned):
    generator = torch.Generator().manual_seed(3)
    q, v = torch.randn(2, 9, learned.head.n, dtype=torch.float64, generator=generator)
    return learned.space.of_vector(q).requires_grad_(), v.requires_grad_()


@pytest.mark.parametrize("quantity", ["gradients", "rates"])
def test_closed_forms_and_their_derivatives_are_those_of_autograd(learned, quantity):
    q, v = points(learned)
    closed, plain = (getattr(x, quantity)(q, v) for x in (learned, Plain(learned)))
    assert_same(closed, plain, [q, v, *learned.parameters()], 1e-12)


def test_each_gradient_can_be_differentiated_alone(learned):
    q, v = points(learned)
    for i in range(2):
        closed = torch.autograd.grad(learned.gradients(q, v)[i].sin().sum(), q)[0]
        plain = torch.autograd.grad(Plain(learned).gradients(q, v)[i].sin().sum(), q)[0]
        torch.testing.assert_close(closed, plain, atol=1e-11, rtol=1e-11)


def test_curvature_is_that_of_autograd(learned):
    q, v = (x.detach() for x in points(learned))
    closed = learned.expand(q, v).curvature()
    plain = AutodiffExpansion(Plain(learned), q, v).curvature()
    for mine, oracle in zip(closed, plain, strict=True):
        torch.testing.assert_close(mine, oracle, atol=1e-11, rtol=1e-11)


def test_inertia_is_positive_definite_for_any_weights(learned):
    with torch.no_grad():
        for parameter in learned.net.parameters():
            parameter.normal_(std=3.0)
        q = 100.0 * torch.randn(200, learned.head.n, dtype=torch.float64)
        if learned.space.rotations:
            q = learned.space.of_vector(0.01 * q)
        mass = learned.mass_matrix(q)
    assert torch.equal(mass, mass.mT)
    assert torch.linalg.eigvalsh(mass).min() > 0.0


def test_angles_are_periodic_and_translations_are_not(learned):
    q, v = (x.detach() for x in points(learned))
    owner = learned.embedding.owner.tolist()  # an angle owns a cosine and a sine
    for i in range(len(learned.embedding.selection.T)):
        turned = q.clone()
        turned[:, i] += 2 * torch.pi
        same = torch.allclose(learned.energy(turned, v), learned.energy(q, v), atol=1e-9)
        assert same == (owner.count(i) == 2)


def test_embedding_lists_translations_then_cosines_then_sines():
    q = torch.tensor([[0.1, 2.0, 0.3]])
    x = Embedding(angular=(True, False, True))(q).x
    expected = [2.0, *torch.cos(q[0, [0, 2]]).tolist(), *torch.sin(q[0, [0, 2]]).tolist()]
    torch.testing.assert_close(x[0], torch.tensor(expected))


def test_derivatives_sample_by_sample_are_those_of_each_sample_alone(learned):
    assert_each_sample_alone(learned, *(x.detach()[:3] for x in points(learned)))


def test_harmonics_of_rotations_are_refused():
    coordinates = Coordinates.of(("a",), (True,), ("R",))
    with pytest.raises(ConfigError, match="harmonics are of angles") as error:
        NetworkLagrangian(coordinates=coordinates, width=4, harmonics=1)
    assert "\n" not in str(error.value)


def test_forces_on_free_bodies_turn_with_them():
    """Those of a network are those of the system, wherever its pose is among the coordinates."""
    system = read(DRONE)
    q, _, u = system.points(5, seed=0)
    learned = NetworkLagrangian(coordinates=system.coordinates, width=4)
    force = learned.input_force(system.input_matrix, q, u)
    torch.testing.assert_close(force, system.input_force(system.input_matrix, q, u))
    assert not torch.allclose(force, u @ system.input_matrix.T)


@pytest.mark.parametrize("initial_inertia", [0.2, 1.0, 30.0])
@pytest.mark.parametrize("angular", [(True,), (False, True), (True,) * 5])
def test_training_starts_near_the_given_inertia(angular, initial_inertia):
    learned = StructuredLagrangian(angular=angular, width=64, initial_inertia=initial_inertia)
    q = 2.0 * torch.pi * torch.rand(200, len(angular))
    spectrum = torch.linalg.eigvalsh(learned.mass_matrix(q) / initial_inertia)
    assert spectrum.min() > 0.1
    assert spectrum.max() < 10.0


def test_an_inertia_that_is_not_positive_is_refused():
    with pytest.raises(ConfigError, match="initial_inertia=0"):
        StructuredLagrangian(angular=(True,), width=4, initial_inertia=0.0)


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
