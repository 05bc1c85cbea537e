"""Systems against independent equations of motion and the laws of mechanics."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np
import pytest
import torch
from torch import Tensor

from symo_exp.errors import ConfigError
from symo_exp.evaluation.rollouts import along
from symo_exp.mechanics.euler_lagrange import acceleration
from symo_exp.mechanics.lagrangian import Lagrangian
from symo_exp.mechanics.types import Coordinates
from symo_exp.systems import complex_step
from symo_exp.systems.acrobot import Acrobot
from symo_exp.systems.base import LagrangianSystem, SamplingBox
from symo_exp.systems.cartpole import Cartpole
from symo_exp.systems.multibody import Multibody
from symo_exp.systems.pendulum import Pendulum
from symo_exp.systems.recorded import Recorded
from symo_exp.systems.simulation import Solver, simulate
from symo_exp.systems.table import system as stated
from symo_exp.systems.table import systems
from tests.systems.every import SYSTEMS, points
from tests.tables import systems as configured
from tests.unknown import Unknown

FRICTION = {"viscous": [0.1, 0.2], "coulomb": [0.0, 0.3]}
every_system = pytest.mark.parametrize("name", SYSTEMS)


def pendulum(s: Pendulum, q: Tensor, v: Tensor, u: Tensor) -> Tensor:
    """Gymnasium's Pendulum: θ̈ = 3g/(2l) sin θ + 3u/(m l²)."""
    return 3 * s.gravity / (2 * s.length) * q.sin() + 3 * u / (s.mass * s.length**2)


def acrobot(s: Acrobot, q: Tensor, v: Tensor, u: Tensor) -> Tensor:
    """Sutton and Barto, Reinforcement Learning, example 11.3 (Spong's equations)."""
    m1, m2, l1, c1, c2 = s.mass_1, s.mass_2, s.length_1, s.centre_1, s.centre_2
    i1, i2, g = s.inertia_1, s.inertia_2, s.gravity
    (a, b), (da, db) = q.T, v.T
    d1 = m1 * c1**2 + m2 * (l1**2 + c2**2 + 2 * l1 * c2 * b.cos()) + i1 + i2
    d2 = m2 * (c2**2 + l1 * c2 * b.cos()) + i2
    phi2 = m2 * c2 * g * (a + b - math.pi / 2).cos()
    phi1 = (
        -m2 * l1 * c2 * db**2 * b.sin()
        - 2 * m2 * l1 * c2 * db * da * b.sin()
        + (m1 * c1 + m2 * l1) * g * (a - math.pi / 2).cos()
        + phi2
    )
    ddb = (u[:, 0] + d2 / d1 * phi1 - m2 * l1 * c2 * da**2 * b.sin() - phi2) / (
        m2 * c2**2 + i2 - d2**2 / d1
    )
    dda = -(d2 * ddb + phi1) / d1
    return torch.stack([dda, ddb], -1)


def cartpole(s: Cartpole, q: Tensor, v: Tensor, u: Tensor) -> Tensor:
    """Florian, Correct equations for the dynamics of the cart-pole system, 2007; no friction."""
    mc, mp, half, g = s.mass_cart, s.mass_pole, s.half_length, s.gravity
    theta, rate, force = q[:, 1], v[:, 1], u[:, 0]
    inner = (-force - mp * half * rate**2 * theta.sin()) / (mc + mp)
    theta_dd = (g * theta.sin() + theta.cos() * inner) / (
        half * (4 / 3 - mp * theta.cos() ** 2 / (mc + mp))
    )
    x_dd = (force + mp * half * (rate**2 * theta.sin() - theta_dd * theta.cos())) / (mc + mp)
    return torch.stack([x_dd, theta_dd], -1)


ODD_PARAMETERS: list[tuple[LagrangianSystem, Callable[..., Tensor]]] = [
    (stated("pendulum"), pendulum),
    (stated("pendulum", gravity=3.7, mass=2.3, length=0.6), pendulum),
    (stated("acrobot"), acrobot),
    (
        stated(
            "acrobot",
            gravity=9.0,
            mass_1=1.2,
            mass_2=0.7,
            length_1=0.9,
            length_2=1.4,
            centre_1=0.4,
            centre_2=0.8,
            inertia_1=0.3,
            inertia_2=0.2,
        ),
        acrobot,
    ),
    (stated("cartpole"), cartpole),
    (stated("cartpole", gravity=3.7, mass_cart=0.8, mass_pole=0.4, half_length=0.9), cartpole),
]


@pytest.mark.filterwarnings("error::UserWarning")
@pytest.mark.parametrize(("system", "equations"), ODD_PARAMETERS)
def test_acceleration_is_that_of_the_literature(
    system: LagrangianSystem, equations: Callable[..., Tensor]
) -> None:
    q, v, u = points(system)
    found = system.acceleration(q, v, u)
    assert found.dtype == torch.float64
    torch.testing.assert_close(found, equations(system, q, v, u), rtol=1e-10, atol=1e-10)


def test_double_pendulum_of_the_chain_is_that_of_the_literature() -> None:
    """Equal masses and rods, absolute angles (Goldstein, ch. 1)."""
    system = SYSTEMS["chain_2"]
    q, v, _ = points(system)
    (a, b), (da, db), g = q.T, v.T, 9.81
    d = a - b
    below = 3 - (2 * d).cos()
    dda = (
        -3 * g * a.sin() - g * (a - 2 * b).sin() - 2 * d.sin() * (db**2 + da**2 * d.cos())
    ) / below
    ddb = 2 * d.sin() * (2 * da**2 + 2 * g * a.cos() + db**2 * d.cos()) / below
    found = system.acceleration(q, v, torch.zeros_like(q))
    torch.testing.assert_close(found, torch.stack([dda, ddb], -1), rtol=1e-10, atol=1e-10)


def test_the_acrobot_with_point_masses_is_a_chain_of_two() -> None:
    """Relative to absolute angles: q = T θ, and B maps the elbow torque to both rods."""
    tiny = 1e-14
    acrobot = stated("acrobot", centre_1=1.0, centre_2=1.0, inertia_1=tiny, inertia_2=tiny)
    q, v, u = points(acrobot)
    to_absolute = torch.tensor([[1.0, 0.0], [1.0, 1.0]], dtype=torch.float64).T
    torques = torch.cat([torch.zeros_like(u), u], 1)
    chain = SYSTEMS["chain_2"].acceleration(q @ to_absolute, v @ to_absolute, torques)
    found = acrobot.acceleration(q, v, u) @ to_absolute
    torch.testing.assert_close(found, chain, rtol=1e-9, atol=1e-9)


@every_system
def test_dimensions_and_units_agree(name: str) -> None:
    system = SYSTEMS[name]
    n, m = system.input_matrix.shape
    assert system.input_matrix.dtype == torch.float64
    assert len(system.coordinates.names) == len(system.coordinates.angular) == n
    assert len(set(system.coordinates.names)) == n
    assert [len(ranges) for ranges in system.box] == [n, n, m]
    shared = {field.name for field in dataclasses.fields(LagrangianSystem)} | {"links"}
    shared |= {field.name for field in dataclasses.fields(Multibody)}
    own = {field.name for field in dataclasses.fields(system)} - shared
    assert set(system.units()) == own
    assert all(system.units().values())


@every_system
def test_inertia_is_symmetric_and_positive_definite(name: str) -> None:
    system = SYSTEMS[name]
    q, v, _ = points(system, 256)
    mass = system.mass_matrix(q)
    torch.testing.assert_close(mass, mass.mT, rtol=0, atol=0)
    assert torch.linalg.eigvalsh(mass).min() > 1e-6
    torch.testing.assert_close(system.momentum(q, v), torch.einsum("bij,bj->bi", mass, v))


@every_system
def test_the_rate_of_the_energy_is_the_power_of_the_inputs(name: str) -> None:
    """dE/dt = E_q q̇ + E_v v̇ = vᵀ F, F = B u."""
    system = SYSTEMS[name]
    q, v, u = points(system)
    a = system.acceleration(q, v, u)
    _, rate = torch.func.jvp(system.energy, (q, v), (system.space.push(q, v), a))
    power = (v * system.input_force(system.input_matrix, q, u)).sum(1)
    torch.testing.assert_close(rate, power, rtol=1e-10, atol=1e-9)
    assert power.abs().max() > 0.05


@every_system
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_the_complex_step_agrees_with_automatic_differentiation(
    name: str, dtype: torch.dtype
) -> None:
    system = SYSTEMS[name]
    assert complex_step.applies(system, *system.points(8, 0)[:2])
    q, v, _ = (x.to(dtype) for x in points(system))
    tolerance = 2e-4 if dtype == torch.float32 else 1e-11
    for found, expected in zip(system.rates(q, v), Lagrangian.rates(system, q, v), strict=True):
        assert found.dtype == dtype
        torch.testing.assert_close(found, expected, rtol=tolerance, atol=tolerance)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Spring(LagrangianSystem):
    """A spring whose potential is written with ``abs``: the complex step would lose its force."""

    mass: float = 1.0
    coordinates = Coordinates(("x",), (False,))
    input_matrix = torch.ones(1, 1, dtype=torch.float64)

    def mass_matrix(self, q: Tensor) -> Tensor:
        return self.mass * torch.ones_like(q).unsqueeze(-1)

    def potential(self, q: Tensor) -> Tensor:
        x = q[:, 0]
        return self.mass * (0.5 * x.abs() ** 2 + x)  # complex, without the first imaginary part


@pytest.mark.parametrize("mass", [1.0, 1e-12])
def test_a_system_that_is_not_analytic_is_differentiated_automatically(mass: float) -> None:
    side = ((-1.0, 1.0),)
    spring = Spring(time_step=0.1, box=SamplingBox(q=side, v=side, u=side), mass=mass)
    q, v, u = points(spring)
    torch.testing.assert_close(spring.acceleration(q, v, mass * u), u - q - 1.0)
    assert spring.skeleton(q[0]) is None


def test_acceleration_can_be_differentiated() -> None:
    system = SYSTEMS["chain_2"]
    q, v, u = (x[:3].requires_grad_() for x in points(system))
    assert torch.autograd.gradcheck(system.acceleration, (q, v, u))


@every_system
def test_the_skeleton_moves_with_the_joints(name: str) -> None:
    """Bars are rigid, the parameters give their length, and gravity pulls down on them."""
    system = SYSTEMS[name]
    q, _, _ = points(system, 2)
    one, two = system.skeleton(q[0]), system.skeleton(q[1])
    assert one.links == two.links
    assert one.points.shape == two.points.shape
    for start, end in one.links:
        lengths = [(s.points[end] - s.points[start]).norm() for s in (one, two)]
        if not system.space.rotations:  # whose bars are seen from one side
            torch.testing.assert_close(lengths[0], lengths[1])
    reaches = (one.points - one.points[0]).norm(dim=1)
    assert reaches.max() <= one.reach + 1e-12
    if system.space.rotations:
        return
    # The highest configuration of a grid has its last point highest above the first.
    grid = torch.cartesian_prod(*[torch.linspace(-math.pi, math.pi, 13)] * q.shape[1])
    grid = grid.double().reshape(-1, q.shape[1])
    heights = torch.stack([(p := system.skeleton(g).points)[-1, 1] - p[0, 1] for g in grid])
    potentials = system.potential(grid)
    highest = heights[potentials > potentials.max() - 1e-9]
    torch.testing.assert_close(highest, heights.max().expand_as(highest))


def test_the_table_of_systems_is_the_folder_of_the_configuration() -> None:
    assert set(systems()) == set(configured())
    for name, system in configured().items():
        assert stated(name) == system
        assert type(system) is systems()[name]


def test_the_identity_depends_on_every_setting() -> None:
    system = stated("cartpole", viscous=[0.1, 0.2], coulomb=[0.0, 0.3])
    assert system.identity() == stated("cartpole", **FRICTION).identity()
    for field in dataclasses.fields(system):
        value = getattr(system, field.name)
        if field.name == "box":
            other = value._replace(u=((-1.0, 1.0),))
        else:
            other = tuple(1.01 * x for x in value) if isinstance(value, tuple) else 1.01 * value
        assert stated("cartpole", **FRICTION | {field.name: other}).identity() != system.identity()


@every_system
def test_friction_joins_the_forces_and_takes_energy(name: str) -> None:
    system = SYSTEMS[name]
    n = system.coordinates.n
    d, c = [0.1 * (i + 1) for i in range(n)], [0.2] * n
    damped = dataclasses.replace(system, viscous=d, coulomb=c, rest_velocity=0.3)
    q, v, u = points(system)
    force = -torch.tensor(d, dtype=torch.float64) * v - 0.2 * torch.tanh(v / 0.3)
    expected = acceleration(system, q, v, system.input_force(system.input_matrix, q, u) + force)
    torch.testing.assert_close(damped.acceleration(q, v, u), expected)
    path = simulate(damped, q[:2], v[:2], torch.zeros_like(u[:2]), 8, Solver())
    energy = along(damped.energy, path.q, path.v)
    assert (energy.diff(dim=1) < 0).all()


@pytest.mark.parametrize("given", [[0.1], [0.1, -0.2], 0.1, [0.1, math.nan]])
def test_friction_coefficients_are_one_for_each_coordinate(given: object) -> None:
    with pytest.raises(ConfigError, match=r"system\.viscous=.*2 number"):
        stated("cartpole", viscous=given)


def test_unknown_properties_of_a_system_are_none() -> None:
    system = Unknown(time_step=1)
    assert system.box is system.lagrangian is system.skeleton(torch.zeros(2)) is None
    assert system.time_step == 1.0
    with pytest.raises(ConfigError, match=r"system\.time_step=0"):
        Unknown(time_step=0)


BOX = {"q": ((0, 1),), "v": ((0, 1),), "u": ((0, 1),)}


@pytest.mark.parametrize(
    ("name", "changes", "key"),
    [
        ("pendulum", {"length": -1.0}, "system.length=-1.0"),
        ("acrobot", {"inertia_1": math.nan}, "system.inertia_1=nan"),
        ("cartpole", {"mass_cart": "heavy"}, "system.mass_cart='heavy'"),
        ("pendulum", {"mass": [1.0, 2.0, 3.0]}, "system.mass=[1.0, 2.0, 3.0]"),
        ("pendulum", {"time_step": [1.0, 2.0, 3.0]}, "system.time_step=["),
        ("rigid_body", {"inertia": 1.0}, "system.inertia=1.0: expected three numbers"),
        ("quadrotor", {"inertia": "heavy"}, "system.inertia=heavy: expected three numbers"),
        ("pendulum", {"box": BOX | {"q": ((1.0, -1.0),)}}, "system.box.q"),
        ("pendulum", {"box": BOX | {"u": ()}}, "system.box.u"),
        ("pendulum", {"box": SamplingBox(**BOX | {"v": (3,)})}, "system.box.v"),
        ("pendulum", {"box": {"q": ((0, 1),)}}, "system.box={"),
    ],
)
def test_bad_parameters_are_refused_in_one_line(name: str, changes: dict, key: str) -> None:
    with pytest.raises(ConfigError) as error:
        stated(name, **changes)
    assert key in str(error.value)
    assert "expected" in str(error.value)


@pytest.mark.parametrize(
    ("name", "value", "told"),
    [
        ("mass_matrix", lambda self, q: torch.ones_like(q), r"shape \(17, 1\) .* \(17, 1, 1\)"),
        ("mass_matrix", lambda self, q: torch.ones(1, 1, dtype=q.dtype), r"shape \(1, 1\)"),
        ("mass_matrix", lambda self, q: np.eye(1), "returns ndarray: expected a tensor"),
        ("mass_matrix", lambda self, q: -torch.ones_like(q)[..., None], "not positive definite"),
        ("mass_matrix", lambda self, q: q.unsqueeze(-1), "not positive definite at q=.-"),
        ("potential", lambda self, q: q, r"expected \(17,\)"),
        ("potential", lambda self, q: q.sum(), r"shape \(\)"),
        ("potential", lambda self, q: q[:, 1], "fails: IndexError: index 1"),
        ("potential", lambda self, q: q[:, 0].float(), "has dtype torch.float32"),
        ("potential", lambda self, q: q[:, 0].log(), "is not finite at q=.-"),
        ("potential", lambda self, q: q.numpy()[:, 0], "fails: RuntimeError: Can't call numpy"),
        ("potential", lambda self, q: q.detach()[:, 0] ** 2, "other derivatives"),
        ("potential", lambda self, q: q[:, 0] * q.detach()[:, 0], "other derivatives"),
    ],
)
def test_equations_that_define_no_motion_are_refused(name: str, value: object, told: str) -> None:
    side = ((-1.0, 1.0),)
    wrong = type("Wrong", (Spring,), {name: value})
    system = wrong(time_step=0.05, box=SamplingBox(side, side, side))
    with pytest.raises(ConfigError, match=rf"Wrong\.{name}\(q\) .*{told}"):
        system.identity()


def test_an_inertia_that_is_not_symmetric_is_refused() -> None:
    skew = torch.tensor([[0.0, 0.1], [0.0, 0.0]], dtype=torch.float64)
    wrong = type(
        "Wrong", (Cartpole,), {"mass_matrix": lambda s, q: Cartpole.mass_matrix(s, q) + skew}
    )
    given = {f.name: getattr(stated("cartpole"), f.name) for f in dataclasses.fields(Cartpole)}
    with pytest.raises(ConfigError, match=r"Wrong\.mass_matrix\(q\) is not symmetric"):
        _ = wrong(**given).lagrangian


@pytest.mark.parametrize("size", [1e-6, 1.0, 1e6])
def test_equations_with_kinks_and_in_any_unit_are_accepted(size: float) -> None:
    """A stop from the middle of the range on, and dry weight."""
    side = ((-size, size),)

    def potential(self: Spring, q: Tensor) -> Tensor:
        x = q[:, 0] / size
        return size**2 * (torch.where(x > 0, 50 * x**2, x**2) + x.abs())

    system = type("Stop", (Spring,), {"potential": potential})(
        time_step=0.05, box=SamplingBox(side, side, side)
    )
    assert system.lagrangian is system


XYZ = ("x", "y", "z")


@pytest.mark.parametrize(
    ("name", "value", "told"),
    [
        ("coordinates", Coordinates(("x", "y"), (False,)), "names=.*angular=.*expected different"),
        ("coordinates", Coordinates(("x", "x"), (False, True)), "expected different names"),
        ("coordinates", ("x",), "expected Coordinates"),
        *(
            (
                "coordinates",
                Coordinates.of(XYZ, angular, ("R",), [free]),
                r"free=.* as \[\(0, 0\)\]",
            )
            for angular, free in [
                ((False,) * 3, (1, 0)),
                ((False,) * 3, (0, 1)),
                ((False,) * 3, (-1, 0)),
                ((False, False, True), (0, 0)),
            ]
        ),
        (
            "coordinates",
            Coordinates(XYZ, (False,) * 3, ("R",)),
            "names=.*rotations=.*Coordinates.of",
        ),
        ("input_matrix", torch.ones(1), r"is \(1,\): expected a tensor with a row for each"),
        ("input_matrix", torch.ones(2, 1), r"is \(2, 1\): expected .* 1 coordinate"),
        ("input_matrix", [[1.0]], "is list: expected a tensor"),
    ],
)
def test_coordinates_and_inputs_that_do_not_fit_are_refused(
    name: str, value: object, told: str
) -> None:
    side = ((-1.0, 1.0),)
    wrong = type("Wrong", (Spring,), {name: value})
    with pytest.raises(ConfigError, match=rf"Wrong\.{name}.*{told}"):
        wrong(time_step=0.05, box=SamplingBox(side, side, side))


@pytest.mark.parametrize(
    ("inputs", "matrix"),
    [
        (["upper", "lower"], [[1, 0], [0, 1]]),
        (["lower", "upper"], [[0, 1], [1, 0]]),
        (["lower [Nm]", "upper [Nm]"], [[0, 1], [1, 0]]),
        (["lower_Nm", "motor"], None),
        (["0", "1"], [[1, 0], [0, 1]]),
        (["lower", "motor"], None),
        (["motor", "upper"], None),
        (["upper", "motor"], [[1, 0], [0, 1]]),
        (["lower"], None),
        ([], [[], []]),
    ],
)
def test_inputs_of_recordings_act_by_their_names(
    inputs: list[str], matrix: list[list[float]] | None
) -> None:
    settings = {"names": ["upper", "lower"], "angular": "all", "time_step": 0.05, "inputs": inputs}
    if matrix is None:
        with pytest.raises(ConfigError, match=r"input_matrix=null: say how"):
            Recorded(**settings)
    else:
        assert Recorded(**settings).input_matrix.tolist() == matrix
