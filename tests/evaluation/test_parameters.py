"""The table of physical parameters: which ones, and which products, the data determine."""

import math
from dataclasses import replace
from functools import partial

import pytest
import torch

from symo_exp.evaluation.parameters import physical_parameters
from symo_exp.mechanics.dissipation import DissipativeLagrangian
from symo_exp.mechanics.galerkin import Galerkin
from symo_exp.mechanics.roots import Newton
from symo_exp.mechanics.types import Coordinates, Trajectory
from symo_exp.mechanics.units import Units, product
from symo_exp.models.learned import learned_lagrangian
from symo_exp.models.objectives import PreconditionedResidual
from symo_exp.models.true import TrueVariational
from symo_exp.nets.dissipation import LearnedDissipation, MachineFriction
from symo_exp.nets.drag import LearnedDrag
from symo_exp.nets.known import KnownFriction, KnownLagrangian
from symo_exp.nets.planar_links import PlanarLinks
from symo_exp.nets.readings import readings
from symo_exp.optim.posterior import Posterior, posterior
from symo_exp.systems.simulation import Solver, simulate
from tests.learned import double_precision
from tests.systems.every import SYSTEMS
from tests.tables import arguments_of

SIGMA = 1e-3


def vanished_friction(*, known=True):
    """The table of friction whose dry part vanished in the second coordinate."""
    system = SYSTEMS["acrobot"]
    found = LearnedDissipation(coordinates=system.coordinates, coulomb=True)
    parameters = list(found.parameters())
    with torch.no_grad():
        found.coulomb_root[1] = 1e-48
    mean = torch.cat([p.detach().flatten() for p in parameters])
    dry = [p is found.coulomb_root for p in parameters for _ in p.flatten()].index(True)
    everything = torch.eye(len(mean), dtype=torch.float64)
    free = everything[:, dry + 1 : dry + 2]
    posterior = Posterior(mean, 1e-3 * everything, free, SIGMA, SIGMA, 100)
    return physical_parameters(found, system.coordinates, parameters, posterior if known else None)


@pytest.mark.parametrize("known", [True, False])
def test_friction_that_vanished_is_reported_as_none(known):
    """A square root that goes to zero leaves the residuals alone, like a direction that is free."""
    rows = vanished_friction(known=known)
    none = [row for row in rows if row.note == "none was found"]
    assert [(row.value, row.determined) for row in none] == [(0.0, "no")]
    assert "no" not in {row.determined for row in rows if row not in none}


def test_a_number_without_effect_is_one_that_data_do_not_show():
    """A free direction that no other number changes along, as the rest velocity's."""
    system = SYSTEMS["pendulum"]
    found = LearnedDissipation(coordinates=system.coordinates, coulomb=True)
    parameters = list(found.parameters())
    mean = torch.cat([p.detach().flatten() for p in parameters])
    everything = torch.eye(len(mean), dtype=torch.float64)
    for k in range(len(mean)):
        posterior = Posterior(mean, everything, everything[:, k : k + 1], SIGMA, SIGMA, 100)
        rows = physical_parameters(found, system.coordinates, parameters, posterior)
        (note,) = {row.note for row in rows if row.determined == "no"}
        assert note == "data do not show it"


def table(system, *, forced, fixed=()):
    """The table of a system at its true values, from noisy motions of itself."""
    system = replace(system, viscous=(0.1,) * system.coordinates.n, time_step=0.05)
    q, v, u = system.box.points(3, 1)
    path = simulate(system, q, v, u if forced else 0.0 * u, 60, Solver())
    noise = SIGMA * torch.randn(path.q.shape, generator=torch.Generator().manual_seed(2)).double()
    motions = [Trajectory(*x) for x in zip(path.q + noise, path.v, path.u, strict=True)]
    lagrangian = DissipativeLagrangian(
        KnownLagrangian(system=system, fixed=fixed), KnownFriction(system=system)
    ).double()
    model = TrueVariational(
        lagrangian=lagrangian,
        **arguments_of(system),
        integrator=Galerkin(stages=2),
        root=Newton(),
    ).double()
    parameters = list(lagrangian.parameters())

    def residuals(windows):
        return PreconditionedResidual()(model.flow, windows).values

    found = posterior(residuals, parameters, motions, epsilon=0.03)
    assert 0.8 * SIGMA < found.noise < 1.2 * SIGMA
    rows = physical_parameters(lagrangian, system.coordinates, parameters, found)
    return {row.name: row for row in rows}


@pytest.fixture(autouse=True)
def double():
    with double_precision():
        yield


def test_a_driven_pendulum_is_determined_up_to_one_scale():
    found = table(SYSTEMS["pendulum"], forced=True)
    assert {found[x].determined for x in ("gravity", "mass", "length")} == {"no"}
    assert "length" in found["gravity"].note
    assert math.isnan(found["mass"].standard_deviation)
    assert found["theta.viscous_friction"].determined == "yes"
    products = [row for row in found.values() if row.note == "product that is determined"]
    assert len(products) == 2
    g, m, length = (found[x].value for x in ("gravity", "mass", "length"))
    for row in products:  # of g/l and m l², in whatever powers
        assert 0.0 < row.standard_deviation < 0.1 * row.value
        powers = {
            part.partition("^")[0]: float(part.partition("^")[2] or 1) for part in row.name.split()
        }
        a, b, c = (powers.get(x, 0.0) for x in ("gravity", "mass", "length"))
        assert a + c == pytest.approx(2.0 * b)
        assert row.value == pytest.approx(g**a * m**b * length**c)


@pytest.mark.parametrize(
    ("powers", "unit"),
    [
        ([("m/s^2", -1.0), ("m/s^2", 1.0)], "1"),
        ([("m/s^2", 1.0), ("m", -1.0)], "1/s^2"),
        ([("kg", 1.0), ("m", 2.0)], "kg m^2"),
        ([("m/s^2", 0.5), ("m", -0.5), ("kg", 1.0)], "kg/s"),
        ([("m/s^2", 0.5), ("kg", 0.5)], "m^(1/2) kg^(1/2)/s"),
        ([("N m s/rad", 1.0), ("kg m^2", -1.0)], "N s/(m rad kg)"),
        ([("N m / (kg m^2)", 1.0), ("kg / (kg m^2)", -1.0)], "N m/kg"),
        ([("N^(1/3) m^(1/3)/s^(1/3)", 3.0), ("1", 2.0)], "N m/s"),
        ([("kg/(m s)", 1.0), ("kg/(m s)", 1.0)], "kg^2/(m^2 s^2)"),
        ([("N^(1/3) / (kg m^2)^(1/3)", 3.0)], "N/(kg m^2)"),
    ],
)
def test_units_of_products_have_no_unit_twice(powers, unit):
    assert product(powers) == unit


@pytest.mark.parametrize(
    ("unit", "powers"),
    [
        ("kg/(m s)", (-1, -1, 1)),
        ("N m / (kg m^2)", (0, -2, 0)),
        ("N s/(m rad kg)", (0, -1, 0)),
        ("N m s^2/rad^2", (2, 0, 1)),
        ("m^(1/2) kg^(1/2)/s", (0.5, -1, 0.5)),
        ("1/(kg^(1/3) m)^2", (-2, 0, -2 / 3)),
        ("V s/rad", (0, 1, 0)),
    ],
)
def test_the_size_of_a_unit_is_that_of_its_powers(unit, powers):
    length, time, mass = powers
    found = Units(1e-3, 0.1, 1e-6).size(unit)
    assert found == pytest.approx(1e-3**length * 0.1**time * 1e-6**mass)
    assert Units(1e-3, 0.1, 1e-6).size(product([(unit, 1.0)])) == pytest.approx(found)


def test_one_known_constant_determines_a_driven_pendulum():
    found = table(SYSTEMS["pendulum"], forced=True, fixed=("gravity",))
    assert {row.determined for row in found.values()} == {"yes"}
    assert set(found) == {"mass", "length", "theta.viscous_friction"}
    assert found["length"].unit == "m"


def test_an_unforced_pendulum_is_determined_up_to_its_mass_as_well():
    found = table(SYSTEMS["pendulum"], forced=False, fixed=("gravity",))
    assert found["length"].determined == "yes"
    assert found["mass"].determined == "no"
    assert "theta.viscous_friction" in found["mass"].note
    assert "mass^-1" in " ".join(found) or "viscous_friction^-1" in " ".join(found)


@pytest.mark.parametrize("mass_is_free", [True, False])
def test_moments_about_the_joint_are_rows_where_masses_are_not_determined(mass_is_free):
    """Motions about a fixed point are those of the moments, whatever the mass."""
    system = SYSTEMS["rigid_body"]
    lagrangian = KnownLagrangian(system=system)
    parameters = [lagrangian.logarithms, lagrangian.factors]
    (body,) = lagrangian.constants().values()
    entries = [body[i, j] for i in range(4) for j in range(i + 1) if i < 3 or j < 3]
    slopes = slopes_of(entries, parameters)
    everything = torch.eye(slopes.shape[1]).double()
    free = torch.linalg.svd(slopes.detach())[2][len(entries) :].T
    posterior = Posterior(
        0.0 * everything[0], 1e-3 * everything, free if mass_is_free else free[:, :0],
        SIGMA, SIGMA, 100,
    )  # fmt: skip
    rows = physical_parameters(lagrangian, system.coordinates, parameters, posterior)
    found = {row.name: row for row in rows}
    determined = {row.name for row in rows if row.determined != "no"}
    mass, (x, y, z) = system.mass, system.centre
    if not mass_is_free:
        assert determined == set(found)
        assert found["body.mass"].value == pytest.approx(mass)
        return
    assert determined == {
        *(f"body.mass_times_centre_{axis}" for axis in "xyz"),
        *(f"body.inertia_about_joint_{axes}" for axes in ("xx", "yy", "zz", "xy", "xz", "yz")),
    }
    assert found["body.mass_times_centre_z"].value == pytest.approx(mass * z)
    about = found["body.inertia_xx"].value + mass * (y * y + z * z)
    assert found["body.inertia_about_joint_xx"].value == pytest.approx(about)
    assert found["body.inertia_about_joint_xy"].value == pytest.approx(
        found["body.inertia_xy"].value - mass * x * y
    )


def slopes_of(values, parameters):
    """The derivatives of numbers in the parameters, a row each."""
    options = {"retain_graph": True, "materialize_grads": True}
    gradients = [torch.autograd.grad(value, parameters, **options) for value in values]
    return torch.stack([torch.cat([g.flatten() for g in of]) for of in gradients])


def two_forces(sign, spread=1e-3):
    """Two constant forces of which the sum or the difference is determined, and their table."""
    torch.manual_seed(0)
    coordinates = Coordinates(("x", "y"), (False, False))
    friction = partial(MachineFriction, constant=True)
    found = learned_lagrangian(coordinates, PlanarLinks, friction, None).double()
    parameters = list(found.parameters())
    values = {x.name: x.value for x in readings(found, coordinates)}
    force, gravity = values["y.constant_force"], values["y.gravity_force"]
    first, second = slopes_of((force, gravity), parameters)
    along = first / first.norm() ** 2 - sign * second / second.norm() ** 2
    mean = torch.cat([p.detach().flatten() for p in parameters])
    everything = spread * torch.eye(len(mean)).double()
    known = Posterior(mean, everything, (along / along.norm()).unsqueeze(1), SIGMA, SIGMA, 100)
    return force, gravity, physical_parameters(found, coordinates, parameters, known)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_of_two_forces_that_act_alike_the_sum_is_determined(sign):
    """Whatever their values: equal ones have a product that does not change to first order."""
    force, gravity, found = two_forces(sign)
    rows = {row.name: row for row in found}
    ((name, row),) = [x for x in rows.items() if x[1].note == "the combination that is determined"]
    assert set(name.split()) == {"y.gravity_force", "+" if sign > 0 else "-", "y.constant_force"}
    assert abs(row.value) == pytest.approx(abs((force + sign * gravity).item()))
    assert row.unit == "N"
    assert not [x for x in rows.values() if x.note == "product that is determined"]


def test_a_note_on_a_combination_tells_of_a_deviation_above_its_value():
    weak = [row for row in two_forces(1.0, spread=1e3)[2] if row.determined == "weakly"]
    assert any(row.note.startswith("the combination that is determined, but") for row in weak)
    assert all(row.note.endswith("the standard deviation exceeds the value") for row in weak)


@pytest.mark.parametrize("far", [0.0, 3.0, 40.0, 360.0])
def test_a_number_at_the_end_of_its_range_is_not_determined(far):
    """The width of dry friction, whose slope vanishes as it approaches the smallest one."""
    coordinates = Coordinates(("theta",), (True,))
    found = learned_lagrangian(coordinates, PlanarLinks, MachineFriction, None).double()
    parameters = list(found.parameters())
    with torch.no_grad():
        found.dissipation.rest.fill_(-far)
    mean = torch.cat([p.detach().flatten() for p in parameters])
    spread = 1e-2 * torch.eye(len(mean)).double()
    known = Posterior(mean, spread, mean.new_zeros(len(mean), 0), SIGMA, SIGMA, 100)
    rows = {x.name: x for x in physical_parameters(found, coordinates, parameters, known)}
    width = rows["theta.rest_velocity"]
    ended = far > 20.0
    assert width.determined == ("no" if ended else "yes")
    assert math.isnan(width.standard_deviation) == ended
    assert ("end of its range" in width.note) == ended


def test_without_a_posterior_determination_is_unknown():
    system = SYSTEMS["cartpole"]
    found = KnownLagrangian(system=system)
    rows = physical_parameters(found, system.coordinates, list(found.parameters()), None)
    assert {row.determined for row in rows} == {"unknown"}
    assert [row.name for row in rows] == ["gravity", "mass_cart", "mass_pole", "half_length"]


def links(mass=1.0, friction=LearnedDissipation):
    """Two links that no known force drives, in units with this mass."""
    torch.manual_seed(0)
    coordinates = Coordinates(("a", "b"), (True, True), units=Units(1.0, 1.0, mass))
    kind = partial(PlanarLinks, relative=False)
    return learned_lagrangian(coordinates, kind, friction, None).double(), coordinates


@pytest.mark.parametrize(("friction", "power"), [(LearnedDissipation, 1.0), (LearnedDrag, 1 / 3)])
def test_numbers_of_a_machine_without_known_forces_do_not_depend_on_the_unit_of_mass(
    friction, power
):
    tables = {}
    for mass in (1.0, 4.0, 1e-24):
        found, coordinates = links(mass, friction)
        for driven in (True, False):
            rows = physical_parameters(
                found, coordinates, list(found.parameters()), None, driven=driven
            )
            tables[mass, driven] = {row.name: row.value for row in rows}
    for mass in (4.0, 1e-24):
        driven = {
            x: mass ** (power if x.startswith("drag") else 1.0) * value
            for x, value in tables[1.0, True].items()
        }
        assert tables[mass, True] == pytest.approx(driven, abs=0.0)
        assert tables[mass, False] == pytest.approx(tables[1.0, False])


@pytest.mark.parametrize("mass", [1.0, 1e-9])
def test_without_information_no_number_is_determined_whatever_its_size(mass):
    found, coordinates = links(mass)
    parameters = list(found.parameters())
    everything = torch.eye(sum(p.numel() for p in parameters)).double()
    nothing = Posterior(0.0 * everything[0], 1e-3 * everything, everything, SIGMA, SIGMA, 100)
    rows = physical_parameters(found, coordinates, parameters, nothing)
    assert {row.determined for row in rows} == {"no"}


def scaled_links(*, driven):
    """Two links that the data determine up to one factor: their numbers, and the table."""
    found, coordinates = links()
    parameters = list(found.parameters())
    read = readings(found, coordinates)
    values = torch.stack([x.value for x in read])
    scaling = torch.linalg.pinv(slopes_of(values, parameters)) @ values.detach()
    mean = torch.cat([p.detach().flatten() for p in parameters])
    free = (scaling / scaling.norm()).unsqueeze(1)
    known = Posterior(mean, 1e-6 * torch.eye(len(mean)).double(), free, SIGMA, SIGMA, 100)
    return read, physical_parameters(found, coordinates, parameters, known, driven=driven)


def test_all_numbers_relative_to_one_are_determined_up_to_a_common_factor():
    (read, absolute), (_, relative) = (scaled_links(driven=driven) for driven in (True, False))
    names = {x.name for x in read}
    assert {row.determined for row in absolute if row.value and row.name in names} == {"no"}
    relative = [row for row in relative if row.name in names]
    (one,) = [row for row in relative if row.determined == "no"]
    assert (one.value, one.unit) == (1.0, "kg m^2")
    gravity = next(row for row in relative if row.name == "a.gravity_moment")
    assert gravity.unit == "N m / (kg m^2)"


@pytest.mark.parametrize("driven", [True, False])
def test_learned_friction_has_a_unit_where_known_forces_act(driven):
    system = SYSTEMS["pendulum"]
    found = LearnedDissipation(coordinates=system.coordinates, coulomb=True)
    rows = physical_parameters(
        found, system.coordinates, list(found.parameters()), None, driven=driven
    )
    units = {row.name: row.unit for row in rows}
    assert units["theta.viscous_friction"] == ("N m s/rad" if driven else "up to a factor")
    assert units["theta.dry_friction"] == ("N m" if driven else "up to a factor")
    assert units["theta.rest_velocity"] == "rad/s"


TABLES = {
    "driven": lambda: table(SYSTEMS["pendulum"], forced=True).values(),
    "free": lambda: table(SYSTEMS["pendulum"], forced=False, fixed=("gravity",)).values(),
    "friction": vanished_friction,
    "forces": lambda: two_forces(1.0)[-1],
    "up to a factor": lambda: scaled_links(driven=True)[-1],
    "relative": lambda: scaled_links(driven=False)[-1],
}


@pytest.mark.parametrize("name", TABLES)
def test_rows_that_the_data_determine_precede_those_they_do_not(name):
    undetermined = [row.determined == "no" for row in TABLES[name]()]
    assert {True, False} == set(undetermined)
    assert undetermined == sorted(undetermined)


def test_each_part_of_a_table_keeps_the_order_of_the_numbers():
    read, rows = scaled_links(driven=False)
    order = [x.name for x in read]
    for determined in (True, False):
        places = [order.index(x.name) for x in rows if (x.determined != "no") == determined]
        assert places == sorted(places)
