"""Rigid bodies of a learned Lagrangian."""

from __future__ import annotations

from functools import singledispatch
from typing import Any

import torch

from symo_exp.errors import ConfigError
from symo_exp.mechanics.bodies import Joint, Vector, of_pseudo_inertia, vector
from symo_exp.mechanics.types import Coordinates
from symo_exp.mechanics.units import Units
from symo_exp.nets.known import KnownLagrangian
from symo_exp.nets.planar_links import PlanarLinks
from symo_exp.nets.rigid_body import LearnedRigidBody
from symo_exp.nets.rigid_chain import RigidChain
from symo_exp.systems.base import LagrangianSystem, Linkage
from symo_exp.use.planar_bodies import planar_bodies


@singledispatch
def linkage(lagrangian: Any, coordinates: Coordinates) -> Linkage:
    """Return the rigid bodies of a Lagrangian; refuse one that has none."""
    raise ConfigError(
        "this model does not consist of rigid bodies, which .xml and .urdf require; learn symo, "
        "e2e_symo or l_node with lagrangian=planar, rigid, rigid_body or known, or write .pt2"
    )


@linkage.register
def _(lagrangian: RigidChain, coordinates: Coordinates) -> Linkage:
    joints, at = [], torch.zeros(3, dtype=torch.float64)
    axes, places = (x.double().view(-1, 3) for x in (lagrangian.axes, lagrangian.places))
    factors = lagrangian.factors().double()
    for i, name in enumerate(coordinates.names):
        at = at + places[i]
        mass, centre, inertia = of_pseudo_inertia(factors[i] @ factors[i].T)
        joints.append(
            Joint(
                name=name,
                slides=not bool(lagrangian.turns[i]),
                parent=i - 1,
                axis=vector(axes[i] / axes[i].norm()),
                anchor=vector(at),
                reference=0.0,
                mass=float(mass),
                centre=vector(at + centre),
                inertia=tuple(map(vector, inertia)),  # type: ignore[arg-type]
                armature=float(lagrangian.rotors[i].square()),
            )
        )
    return Linkage(joints, vector(lagrangian.gravity), torch.eye(len(joints)).double())


linkage.register(PlanarLinks, planar_bodies)


@linkage.register
def _(lagrangian: LearnedRigidBody, coordinates: Coordinates) -> Linkage:
    if lagrangian.gravity is None or lagrangian.input_net is not None:
        raise ConfigError(
            "networks of the rotation are no rigid body, which .xml requires; learn with "
            "lagrangian.potential_width=0 and input_width=0"
        )
    factor = lagrangian.factor(lagrangian.moments.double())
    return Linkage.of_body(lagrangian.coordinates, factor @ factor.mT, lagrangian.gravity)


@linkage.register
def _(lagrangian: KnownLagrangian, coordinates: Coordinates) -> Linkage:
    return linkage(lagrangian.system.with_constants(lagrangian.constants()), coordinates)


@linkage.register
def _(lagrangian: LagrangianSystem, coordinates: Coordinates) -> Linkage:
    if lagrangian.linkage is None:
        raise ConfigError(
            f"{type(lagrangian).__name__} is not described by rigid bodies: give it a property "
            "`linkage` (docs/own_system.md), or write .pt2"
        )
    return lagrangian.linkage


def in_si(found: Linkage, units: Units) -> Linkage:
    """Return rigid bodies, whose numbers are in other units, in SI units."""
    length, inertia = units.length, units.size("kg m^2")

    def scaled(joint: Joint) -> Joint:
        size = length if joint.slides else 1.0
        return joint._replace(
            anchor=_times(length, joint.anchor),
            reference=size * joint.reference,
            mass=units.mass * joint.mass,
            centre=_times(length, joint.centre),
            inertia=tuple(_times(inertia, row) for row in joint.inertia),  # type: ignore[arg-type]
            armature=inertia / size**2 * joint.armature,
            stiffness=units.size("N m") / size**2 * joint.stiffness,
            rest=size * joint.rest,
        )

    gravity = _times(units.size("m/s^2"), found.gravity)
    return found._replace(joints=[scaled(joint) for joint in found.joints], gravity=gravity)


def _times(factor: float, values: Vector) -> Vector:
    x, y, z = values
    return factor * x, factor * y, factor * z
