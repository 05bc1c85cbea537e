"""Rotations: charts, geodesic integrators, Munthe-Kaas steps, against differences and laws."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from symo_exp.errors import ConfigError
from symo_exp.mechanics.chart import Controlled
from symo_exp.mechanics.dissipation import DissipativeLagrangian, Friction
from symo_exp.mechanics.euler_lagrange import acceleration
from symo_exp.mechanics.explicit import RK4, DormandPrince5, Midpoint
from symo_exp.mechanics.galerkin import Galerkin, legendre
from symo_exp.mechanics.geodesic import Geodesic, on_space
from symo_exp.mechanics.lagrangian import Lagrangian, matvec, vecmat
from symo_exp.mechanics.rigid_body import BodyParameters, RigidBodyLagrangian, in_world
from symo_exp.mechanics.roots import Broyden, Newton
from symo_exp.mechanics.space import (
    FLAT,
    ExponentialMap,
    Space,
    cross,
    exponential,
    of_quaternion,
    quaternion,
    rotation_vector,
)
from symo_exp.mechanics.variational import (
    DiscreteLagrangian,
    Forces,
    VariationalIntegrator,
    VariationalMidpoint,
)
from tests.differences import assert_gradients, slopes, slopes_by_rows
from tests.mechanics import trace_form
from tests.mechanics.motions import ROUNDING

H = 0.1
ROOT = Newton(tolerance=1e-13, max_iterations=30)
STAGES = (1, 2, 3)


class Body(RigidBodyLagrangian):
    """A body of no symmetry in a gravity of any direction."""

    def __init__(self) -> None:
        generator = torch.Generator().manual_seed(3)
        factor = torch.randn(4, 4, generator=generator, dtype=torch.float64)
        self.pseudo = factor @ factor.T + 0.2 * torch.eye(4)
        self.gravity = torch.tensor([0.4, -0.3, -2.0], dtype=torch.float64)

    def rigid_body(self, like: Tensor) -> BodyParameters:
        return BodyParameters.of_pseudo_inertia(
            self.pseudo[None].to(like), self.gravity[None].to(like)
        )

    def input_force(self, input_matrix: Tensor, q: Tensor, u: Tensor) -> Tensor:
        return in_world(q, u @ input_matrix.T)


class Wheels(Lagrangian):
    """A length, an angle and two rotations, coupled through inertia, potential and controls."""

    space = Space(rotations=2)

    def mass_matrix(self, q: Tensor) -> Tensor:
        base = torch.diag(torch.arange(2.0, 10.0).to(q))
        first, second = self.space.rotation_matrices(q).unbind(1)
        mixed = q.new_zeros(len(q), 8, 8)
        mixed[:, 2:5, 5:8] = 0.3 * first.mT @ second
        mixed[:, 0, 2:5] = 0.2 * first[:, 0] * q[:, 1:2].cos()
        return base + mixed + mixed.mT

    def potential(self, q: Tensor) -> Tensor:
        first, second = self.space.rotation_matrices(q).unbind(1)
        return first[:, 2, 0] * q[:, 1].sin() + second[:, 1, 2] + q[:, 0] * second[:, 0, 0]

    def input_force(self, input_matrix: Tensor, q: Tensor, u: Tensor) -> Tensor:
        turned = self.space.rotation_matrices(q)[:, 0] @ input_matrix[5:] @ u.unsqueeze(-1)
        return torch.cat(((u @ input_matrix.T)[:, :5], turned.squeeze(-1)), dim=1)


def damped(lagrangian: Lagrangian, n: int) -> Lagrangian:
    """With friction, viscous and dry."""
    viscous = torch.diag(torch.linspace(0.1, 0.5, n).double())
    return DissipativeLagrangian(lagrangian, Friction(viscous, torch.full((n,), 0.2).double(), 0.5))


CASES = {"pivot": (Body(), 3), "free": (Body(), 6), "wheels": (Wheels(), 8)}
CASES |= {f"damped {name}": (damped(one, n), n) for name, (one, n) in CASES.items()}
every_case = pytest.mark.parametrize("name", ["pivot", "free", "damped free", "damped wheels"])


def drawn(n: int, *, rows: int = 4, seed: int = 0, scale: float = 1.0) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return scale * torch.randn(rows, n, generator=generator, dtype=torch.float64)


def state(name: str, rows: int = 4) -> tuple[Controlled, Tensor, Tensor, Forces]:
    """A Lagrangian with two controls, states, and the controls at both ends of a step."""
    lagrangian, n = CASES[name]
    q, v = lagrangian.space.of_vector(drawn(n, rows=rows, seed=1)), drawn(n, rows=rows, seed=2)
    controls = Forces(drawn(2, rows=rows, seed=3), drawn(2, rows=rows, seed=4))
    return Controlled(lagrangian, drawn(2, rows=n, seed=5)), q, v, controls


# Charts


@pytest.mark.parametrize("size", [0.0, 1e-9, 1e-3, 1.0, 3.0, math.pi])
def test_exponential_and_its_inverse(size: float) -> None:
    phi = drawn(3, rows=50)
    phi = size * phi / phi.norm(dim=1, keepdim=True)
    turn = exponential(phi)
    torch.testing.assert_close(turn, torch.linalg.matrix_exp(cross(phi)), rtol=0, atol=1e-14)
    torch.testing.assert_close(exponential(rotation_vector(turn)), turn, rtol=0, atol=2e-15)
    if size < 3.1:
        torch.testing.assert_close(rotation_vector(turn), phi, rtol=0, atol=1e-14)


@pytest.mark.parametrize("size", [0.0, 5.0, 6.5, 10.0, 200.0])
def test_a_rotation_vector_of_any_length_is_a_rotation(size: float) -> None:
    x = drawn(4, rows=20)
    phi = x[:, 1:] = size * x[:, 1:] / x[:, 1:].norm(dim=1, keepdim=True)
    found = Space(1).of_vector(x)
    rotation = torch.linalg.matrix_exp(cross(phi)).flatten(1)
    torch.testing.assert_close(found, torch.cat((x[:, :1], rotation), 1), rtol=0, atol=1e-12)
    assert torch.autograd.gradcheck(Space(1).of_vector, x[:2].requires_grad_())


def test_derivatives_of_the_inverse_are_finite_and_right_at_the_identity() -> None:
    for size in (0.0, 1e-8, 1e-5, 1.0):
        phi = drawn(3, rows=1, scale=size)
        assert torch.autograd.gradcheck(
            lambda x: rotation_vector(exponential(x)), phi.requires_grad_()
        )
        assert torch.autograd.gradgradcheck(lambda x: rotation_vector(exponential(x)), phi)


@pytest.mark.parametrize("size", [0.0, 1e-3, 1.0, 3.0])
def test_slopes_of_the_exponential_map(size: float) -> None:
    phi, x, p = drawn(3), drawn(3, seed=1), drawn(3, seed=2)
    phi = size * phi / phi.norm(dim=1, keepdim=True)
    at = ExponentialMap.of(phi)
    twice = ExponentialMap.of(2.0 * phi)
    identity = torch.eye(3, dtype=torch.float64).expand(4, 3, 3)
    torch.testing.assert_close(at.inverse_of_twice() @ twice.jacobian(), identity)

    def mapped(matrix: Callable[[ExponentialMap], Tensor]) -> Tensor:
        return slopes(lambda y: matvec(matrix(ExponentialMap.of(y)), x), phi)

    close = functools.partial(torch.testing.assert_close, atol=1e-8, rtol=1e-7)
    close(at.jacobian_slope(x), mapped(ExponentialMap.jacobian))
    close(at.transposed_slope(x), mapped(lambda y: y.jacobian().mT))
    close(at.inverse_of_twice_slope(x), mapped(ExponentialMap.inverse_of_twice))
    slope = slopes(lambda y: vecmat(p, ExponentialMap.of(y).jacobian_slope(x)), phi)
    close(at.jacobian_bend(p, x), slope)


def test_a_quaternion_of_either_sign_and_any_length_is_one_rotation() -> None:
    q = drawn(4, rows=50)
    turn = of_quaternion(q)
    for other in (-q, 1.001 * q):
        torch.testing.assert_close(of_quaternion(other), turn, rtol=0, atol=1e-14)
    found = quaternion(turn)
    assert (found[:, 0] >= 0).all()
    sign = torch.where(q[:, :1] < 0, -1.0, 1.0)
    torch.testing.assert_close(found, sign * q / q.norm(dim=1, keepdim=True), rtol=0, atol=1e-14)


@pytest.mark.parametrize(("space", "n"), [(FLAT, 4), (Space(1), 3), (Space(1), 5), (Space(2), 7)])
def test_maps_of_a_space_belong_together(space: Space, n: int) -> None:
    q, step = space.of_vector(drawn(n)), drawn(n, seed=1, scale=0.5)
    after = space.retract(q, step)
    assert q.shape[1] == space.stored(n)
    torch.testing.assert_close(space.difference(q, after), step)
    torch.testing.assert_close(space.point(q, space.chart(q, after)), after)
    torch.testing.assert_close(space.point(q, space.origin(q)), q)
    torch.testing.assert_close(space.extrapolated(q, after), space.retract(after, step))
    torch.testing.assert_close(space.middle(q, after), space.retract(q, 0.5 * step))
    torch.testing.assert_close(space.normalised(after + 1e-9), after, rtol=0, atol=1e-8)
    rate = torch.func.jvp(lambda s: space.retract(q, s), (torch.zeros_like(step),), (step,))[1]
    torch.testing.assert_close(space.push(q, step), rate)
    torch.testing.assert_close(space.velocity(q, rate), step)
    gradient = drawn(q.shape[1], seed=2)
    torch.testing.assert_close(
        (space.pull(q, gradient) * step).sum(1), (gradient * rate).sum(1)
    )  # the adjoint


# Derivatives


def geodesic(space: Space, stages: int) -> VariationalIntegrator:
    return on_space(Galerkin(stages=stages), space)


def stationary(lagrangian: Controlled, q0: Tensor, q1: Tensor, stages: int) -> Tensor:
    """Inner coefficients of a motion without controls, by Newton's method."""
    integrator = Geodesic(lagrangian.lagrangian.space, legendre(stages))
    x = integrator.unknowns(q0, q1)
    n = x.shape[1] // stages
    for _ in range(4 if stages > 1 else 0):
        at = integrator.expand_at(lagrangian, q0, x, H)
        error = at.mismatch(torch.zeros_like(x[:, :n]))[:, n:]
        x[:, n:] -= torch.linalg.solve(at.mismatch_jacobian()[:, n:, n:], error)
    return x[:, n:].unflatten(1, (-1, n)).transpose(0, 1)


@pytest.mark.parametrize("stages", STAGES)
@pytest.mark.parametrize("name", ["pivot", "free", "wheels"])
def test_slots_are_the_derivatives_of_the_discrete_action(name: str, stages: int) -> None:
    controlled, q0, v, _ = state(name, rows=1)
    lagrangian, space = controlled.lagrangian, CASES[name][0].space
    integrator = geodesic(space, stages)
    q1 = space.retract(q0, H * v)
    slots = integrator.slots(controlled, q0, q1, H)

    def action(a: Tensor, b: Tensor) -> Tensor:
        basis, inner = legendre(stages), stationary(controlled, a, b, stages)
        phi, rate = basis.path(space.origin(a), space.chart(a, b), inner, H)
        place = space.point(a.repeat(stages, 1), phi)
        moved = torch.func.jvp(lambda x: space.point(a.repeat(stages, 1), x), (phi,), (rate,))[1]
        v = space.velocity(place, moved)
        value = lagrangian.kinetic(place, v) - lagrangian.potential(place)
        return basis.total(value.unsqueeze(1), H)[:, 0]

    def moved(steps: Tensor) -> tuple[Tensor, Tensor]:
        a, b = q0.expand(len(steps), -1), q1.expand(len(steps), -1)
        return action(space.retract(a, steps), b), action(a, space.retract(b, steps))

    for which, found in enumerate(slots):
        expected = slopes_by_rows(lambda steps, i=which: moved(steps)[i], torch.zeros_like(v[0]))
        torch.testing.assert_close(found[0], expected, rtol=1e-8, atol=1e-8)


@every_case
@pytest.mark.parametrize("stages", STAGES)
def test_jacobians_of_a_step(stages: int, name: str) -> None:
    controlled, q0, v, controls = state(name, rows=2)
    integrator = geodesic(CASES[name][0].space, stages)
    q1 = integrator.space.retract(q0, H * v)
    x = integrator.unknowns(q0, q1) + drawn(v.shape[1] * stages, rows=2, scale=1e-2)
    whole = integrator.expand(controlled, q0, q1, H, controls).d2d1()
    found = integrator.expand_at(controlled, q0, x, H, controls).mismatch_jacobian()
    for row in range(2):

        def repeated(like: Tensor, row: int = row) -> tuple[Tensor, Forces]:
            ends = [u[row].expand(len(like), -1) for u in controls]
            return q0[row].expand(len(like), -1), Forces(*ends)

        def residual(x: Tensor, repeated: Callable = repeated) -> Tensor:
            start, forces = repeated(x)
            there = integrator.expand_at(controlled, start, x, H, forces)
            return there.mismatch(x.new_zeros(len(x), v.shape[1]))

        def d1(x: Tensor, repeated: Callable = repeated) -> Tensor:
            start, forces = repeated(x)
            end = integrator.space.point(start, x)
            return integrator.slots(controlled, start, end, H, forces).d1

        for mine, function, place in (
            (found[row], residual, x[row]),
            (whole[row], d1, integrator.space.chart(q0, q1)[row]),
        ):
            torch.testing.assert_close(
                mine,
                slopes_by_rows(function, place),
                rtol=1e-6,
                atol=1e-7 * float(mine.abs().max()),
            )


@pytest.mark.parametrize(("stages", "name"), [(1, "free"), (2, "damped pivot"), (3, "wheels")])
def test_derivatives_of_residual_root_and_momentum(stages: int, name: str) -> None:
    """In configurations and controls."""
    controlled, q, v, controls = state(name)
    space = CASES[name][0].space
    nodes = [q, space.retract(q, H * v), space.retract(q, 2.1 * H * v)]
    weight = drawn(3 * v.shape[1] * len(q), rows=1, seed=9).view(3, *v.shape)
    discrete = DiscreteLagrangian(geodesic(space, stages), controlled, H)

    inputs = [x.clone().requires_grad_() for x in (torch.zeros(3, *v.shape).double(), *controls)]

    def value() -> Tensor:
        steps, first, second = inputs
        a, b, c = (space.retract(node, step) for node, step in zip(nodes, steps, strict=True))
        before, after = Forces(first, second), Forces(second, first)
        residual = discrete.residual(a, b, c, before, after)
        p = discrete.momentum(a, b, before)
        impulse = p + discrete.impulses(after)[0]
        root, _ = discrete.next_configuration(ROOT, b, impulse, space.extrapolated(a, b), after)
        moved = space.difference(nodes[2], root)
        return (weight * torch.stack((residual, p, moved))).sum()

    assert_gradients(value, inputs, eps=1e-5, atol=1e-7, rtol=2e-6)


@pytest.mark.parametrize("stages", STAGES)
def test_slots_without_a_graph_in_configurations_are_the_same(stages: int) -> None:
    """They take the chart from the expansion, with the same values and slopes in the controls."""
    controlled, q0, v, controls = state("free")
    integrator = geodesic(Space(1), stages)
    q1 = integrator.space.retract(q0, H * v)
    expansion = integrator.expand(controlled, q0, q1, H, controls)
    found = []
    for graph in (False, True):
        at = q0.clone().requires_grad_(graph), q1.clone().requires_grad_(graph)
        forces = Forces(*(u.clone().requires_grad_() for u in controls))
        slots = expansion.slots(*at, forces)
        by_force = torch.autograd.grad((slots.d1 + slots.d2.square()).sum(), tuple(forces))
        found.append((*slots, *by_force))
    torch.testing.assert_close(*found, rtol=1e-12, atol=1e-12)
    with torch.enable_grad():
        x = integrator.space.chart(q0, q1)
        torch.testing.assert_close(expansion.slots_at(q0, x, controls), expansion.values)


def test_rows_and_replace_keep_the_start_of_their_interval() -> None:
    controlled, q0, v, controls = state("free", rows=5)
    integrator, index = geodesic(Space(1), 3), torch.tensor([3, 1])
    q1 = integrator.space.retract(q0, H * v)
    whole = integrator.expand(controlled, q0, q1, H, controls)
    part = whole.rows(index)
    for mine, theirs in zip(part.values, whole.values, strict=True):
        torch.testing.assert_close(mine, theirs[index])
    torch.testing.assert_close(part.d2d1(), whole.d2d1()[index])
    few = Forces(*(u[index] for u in controls))
    other = integrator.expand(controlled, q1[index], q0[index], H, few)
    mixed = whole.replace(index, other)
    torch.testing.assert_close(mixed.d2d1()[index], other.d2d1())
    torch.testing.assert_close(mixed.d2d1()[[0, 2, 4]], whole.d2d1()[[0, 2, 4]])
    repeated = [x.repeat(3, 1) for x in (q0, q1, *controls)]  # intervals that occur twice
    slots = integrator.slots(controlled, *repeated[:2], H, Forces(*repeated[2:]))
    torch.testing.assert_close(slots.d1, whole.values.d1.repeat(3, 1))


# Motions


def between(controls: Forces, *shares: float) -> list[Tensor]:
    """Controls linear in time after these shares of a motion."""
    return [controls.start + share * (controls.end - controls.start) for share in shares]


def path(
    integrator: VariationalIntegrator, name: str, steps: int, duration: float = 0.4
) -> tuple[Tensor, Tensor]:
    """The configuration and the velocity after a motion under controls linear in time."""
    controlled, q, v, controls = state(name, rows=2)
    lagrangian, h = controlled.lagrangian, duration / steps
    discrete = DiscreteLagrangian(integrator, controlled, h)
    p = lagrangian.momentum(q, v)
    with torch.no_grad():
        for k in range(steps):
            ends = between(controls, k / steps, (k + 1) / steps)
            guess = lagrangian.space.retract(q, h * lagrangian.velocity(q, p))
            step = discrete.step(ROOT, q, p, Forces(*ends), guess)
            assert step.root.converged.all()
            q, p = step.q, step.p
    return q, lagrangian.velocity(q, p)


def explicit(method: object, name: str, steps: int, duration: float = 0.4) -> tuple[Tensor, Tensor]:
    """The same by Munthe-Kaas steps."""
    controlled, q, v, controls = state(name, rows=2)
    lagrangian, h = controlled.lagrangian, duration / steps

    def field(q: Tensor, v: Tensor, u: Tensor) -> Tensor:
        return acceleration(lagrangian, q, v, controlled.force(q, u))

    with torch.no_grad():
        for k in range(steps):
            ends = between(controls, k / steps, (k + 1) / steps)
            q, v = method.step(field, q, v, *ends, h, lagrangian.space)  # type: ignore[attr-defined]
    return q, v


@functools.cache
def reference(name: str, order: int) -> tuple[Tensor, Tensor]:
    """The motion to 1e-13, or to 1e-11 for what errs more by far."""
    return explicit(DormandPrince5(), name, 160 if order > 4 else 60)


ORDERS = {
    **{stages: (geodesic(Space(1), stages), 2 * stages) for stages in STAGES},
    **{type(method).__name__: (method, method.order) for method in (Midpoint(), RK4())},
}
PAIRS = [(name, method) for name in ("damped pivot", "free") for method in ORDERS]
PAIRS += [("wheels", "RK4"), pytest.param("wheels", 2, marks=pytest.mark.slow)]


@pytest.mark.parametrize(("name", "method"), PAIRS)
def test_orders_with_controls_and_friction(name: str, method: object) -> None:
    integrator, order = ORDERS[method]
    steps = (5, 7) if order > 4 else (12, 20)
    runs = explicit if not isinstance(integrator, VariationalIntegrator) else path
    if runs is path:
        integrator = geodesic(CASES[name][0].space, method)
    exact = torch.cat(reference(name, order), dim=1)
    errors = [float((torch.cat(runs(integrator, name, k), 1) - exact).abs().max()) for k in steps]
    found = math.log(errors[0] / errors[1]) / math.log(steps[1] / steps[0])
    assert errors[1] > ROUNDING
    assert found == pytest.approx(order, abs=0.25)


class Rod(Body):
    """A thin rod that hangs from one end: its inertia about its axis is a 300th of the others."""

    def __init__(self) -> None:
        super().__init__()
        half = torch.tensor([0.0, 0.0, -0.5, 1.0], dtype=torch.float64)
        self.pseudo = torch.outer(half, half) + torch.diag(
            torch.tensor([6e-4, 6e-4, 1 / 12, 0.0], dtype=torch.float64)
        )


@pytest.mark.parametrize("friction", [False, True])
@pytest.mark.parametrize("stages", [2, 3, 5])
def test_the_motion_of_a_rod_between_two_configurations_is_found(
    stages: int, friction: bool
) -> None:
    """Gyroscopic terms about the thin axis are larger than its inertia."""
    rod = damped(Rod(), 3) if friction else Rod()
    space, rate = rod.space, drawn(3, rows=40, seed=1, scale=2.0)
    q = space.of_vector(drawn(3, rows=40))
    controls = Forces(*(drawn(3, rows=40, seed=k, scale=0.5) for k in (2, 3)))
    controlled = Controlled(rod, torch.eye(3).double())
    at = Geodesic(space, legendre(stages)).expand(
        controlled, q, space.retract(q, 0.05 * rate), 0.05, controls
    )
    assert at.stationarity.abs().max() < 1e-12


@pytest.mark.parametrize("stages", STAGES)
def test_a_motion_has_no_residual_and_the_world_may_be_turned(stages: int) -> None:
    """Along its own trajectory, and about gravity, with the same momenta in body axes."""
    body = Body()
    space, integrator = body.space, geodesic(body.space, stages)
    discrete = DiscreteLagrangian(integrator, Controlled(body, torch.eye(6).double()), H)
    q, v = space.of_vector(drawn(6, rows=1)), drawn(6, rows=1, seed=1)
    about = body.gravity / body.gravity.norm()
    world = exponential(0.7 * about)

    def turned(q: Tensor) -> Tensor:
        flat, turn = q[:, :3], q[:, 3:].view(-1, 3, 3)
        return torch.cat((flat @ world.T, (world @ turn).flatten(1)), dim=1)

    nodes, p = [q], body.momentum(q, v)
    none = Forces(torch.zeros_like(v), torch.zeros_like(v))
    with torch.no_grad():
        for _ in range(20):
            step = discrete.step(ROOT, nodes[-1], p, none, nodes[-1])
            nodes.append(step.q)
            p = step.p
        q = torch.cat(nodes)
        for path in (q, turned(q)):
            still = Forces(*(x.expand(19, -1) for x in none))
            residual = discrete.residual(path[:-2], path[1:-1], path[2:], still, still)
            assert residual.abs().max() < 1e-12


@pytest.mark.parametrize("stages", STAGES)
@pytest.mark.parametrize(
    ("steps", "bound"), [(80, 1e-12), pytest.param(100_000, 1e-11, marks=pytest.mark.slow)]
)
def test_a_free_body_keeps_momentum_and_its_energy_does_not_drift(
    stages: int, steps: int, bound: float
) -> None:
    momentum, energy = drifts(stages, steps)
    assert momentum < bound
    assert energy[1] < 2.0 * energy[0] + bound


def drifts(stages: int, steps: int) -> tuple[float, tuple[float, float]]:
    """Relative change of the angular momentum, and ranges of the energy in both halves."""
    body = Body()
    body.gravity = torch.zeros(3).double()
    space, integrator = body.space, geodesic(body.space, stages)
    discrete = DiscreteLagrangian(integrator, Controlled(body, torch.eye(3).double()), 0.05)
    q, v = space.of_vector(drawn(3, rows=1)), drawn(3, rows=1, seed=1)
    p, states = body.momentum(q, v), []
    none = Forces(torch.zeros(1, 3).double(), torch.zeros(1, 3).double())
    with torch.no_grad():
        for _ in range(steps):
            guess = space.retract(q, 0.05 * body.velocity(q, p))
            step = discrete.step(ROOT, q, p, none, guess)
            q, p = step.q, step.p
            states.append((q, p))
    q, p = (torch.cat(x) for x in zip(*states, strict=True))
    spin = (q.view(-1, 3, 3) @ p.unsqueeze(-1)).squeeze(-1)
    energy = body.energy(q, body.velocity(q, p))
    relative = float((spin - spin[0]).norm(dim=1).max() / spin[0].norm())
    halves = [float((x.max() - x.min()) / energy[0].abs()) for x in energy.chunk(2)]
    return relative, (halves[0], halves[1])


# Against the trace form


def both_forms(h: float) -> list[tuple[Tensor, Tensor]]:
    """Momenta, residuals over ``h`` and configurations after 0.1 s, geodesic and trace form."""
    body, space = Body(), Space(1)
    discrete = DiscreteLagrangian(geodesic(space, 1), Controlled(body, torch.eye(3).double()), h)
    q, v, bend = space.of_vector(drawn(3)), drawn(3, seed=1), drawn(3, seed=2)
    nodes = [space.retract(q, t * v + t * t * bend) for t in (0.0, h, 2.0 * h)]
    none = Forces(torch.zeros(4, 3).double(), torch.zeros(4, 3).double())
    _, after = trace_form.momenta(body, *nodes[:2], h)
    before, _ = trace_form.momenta(body, *nodes[1:], h)
    there = [(q, body.momentum(q, v)), (q, body.momentum(q, v))]
    with torch.no_grad():
        momentum = discrete.momentum(*nodes[:2], none)
        residual = discrete.residual(*nodes, none, none) / h
        for _ in range(round(0.1 / h)):
            found = discrete.step(ROOT, *there[0], none, there[0][0])
            there = [(found.q, found.p), trace_form.step(body, *there[1], h)]
    return [(momentum, after), (residual, (after - before) / h), (there[0][0], there[1][0])]


def test_order_two_is_that_of_the_trace_form() -> None:
    """Momenta, residuals and motions of a heavy body differ at second order."""
    steps = (0.005, 0.0025)
    each = zip(*(both_forms(h) for h in steps), strict=True)
    for pairs in each:
        apart = [float((mine - theirs).abs().max()) for mine, theirs in pairs]
        assert apart[1] > ROUNDING
        assert math.log2(apart[0] / apart[1]) == pytest.approx(2.0, abs=0.01)


# A flat space, and what has no extension


@pytest.mark.parametrize("integrator", [VariationalMidpoint(), Galerkin(stages=2)])
def test_a_flat_space_has_the_integrator_itself(integrator: VariationalIntegrator) -> None:
    assert on_space(integrator, FLAT) is integrator
    turned = on_space(integrator, Space(1))
    assert turned.order == integrator.order
    assert turned.space == Space(1)


def test_an_integrator_without_an_extension_is_refused() -> None:
    class Other(VariationalMidpoint):
        has_geodesic = False

    with pytest.raises(ConfigError, match=r"Other .*rotations; choose integrator=midpoint"):
        on_space(Other(), Space(1))


def test_roots_have_a_status_of_their_own() -> None:
    """One row asks for an impossible step; the others find theirs, by either root finder."""
    controlled, q, v, controls = state("pivot")
    p = controlled.lagrangian.momentum(q, v)
    p[1] *= 1e4
    discrete = DiscreteLagrangian(geodesic(Space(1), 2), controlled, H)
    for finder in (ROOT, Broyden(tolerance=1e-12, max_iterations=40)):
        with torch.no_grad():
            root = discrete.step(finder, q, p, controls, q).root
        assert root.converged.tolist() == [True, False, True, True]
