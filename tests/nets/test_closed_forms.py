"""Closed forms of every learned Lagrangian against automatic differentiation, one table of all."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import pytest
import torch

from symo_exp.mechanics.dissipation import DissipativeLagrangian
from symo_exp.mechanics.lagrangian import AutodiffExpansion, Lagrangian
from symo_exp.mechanics.scaled import ScaledLagrangian
from symo_exp.mechanics.types import Coordinates
from symo_exp.nets.dissipation import LearnedDissipation, MachineFriction
from symo_exp.nets.drag import LearnedBodyDrag
from symo_exp.nets.known import KnownLagrangian
from symo_exp.nets.planar_links import PlanarLinks
from symo_exp.nets.rigid_body import LearnedRigidBody
from symo_exp.nets.rigid_chain import RigidChain
from symo_exp.nets.springs import LinearSprings, SprungLagrangian
from tests.dissipative import LEARNED, UNITS
from tests.learned import assert_each_sample_alone, assert_same, learned_lagrangian
from tests.systems import models
from tests.systems.every import SYSTEMS

KINDS = (
    {},
    {"harmonics": 2},
    {"squares": True},
    {"squares": True, "relative": True},
    {"relative": True},
)
NETWORKS = [
    *((angular, kind)
      for angular in ((True,), (False,), (False, True), (True, True), (True, False, True),
                      (True,) * 4)
      for kind in KINDS),
    *(((True, False), {"depth": depth}) for depth in (1, 3)),
    *((angular, {"rotations": r}) for angular, r in (((), 1), ((True, False), 1), ((True,), 2))),
]  # fmt: skip
CHAINS = [(True,), (False,), (False, True, True), (True, False, True, True), (True,) * 7]
PLANAR = [*CHAINS, (True, True), (False, False), (True, False, False, True)]
PIVOT = Coordinates.of(rotations=("R",))
FREE = Coordinates.of(("x", "y", "z"), (False,) * 3, ("R",), [(0, 0)])
BODIES = {"pivot": PIVOT, "free": FREE}
BODY_KINDS: dict[str, dict[str, Any]] = {
    "parameters": {},
    "inputs": {"learned_inputs": 2},
    "networks": {"learned_inputs": 2, "potential_width": 5, "input_width": 4, "radius": 0.5},
}
SPRUNG = [
    Coordinates(("x",), (False,)),
    Coordinates(("x", "a", "b"), (False, True, True)),
    FREE,
]
TURNING = [
    PIVOT,
    Coordinates.of(("x", "a"), (False, True), ("R",)),
    Coordinates.of(("x", "y", "z"), (False,) * 3, ("R", "S")),
]


def moved(module: Any, size: float) -> Any:
    """The module in float64 after a random step in its parameters."""
    with torch.no_grad():
        for p in module.double().parameters():
            p += size * torch.randn_like(p)
    return module


def known(system: Any) -> Lagrangian:
    return moved(KnownLagrangian(system=system), 0.1)


def chain(angular: tuple[bool, ...]) -> Lagrangian:
    names = tuple(f"q{i}" for i in range(len(angular)))
    return RigidChain(coordinates=Coordinates(names, angular)).double()


def planar(angular: tuple[bool, ...], relative: bool) -> Lagrangian:
    names = tuple(f"q{i}" for i in range(len(angular)))
    return moved(PlanarLinks(coordinates=Coordinates(names, angular), relative=relative), 0.3)


def body(coordinates: Coordinates, **kind: Any) -> Lagrangian:
    return moved(LearnedRigidBody(coordinates=coordinates, **kind), 0.3)


def sprung(coordinates: Coordinates) -> Lagrangian:
    """Links in a plane, or a body, with random springs."""
    springs = moved(LinearSprings(coordinates=coordinates), 0.5)
    if coordinates.rotations:
        return SprungLagrangian(body(coordinates), springs)
    return SprungLagrangian(learned_lagrangian(coordinates.angular, squares=True), springs)


def scaled(coordinates: Coordinates) -> Lagrangian:
    """The same, with parameters in units of their own."""
    units = coordinates._replace(units=UNITS)
    return ScaledLagrangian(sprung(coordinates), units).double()


CONSERVATIVE: dict[str, tuple[Callable[[], Lagrangian], int]] = {
    **{f"network {angular} {kind}": (partial(learned_lagrangian, angular, **kind),
                                     len(angular) + 3 * kind.get("rotations", 0))
       for angular, kind in NETWORKS},
    **{f"known {name}": (partial(known, system), system.coordinates.n)
       for name, system in (SYSTEMS | {"crane": models.read(models.CRANE)}).items()},
    **{f"chain {angular}": (partial(chain, angular), len(angular)) for angular in CHAINS},
    **{f"planar links {angular} {relative}": (partial(planar, angular, relative), len(angular))
       for angular in PLANAR for relative in (True, False)},
    **{f"body {name} {kind}": (partial(body, coordinates, **settings), coordinates.n)
       for name, coordinates in BODIES.items() for kind, settings in BODY_KINDS.items()},
    **{f"{make.__name__} {where.names}": (partial(make, where), where.n)
       for make in (sprung, scaled) for where in SPRUNG},
}  # fmt: skip
"""Name: how to make a Lagrangian, and its number of coordinates."""


def dragged(coordinates: Coordinates) -> Lagrangian:
    drag = moved(LearnedBodyDrag(coordinates=coordinates), 0.5)
    return DissipativeLagrangian(body(coordinates), drag)


def turning(kind: Any, coordinates: Coordinates) -> Lagrangian:
    """A network of coordinates with rotations, with friction of that kind."""
    flat = coordinates.angular[: len(coordinates.flat)]
    network = learned_lagrangian(flat, rotations=len(coordinates.rotations))
    return DissipativeLagrangian(network, moved(kind(coordinates=coordinates, width=5), 0.3))


DISSIPATIVE: dict[str, tuple[Callable[[], Lagrangian], int]] = {
    **{f"{kind} {n}": (partial(make, n), n) for kind, make in LEARNED.items() for n in (1, 2, 3)},
    **{f"drag {name}": (partial(dragged, coordinates), coordinates.n)
       for name, coordinates in BODIES.items()},
    **{f"{kind.__name__} {where.n}": (partial(turning, kind, where), where.n)
       for kind in (LearnedDissipation, MachineFriction) for where in TURNING},
}  # fmt: skip


class Plain(Lagrangian):
    """The same Lagrangian without its closed forms: the oracle."""

    def __init__(self, learned: Lagrangian) -> None:
        self.learned = learned

    @property
    def space(self):
        return self.learned.space

    def mass_matrix(self, q):
        return self.learned.mass_matrix(q)

    def potential(self, q):
        return self.learned.potential(q)


def made(entry: tuple[Callable[[], Lagrangian], int], rows: int):
    """A Lagrangian of the table, with configurations and velocities."""
    make, n = entry
    torch.manual_seed(5)
    lagrangian = make()
    generator = torch.Generator().manual_seed(3)
    q, v = torch.randn(2, rows, n, dtype=torch.float64, generator=generator)
    return lagrangian, lagrangian.space.of_vector(q), v


@pytest.fixture(params=CONSERVATIVE)
def case(request):
    return made(CONSERVATIVE[request.param], 6)


@pytest.mark.parametrize("quantity", ["gradients", "rates"])
def test_closed_forms_and_their_derivatives_are_those_of_autograd(case, quantity):
    lagrangian, q, v = case
    q, v = q.requires_grad_(), v.requires_grad_()
    closed, plain = (getattr(x, quantity)(q, v) for x in (lagrangian, Plain(lagrangian)))
    known = isinstance(lagrangian, KnownLagrangian)  # in the units of its system
    size = max(1.0, *(float(x.detach().abs().max()) for x in plain)) if known else 1.0
    assert_same(closed, plain, [q, v, *lagrangian.parameters()], 1e-12 * size)


def test_each_gradient_can_be_differentiated_alone(case):
    lagrangian, q, v = case
    q.requires_grad_()
    for i in range(2):
        closed, plain = (
            torch.autograd.grad(x.gradients(q, v)[i].sin().sum(), q, materialize_grads=True)[0]
            for x in (lagrangian, Plain(lagrangian))
        )
        torch.testing.assert_close(closed, plain, atol=1e-11, rtol=1e-11)


def test_curvature_is_that_of_autograd(case):
    lagrangian, q, v = case
    closed = lagrangian.expand(q, v).curvature()
    plain = AutodiffExpansion(Plain(lagrangian), q, v).curvature()
    for mine, oracle in zip(closed, plain, strict=True):
        torch.testing.assert_close(mine, oracle, atol=1e-11, rtol=1e-11)


@pytest.mark.parametrize("name", CONSERVATIVE)
def test_inertia_is_positive_definite_for_any_parameters(name):
    lagrangian, q, _ = made(CONSERVATIVE[name], 200)
    if not lagrangian.space.rotations:
        q = 100.0 * q
    spread = 3.0 if name.startswith("network") else 1.0  # others have logarithms and roots
    with torch.no_grad():
        for p in lagrangian.parameters():
            p += spread * torch.randn_like(p)
        mass = lagrangian.mass_matrix(q)
    assert torch.equal(mass, mass.mT)
    assert torch.linalg.eigvalsh(mass).min() > 0.0


@pytest.mark.parametrize("name", [*CONSERVATIVE, *DISSIPATIVE])
def test_derivatives_sample_by_sample_are_those_of_each_sample_alone(name):
    assert_each_sample_alone(*made((CONSERVATIVE | DISSIPATIVE)[name], 3))
