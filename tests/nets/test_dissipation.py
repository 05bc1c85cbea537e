"""Learned dissipation: derivatives, settings, and forces that it represents."""

import itertools
from functools import partial

import pytest
import torch

from symo_exp.errors import ConfigError
from symo_exp.mechanics.dissipation import Dissipation, DissipativeLagrangian
from symo_exp.mechanics.galerkin import Galerkin
from symo_exp.mechanics.roots import Newton
from symo_exp.mechanics.space import exponential
from symo_exp.mechanics.types import Coordinates, Trajectories
from symo_exp.mechanics.windows import cut_windows
from symo_exp.models.objectives import PreconditionedResidual
from symo_exp.models.symo import SyMo
from symo_exp.models.true import TrueVariational
from symo_exp.nets.dissipation import LearnedDissipation, MachineFriction
from symo_exp.nets.drag import LearnedBodyDrag, LearnedDrag
from symo_exp.nets.embedding import directions
from symo_exp.nets.lagrangians import NetworkLagrangian
from symo_exp.optim.levenberg_marquardt import LevenbergMarquardt
from symo_exp.systems.chain import ChainPendulum
from symo_exp.training.learner import Learner
from tests.learned import double_precision
from tests.nets.test_closed_forms import BODIES, TURNING, moved
from tests.systems.models import mjcf, read
from tests.tables import arguments_of


@pytest.mark.parametrize(
    ("make", "wrong"),
    [
        (LearnedDissipation, {"joints": "chain"}),
        (LearnedDissipation, {"rest_velocity": 0.0}),
        (LearnedDissipation, {"start": 0.0}),
        (LearnedDissipation, {"width": -1}),
        (LearnedDrag, {"speeds": 0}),
        (MachineFriction, {"least_rest_velocity": 0.0}),
        (MachineFriction, {"least_rest_velocity": 0.2}),
        (MachineFriction, {"stribeck_velocity": 0.0}),
    ],
)
def test_invalid_settings_are_refused(make, wrong):
    with pytest.raises(ConfigError, match=f"dissipation.{next(iter(wrong))}=.*expected"):
        make(coordinates=Coordinates(("a",), (True,)), **wrong)


def test_a_learned_drag_represents_a_link_in_a_fluid():
    """Three speeds suffice: along the link, across it and about its centre."""
    body = '<body><joint name="x" type="slide" axis="1 0 0"/><joint name="y" type="slide" '
    body += 'axis="0 1 0"/><joint name="turn" axis="0 0 1"/><geom type="box" size="0.5 0.1 0.2"/>'
    swimmer = read(mjcf(f"{body}</body>", option='<option density="1000" viscosity="3"/>'))
    (hull,) = swimmer.mechanism["fluid"]["hulls"]
    true = swimmer.dissipation
    found = LearnedDrag(coordinates=swimmer.coordinates, speeds=3).double()
    a, b, c = hull["sides"]
    mean = (a + b + c) / 3
    fast = torch.tensor(
        [500.0 * b * c, 500.0 * a * c, 1000.0 * c * (a**4 + b**4) / 64], dtype=torch.float64
    )
    slow = 3.0 * torch.pi * torch.tensor([3.0 * mean, 3.0 * mean, mean**3], dtype=torch.float64)
    scale = fast ** (1 / 3)
    with torch.no_grad():
        weight = found.weight.zero_().unflatten(0, (3, 3))  # of cos and sin of the turning
        weight[0, 0, 0] = weight[1, 1, 0] = 1.0
        weight[0, 1, 1], weight[1, 0, 1] = 1.0, -1.0
        weight *= scale[:, None, None]
        found.bias.zero_()[-1] = scale[2]
        found.viscous.copy_(torch.log(torch.expm1(slow / scale**2)))
    q, v = 2.0 * torch.randn(2, 20, 3, dtype=torch.float64)
    torch.testing.assert_close(found.force(q, v), true.force(q, v), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("angular", list(itertools.product((True, False), repeat=3)))
def test_friction_between_neighbours_is_that_of_the_hinges_whatever_slides_are_between(angular):
    """In absolute angles the same powers as in relative ones."""
    coordinates, n = Coordinates(("a", "b", "c"), angular), 3
    hinges, world = (
        LearnedDissipation(coordinates=coordinates, coulomb=True, joints=joints).double()
        for joints in ("own", "neighbours")
    )
    with torch.no_grad():
        for p, other in zip(hinges.parameters(), world.parameters(), strict=True):
            other.copy_(p.add_(torch.rand_like(p)))
    turn, v = directions(angular).double(), torch.randn(20, n, dtype=torch.float64)
    expected = hinges.force(v, v)
    torch.testing.assert_close(world.force(v, v @ turn.T) @ turn, expected)


class Law(Dissipation):
    """Friction of one coordinate by a formula."""

    def __init__(self, formula):
        self.formula = formula

    def force(self, q, v):
        return self.formula(v)


LAWS = {
    "asymmetric viscous": (lambda v: -torch.where(v > 0, 0.3, 0.15) * v, {}),
    "asymmetric dry": (
        lambda v: -0.1 * v - (0.45 + 0.15 * torch.tanh(v / 0.1)) * torch.tanh(v / 0.1),
        {},
    ),
    "narrow dry": (lambda v: -0.1 * v - 0.4 * torch.tanh(v / 0.02), {"asymmetric": False}),
    "Stribeck": (
        lambda v: -0.1 * v - (0.3 + 0.3 * torch.exp(-((v / 0.8) ** 2))) * torch.tanh(v / 0.1),
        {"asymmetric": False, "stribeck": True},
    ),
    "constant force": (lambda v: 0.5 - 0.2 * v, {"asymmetric": False, "constant": True}),
}


@pytest.mark.parametrize(
    "law", [pytest.param(x, marks=[pytest.mark.slow] * (x != "asymmetric dry")) for x in LAWS]
)
def test_friction_of_a_simulated_machine_is_recovered(law):
    """A driven pendulum; the force to 5 % of its largest value, from motions without noise."""
    formula, options = LAWS[law]
    h = 0.02
    system = ChainPendulum(1, time_step=h)
    truth = TrueVariational(
        lagrangian=DissipativeLagrangian(system, Law(formula)), **arguments_of(system),
        integrator=Galerkin(stages=2), root=Newton(tolerance=1e-11, max_iterations=30),
    ).double()  # fmt: skip
    generator = torch.Generator().manual_seed(7)
    q, v, phase = torch.randn(3, 4, 1, dtype=torch.float64, generator=generator)
    time = h * torch.arange(120).double()[:, None]
    u = 4.0 * torch.sin((1.5 + phase[:, None]) * time + 3.0 * phase[:, None])
    path = truth.rollout(q, v, u)
    assert path.converged.all()
    samples = cut_windows(Trajectories(path.q, path.v, u).each())
    torch.manual_seed(0)
    with double_precision():
        model = SyMo(
            **arguments_of(system), objective=PreconditionedResidual(),
            integrator=Galerkin(stages=2), root=Newton(),
            lagrangian=partial(NetworkLagrangian, width=2, depth=1, harmonics=1),
            dissipation=lambda *, coordinates: MachineFriction(coordinates=coordinates, **options),
        )  # fmt: skip
    learner, optimizer = Learner(model), LevenbergMarquardt(model.parameters())
    for _ in range(20):
        optimizer.epoch(learner, [samples])
    speed = torch.linspace(0.1, 3.0, 30, dtype=torch.float64)
    speed = torch.cat((-speed, speed)).unsqueeze(1)
    with torch.no_grad():
        found = model.dissipation.force(torch.zeros_like(speed), speed)
    expected = formula(speed)
    assert (found - expected).abs().max() < 0.05 * expected.abs().max()


@pytest.mark.parametrize("coordinates", BODIES.values(), ids=BODIES)
def test_the_drag_of_a_body_takes_energy_and_turns_with_the_world(coordinates):
    drag, n = moved(LearnedBodyDrag(coordinates=coordinates), 0.5), coordinates.n
    q = coordinates.space.of_vector(torch.randn(20, n, dtype=torch.float64))
    v = torch.randn(20, n, dtype=torch.float64)
    force = drag.force(q, v)
    assert bool(((force * v).sum(1) < 0.0).all())
    assert not bool(drag.force(q, torch.zeros_like(v)).any())
    turn = exponential(torch.tensor([0.3, -0.8, 0.5], dtype=torch.float64))
    turned_q, turned_v, turned_force = q.clone(), v.clone(), force.clone()
    turned_q[:, -9:] = (turn @ q[:, -9:].view(-1, 3, 3)).flatten(1)
    for x in (turned_v, turned_force):
        x[:, : n - 3] = x[:, : n - 3] @ turn.T[: n - 3, : n - 3]
    torch.testing.assert_close(drag.force(turned_q, turned_v), turned_force)


def test_the_drag_of_a_body_is_refused_for_other_coordinates():
    with pytest.raises(ConfigError, match="dissipation=body_drag is for one body"):
        LearnedBodyDrag(coordinates=Coordinates(("a",), (True,)))
    with pytest.raises(ConfigError, match=r"dissipation\.radius=0"):
        LearnedBodyDrag(coordinates=Coordinates.of(rotations=("R",)), radius=0.0)


@pytest.mark.parametrize("coordinates", TURNING, ids=lambda c: str(c.n))
@pytest.mark.parametrize("make", [LearnedDissipation, MachineFriction])
def test_a_network_of_rotations_takes_energy_and_has_its_derivatives(make, coordinates):
    """Along ``R exp φ``."""
    torch.manual_seed(0)
    friction = moved(make(coordinates=coordinates, width=5), 0.3)
    space, (x, v) = coordinates.space, torch.randn(2, 6, coordinates.n, dtype=torch.float64)
    q = space.of_vector(x)
    assert ((friction.force(q, v) * v).sum(1) < 0).all()
    torch.testing.assert_close(friction.derivatives(q, v), Dissipation.derivatives(friction, q, v))
