"""Physical parameters of a learned Lagrangian or dissipation."""

from __future__ import annotations

from collections.abc import Sequence
from functools import singledispatch
from typing import Any, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from symo_exp.mechanics.bodies import of_pseudo_inertia
from symo_exp.mechanics.dissipation import DissipativeLagrangian
from symo_exp.mechanics.scaled import ScaledDissipation, ScaledLagrangian
from symo_exp.mechanics.types import Coordinates
from symo_exp.nets.dissipation import LearnedDissipation, MachineFriction
from symo_exp.nets.drag import LearnedBodyDrag, LearnedDrag
from symo_exp.nets.inputs import LearnedInputs
from symo_exp.nets.known import KnownFriction, KnownLagrangian
from symo_exp.nets.planar_links import PlanarLinks
from symo_exp.nets.rigid_body import LearnedRigidBody
from symo_exp.nets.rigid_chain import RigidChain
from symo_exp.nets.springs import SprungLagrangian
from symo_exp.nets.structured_lagrangian import StructuredLagrangian

POINTS, MOST_LINKS = 5, 6
"""Grid of directions, of which inertias of links in a plane have harmonics up to 2."""
ENTRIES = ("xx", "yy", "zz", "xy", "xz", "yz")


class Reading(NamedTuple):
    """A physical number, differentiable in the parameters behind it."""

    name: str
    unit: str
    value: Float[Tensor, ""]
    of: tuple[str, ...] = ()
    """Names of the numbers that it combines; it counts where data do not determine these."""


@singledispatch
def readings(module: Any, coordinates: Coordinates) -> list[Reading]:
    """Return the physical numbers of a module; none where it is a network."""
    return []


@readings.register
def _(module: DissipativeLagrangian, coordinates: Coordinates) -> list[Reading]:
    parts = module.conservative, module.dissipation
    return [reading for part in parts for reading in readings(part, coordinates)]


@readings.register(ScaledLagrangian)
@readings.register(ScaledDissipation)
def _(module: ScaledLagrangian | ScaledDissipation, coordinates: Coordinates) -> list[Reading]:
    size, found = coordinates.units.size, readings(module.inner, coordinates)
    return [x._replace(value=size(x.unit) * x.value) for x in found]


@readings.register
def _(module: SprungLagrangian, coordinates: Coordinates) -> list[Reading]:
    found, stiffness = readings(module.conservative, coordinates), module.springs.matrix
    turns = coordinates.turning
    for i, name in enumerate(coordinates.names[: len(stiffness)]):
        for j in range(i + 1):
            label = f"{name}.stiffness" + (f".{coordinates.names[j]}" if j < i else "")
            unit = ("N/m", "N", "N m/rad")[turns[i] + turns[j]]
            found.append(Reading(label, unit, stiffness[i, j]))
    return found


@readings.register
def _(module: LearnedInputs, coordinates: Coordinates) -> list[Reading]:
    """Force on each coordinate by a unit of each input."""
    return [
        Reading(f"{name}.input.{j}", "N m" if turns else "N", entry)
        for name, turns, row in zip(
            coordinates.names, coordinates.turning, module.matrix, strict=True
        )
        for j, entry in enumerate(row)
    ]


@readings.register
def _(module: KnownLagrangian, coordinates: Coordinates) -> list[Reading]:
    found: list[Reading] = []
    for name, value in module.constants().items():
        given = module.given[name]
        if value.ndim == 0:
            found.append(Reading(name, given.unit, value))
        else:
            shift = torch.eye(4).to(value)
            shift[:3, 3] = -torch.tensor(given.origin).to(value)  # to the joint
            body, label = shift @ value @ shift.mT, name.removesuffix(".body")
            found += _body(label, body) + _moments(label, body)
    return found


@readings.register
def _(module: RigidChain, coordinates: Coordinates) -> list[Reading]:
    n = coordinates.n
    axes, places = module.axes.view(n, 3), module.places.view(n, 3)
    factors = module.factors()
    found: list[Reading] = []
    for i, name in enumerate(coordinates.names):
        found += _body(name, factors[i] @ factors[i].mT)
        found += _vector(f"{name}.axis", "1", axes[i] / axes[i].norm())
        found += _vector(f"{name}.place", "m", places[i])
        unit = "kg m^2" if coordinates.turning[i] else "kg"
        found.append(Reading(f"{name}.armature", unit, module.rotors[i].square()))
    return found + _vector("gravity", "m/s^2", module.gravity)


@readings.register
def _(module: LearnedRigidBody, coordinates: Coordinates) -> list[Reading]:
    factor = module.factor(module.moments)
    found = _body("body", factor @ factor.mT)
    return found + ([] if module.gravity is None else _vector("gravity", "m/s^2", module.gravity))


@readings.register
def _(module: PlanarLinks, coordinates: Coordinates) -> list[Reading]:
    """Coefficients in the directions of the links, as below, and the inertias of rotors."""
    names, angular, n = coordinates.names, coordinates.angular, coordinates.n
    products = module.products()
    weights = module.weights.view(2, n)
    found = []
    for i, name in enumerate(names):
        own = products[i, i] + module.inertias[i].square()
        found.append(Reading(f"{name}.inertia", _inertia(angular[i], angular[i]), own))
        for j in range(i):
            unit = _inertia(angular[i], angular[j])
            found.append(Reading(f"{name}.inertia.{names[j]}", unit, products[i, j]))
        if angular[i]:
            size = weights[:, i].square().sum().clamp_min(1e-300).sqrt()
            found.append(Reading(f"{name}.gravity_moment", "N m", size))
        else:
            found.append(Reading(f"{name}.gravity_force", "N", -weights[0, i]))
    for name, rotor in zip(
        [name for name, angle in zip(names, angular, strict=True) if angle][1:],
        () if module.rotors is None else module.rotors,
        strict=True,
    ):
        found.append(Reading(f"{name}.armature", "kg m^2", rotor.square()))
    return found


@readings.register
def _(module: StructuredLagrangian, coordinates: Coordinates) -> list[Reading]:
    """Coefficients of links in a plane, in the directions ``φ`` of the links; none of a network.

    ``H_ij = c_ij cos(φ_i − φ_j)`` and ``V = −Σ g_i cos(φ_i − φ_i⁰)`` for rigid links, and
    ``H_xi = c cos(φ_i − φ_xi)`` for slides ``x``, which are at zero.
    """
    if module.head.soft or coordinates.n > MOST_LINKS:
        return []
    angular = torch.tensor(coordinates.angular)
    count, names = int(angular.sum()), coordinates.names
    grid = torch.linspace(0.0, 2.0 * torch.pi, POINTS + 1, dtype=torch.float64)[:-1]
    directions = torch.zeros(POINTS**count, coordinates.n, dtype=torch.float64)
    if count:
        directions[:, angular] = torch.cartesian_prod(*[grid] * count).view(-1, count)
    turn = module.embedding.turn
    place = module.net.biases[-1]
    inverse = torch.linalg.inv((torch.eye(coordinates.n) if turn is None else turn).double())
    q = (directions @ inverse.T).to(place)
    inverse = inverse.to(place)
    mass = inverse.T @ module.mass_matrix(q) @ inverse
    potential, directions = module.potential(q), directions.to(place)
    found = []
    for i, name in enumerate(names):
        found.append(
            Reading(f"{name}.inertia", _inertia(angular[i], angular[i]), mass[:, i, i].mean())
        )
        for j in range(i):
            unit = _inertia(angular[i], angular[j])
            wave = (directions[:, i] - directions[:, j]).cos()
            value = (mass[:, i, j] * wave).mean() * (2.0 if angular[i] or angular[j] else 1.0)
            found.append(Reading(f"{name}.inertia.{names[j]}", unit, value))
        if angular[i]:
            parts = [2.0 * (potential * f(directions[:, i])).mean() for f in (torch.cos, torch.sin)]
            size = torch.stack(parts).square().sum().clamp_min(1e-300).sqrt()
            found.append(Reading(f"{name}.gravity_moment", "N m", size))
    return found


@readings.register
def _(module: KnownFriction, coordinates: Coordinates) -> list[Reading]:
    viscous, coulomb = (x[0] for x in module.coefficients())
    n, found = coordinates.n, []
    for k in module.free:
        i, dry = k % n, k >= n
        unit = _friction_units(coordinates.turning[i])[dry]
        value = (coulomb if dry else viscous)[i]
        kind = "dry_friction" if dry else "viscous_friction"
        found.append(Reading(f"{coordinates.names[i]}.{kind}", unit, value))
    return found


@readings.register
def _of_coefficients(module: LearnedDissipation, coordinates: Coordinates) -> list[Reading]:
    matrix, dry = module.coefficients()
    names, found = coordinates.names, []
    for i, name in enumerate(names):
        unit, force, rate = _friction_units(coordinates.turning[i])
        if matrix is not None:
            found.append(Reading(f"{name}.viscous_friction", unit, matrix[i, i]))
            for j in range(i):
                mixed = unit if coordinates.turning[i] == coordinates.turning[j] else "N s"
                label = f"{name}.viscous_friction.{names[j]}"
                found.append(Reading(label, mixed, matrix[i, j]))
        if dry is not None:
            found.append(Reading(f"{name}.dry_friction", force, dry[0][i]))
            found.append(Reading(f"{name}.rest_velocity", rate, dry[1][i]))
    return found


@readings.register
def _(module: MachineFriction, coordinates: Coordinates) -> list[Reading]:
    found = _of_coefficients(module, coordinates)
    tilts, stribeck = module.asymmetry(), module.stribeck()
    for i, name in enumerate(coordinates.names):
        _, force, rate = _friction_units(coordinates.turning[i])
        if tilts is not None:
            for kind, tilt in zip(("viscous", "dry"), tilts, strict=True):
                found.append(Reading(f"{name}.{kind}_friction.asymmetry", "1", tilt[i]))
        if stribeck is not None:
            found.append(Reading(f"{name}.breakaway_friction", force, stribeck[0][i]))
            found.append(Reading(f"{name}.stribeck_velocity", rate, stribeck[1][i]))
        if module.constant is not None:
            found.append(Reading(f"{name}.constant_force", force, module.constant[i]))
    return found


@readings.register
def _(module: LearnedDrag, coordinates: Coordinates) -> list[Reading]:
    values = torch.nn.functional.softplus(module.viscous)
    unit = "N^(1/3) m^(1/3)/s^(1/3)"  # of a speed, which it is added to
    return [Reading(f"drag_{k + 1}.linear", unit, x) for k, x in enumerate(values)]


@readings.register
def _(module: LearnedBodyDrag, coordinates: Coordinates) -> list[Reading]:
    found = []
    for power, matrices in zip(("linear", "quadratic"), module.coefficients(), strict=True):
        for turning, matrix in zip((False, True)[-len(matrices) :], matrices, strict=True):
            name, unit = "torque" if turning else "force", _friction_units(turning)[0]
            unit = unit if power == "linear" else f"{unit.replace(' s', ' s^2')}^2"
            found += _symmetric(f"drag.{name}.{power}", unit, matrix)
    return found


def _body(name: str, body: Tensor) -> list[Reading]:
    """Mass, centre of mass from the joint, and inertia about the centre, of a pseudo-inertia."""
    mass, centre, inertia = of_pseudo_inertia(body)
    found = [Reading(f"{name}.mass", "kg", mass), *_vector(f"{name}.centre", "m", centre)]
    return found + _symmetric(f"{name}.inertia", "kg m^2", inertia)


def _moments(name: str, body: Tensor) -> list[Reading]:
    """Moments about the joint, on which motions about it depend, of a pseudo-inertia."""
    parts = tuple(reading.name for reading in _body(name, body))
    second = body[:3, :3].diagonal().sum() * torch.eye(3).to(body) - body[:3, :3]
    found = _vector(f"{name}.mass_times_centre", "kg m", body[3, :3])
    found += _symmetric(f"{name}.inertia_about_joint", "kg m^2", second)
    return [reading._replace(of=parts) for reading in found]


def _symmetric(name: str, unit: str, matrix: Tensor) -> list[Reading]:
    places = [tuple("xyz".index(axis) for axis in entry) for entry in ENTRIES]
    return [Reading(f"{name}_{x}", unit, matrix[at]) for x, at in zip(ENTRIES, places, strict=True)]


def _vector(name: str, unit: str, values: Sequence[Tensor] | Tensor) -> list[Reading]:
    return [Reading(f"{name}_{axis}", unit, x) for axis, x in zip("xyz", values, strict=True)]


def _inertia(a: Any, b: Any) -> str:
    return ("kg", "kg m", "kg m^2")[int(a) + int(b)]


def _friction_units(turning: bool) -> tuple[str, str, str]:
    """Return the units of viscous friction, of dry friction and of velocity."""
    return ("N m s/rad", "N m", "rad/s") if turning else ("N s/m", "N", "m/s")
