"""Learned rigid bodies written back into a model file."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from functools import singledispatch
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from symo_exp.errors import ConfigError
from symo_exp.files import write_text
from symo_exp.mechanics.bodies import Joint, freedoms_of, of_pseudo_inertia
from symo_exp.mechanics.dissipation import DissipativeLagrangian, Friction
from symo_exp.mechanics.scaled import Scale, ScaledDissipation, ScaledLagrangian
from symo_exp.mechanics.types import Coordinates
from symo_exp.mechanics.units import Units
from symo_exp.models.base import DynamicsModel
from symo_exp.nets.dissipation import LearnedDissipation, MachineFriction
from symo_exp.nets.known import KnownFriction, KnownLagrangian
from symo_exp.nets.planar_links import PlanarLinks
from symo_exp.nets.rigid_body import LearnedRigidBody
from symo_exp.nets.rigid_chain import RigidChain
from symo_exp.nets.springs import LinearSprings, SprungLagrangian
from symo_exp.systems.base import LagrangianSystem, Linkage
from symo_exp.systems.mjcf import POINT, mjcf, raised, unwritten, urdf
from symo_exp.use.planar_bodies import constant_forces, distance_from_rigid, planar_bodies

log = logging.getLogger(__name__)

Coupled = list[tuple[float, list[float]]]
"""Coefficients and the directions in joint coordinates that they act along."""
SMOOTH = "dry friction is smooth about standstill in the learned model, and abrupt in this file"


def write_bodies(model: DynamicsModel, path: Path) -> Path:
    """Write the rigid bodies of a model as MJCF (``.xml``) or URDF (``.urdf``).

    Parts that the file cannot represent are named in a comment at its head and in the log.

    Raises:
        ConfigError: If the model does not consist of rigid bodies.
    """
    model = model.for_evaluation().cpu()
    lagrangian: Any = model.lagrangian
    dissipation: Any = None
    if isinstance(lagrangian, DissipativeLagrangian):
        lagrangian, dissipation = lagrangian.conservative, lagrangian.dissipation
    units, scale = model.coordinates.units, Scale(model.coordinates)
    if isinstance(lagrangian, ScaledLagrangian):
        lagrangian, scale = lagrangian.inner, lagrangian.scale
    if isinstance(dissipation, ScaledDissipation):
        dissipation = dissipation.inner
    springs: LinearSprings | None = None
    if isinstance(lagrangian, SprungLagrangian):
        lagrangian, springs = lagrangian.conservative, lagrangian.springs
    found = _in_si(linkage(lagrangian, model.coordinates), units)
    if path.suffix == ".urdf" and any(joint.axes is not None for joint in found.joints):
        raise ConfigError(f"{path.name}: a URDF has no ball joints, as this model has; write .xml")
    inverse = torch.linalg.inv(found.matrix)
    damping, friction, missing = passive(dissipation, found.matrix.shape[0])
    constant = torch.zeros(len(inverse)).double()
    if isinstance(lagrangian, PlanarLinks):
        forces = constant_forces(lagrangian, model.coordinates)
        constant = units.size("N") * torch.tensor(forces).double()
        if distance := distance_from_rigid(lagrangian, model.coordinates):
            missing.append(
                "the learned links are not exactly rigid: they differ from those in this file by "
                f"{distance:.2g} of their inertia or weight"
            )
    damping = inverse.T @ scale.matrix(damping, 1) @ inverse
    friction = [_unit_direction(c, scale.force(torch.tensor(a).double())) for c, a in friction]
    if springs is not None:
        joints = _with_springs(found.joints, springs, scale, inverse, constant, missing)
        found = found._replace(joints=joints)
    missing += [
        f"the constant force of {force:.6g} N along {joint.name} is not in this file"
        for joint, force in zip(found.joints, constant.tolist(), strict=False)
        if force
    ]
    damping, friction = _of_balls(found.joints, damping, friction, missing)
    along: Coupled = [(c, _tidy(torch.tensor(a).double() @ inverse)) for c, a in friction]
    if not torch.equal(found.matrix, torch.eye(len(inverse)).double()):
        missing.append("joint coordinates are A q with A = " + str(found.matrix.tolist()))
    if path.suffix == ".urdf":
        missing += _beyond_urdf(found, damping, along)
    mechanism = {
        "joints": [joint._asdict() for joint in _with_friction(found.joints, damping, along)],
        "gravity": list(found.gravity),
        "inputs": _inputs(model, lagrangian, inverse),
        "free": found.free,
    }
    least = f"the body of {{}} is heavier in this file: at least {POINT:g} kg and kg m^2"
    missing += [least.format(name) for name in raised(mechanism)]
    missing += [f"the input {name} is not in this file" for name in unwritten(mechanism)]
    for line in missing:
        log.warning("%s: %s", path.name, line)
    if path.suffix == ".urdf":
        text = urdf(mechanism, name=path.stem, comments=missing)
    else:
        text = mjcf(
            mechanism,
            name=path.stem,
            damping=damping.tolist(),
            friction=along,
            comments=missing,
        )
    write_text(path, text)
    return path


@singledispatch
def linkage(lagrangian: Any, coordinates: Coordinates) -> Linkage:
    """Return the rigid bodies of a Lagrangian; refuse one that has none."""
    raise ConfigError(
        "this model does not consist of rigid bodies, which .xml and .urdf require; learn symo, "
        "e2e_symo or l_node with lagrangian=planar, rigid, rigid_body or known, or write .pt2"
    )


def _unit_direction(coefficient: float, direction: Tensor) -> tuple[float, list[float]]:
    """Return a direction whose largest entry is one, and its coefficient."""
    largest = float(direction.abs().max())
    return coefficient * largest, (direction / largest).tolist()


def _in_si(found: Linkage, units: Units) -> Linkage:
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
                axis=_three(axes[i] / axes[i].norm()),
                anchor=_three(at),
                reference=0.0,
                mass=float(mass),
                centre=_three(at + centre),
                inertia=tuple(map(_three, inertia)),  # type: ignore[arg-type]
                armature=float(lagrangian.rotors[i].square()),
            )
        )
    return Linkage(joints, _three(lagrangian.gravity), torch.eye(len(joints)).double())


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
            f"{type(lagrangian).__name__} is not described by rigid bodies: give it a `linkage`"
        )
    return lagrangian.linkage


@singledispatch
def passive(dissipation: Any, n: int) -> tuple[Tensor, Coupled, list[str]]:
    """Return viscous friction, dry friction with its directions, and what no file can hold."""
    missing = [] if dissipation is None else [f"{type(dissipation).__name__} is not in this file"]
    return torch.zeros(n, n).double(), [], missing


@passive.register
def _(dissipation: LearnedDissipation, n: int) -> tuple[Tensor, Coupled, list[str]]:
    viscous, dry = dissipation.coefficients()
    joints = dissipation.joints.double()
    missing = [SMOOTH] if dry is not None else []
    if dissipation.net is not None:
        missing.append("the network of the dissipation is not in this file")
    coefficients = [] if dry is None else dry[0].tolist()
    matrix = torch.zeros(n, n).double() if viscous is None else viscous.double()
    along = list(zip(coefficients, joints.tolist(), strict=dry is not None))
    return joints.T @ matrix @ joints, along, missing


@passive.register
def _(dissipation: MachineFriction, n: int) -> tuple[Tensor, Coupled, list[str]]:
    viscous, along, missing = passive.dispatch(LearnedDissipation)(dissipation, n)
    terms = {
        "asymmetric friction": dissipation.asymmetry(),
        "the Stribeck effect": dissipation.stribeck(),
        "the constant force": dissipation.constant,
    }
    lost = [f"{name} is not in this file" for name, term in terms.items() if term is not None]
    return viscous, along, missing + lost


@passive.register
def _(dissipation: KnownFriction, n: int) -> tuple[Tensor, Coupled, list[str]]:
    viscous, coulomb = (x[0].double() for x in dissipation.coefficients())
    missing = [SMOOTH] if coulomb.any() else []
    if dissipation.drag is not None:
        missing.append("the drag of the fluid is not in this file")
    return torch.diag(viscous), _of_each(coulomb), missing


@passive.register
def _(dissipation: Friction, n: int) -> tuple[Tensor, Coupled, list[str]]:
    missing = [SMOOTH] if dissipation.coulomb.any() else []
    return dissipation.viscous.double(), _of_each(dissipation.coulomb), missing


def _of_each(coulomb: Tensor) -> Coupled:
    """Return the dry friction of each coordinate that has some."""
    along = zip(coulomb.tolist(), torch.eye(len(coulomb)).tolist(), strict=True)
    return [(c, a) for c, a in along if c > 0.0]


def _with_friction(joints: Sequence[Joint], damping: Tensor, along: Coupled) -> list[Joint]:
    """Return the joints with the friction that acts on one of them alone."""
    own = {int(torch.tensor(a).nonzero()[0]): c for c, a in along if sum(x != 0.0 for x in a) == 1}
    return [
        joint._replace(damping=float(damping[k, k]), friction=own.get(k, 0.0))
        for joint, (k, *_) in zip(joints, freedoms_of(joints), strict=True)
    ]


def _with_springs(
    joints: Sequence[Joint],
    springs: LinearSprings,
    scale: Scale,
    inverse: Tensor,
    constant: Tensor,
    missing: list[str],
) -> list[Joint]:
    """Return the joints with the springs that act on one of them alone.

    They take over the ``constant`` force along their joint, which becomes zero.
    """
    flat, turns = len(springs.preload), len(inverse) - len(springs.preload)
    matrix = nn.functional.pad(springs.matrix.double(), (0, turns, 0, turns))
    stiffness = inverse.T @ scale.matrix(matrix, 0) @ inverse
    preload = inverse.T @ scale.force(nn.functional.pad(springs.preload.double(), (0, turns)))
    own = torch.diag(stiffness.diagonal())
    if (stiffness - own).abs().max() > 1e-12 * stiffness.abs().max():
        missing.append("springs between joints are not in this file")
    sprung = []
    for joint, freedoms in zip(joints, freedoms_of(joints), strict=True):
        k = freedoms[0]
        if k < flat:
            total = joint.stiffness + float(stiffness[k, k])
            force = joint.stiffness * joint.rest + float(preload[k])
            if total > 0.0:
                rest = (force + float(constant[k])) / total
                joint = joint._replace(stiffness=total, rest=rest)
                constant[k] = 0.0
            elif total < 0.0 or force != 0.0:
                missing.append(f"the force of the spring of {joint.name} is not in this file")
        sprung.append(joint)
    return sprung


def _of_balls(
    joints: Sequence[Joint], damping: Tensor, friction: Coupled, missing: list[str]
) -> tuple[Tensor, Coupled]:
    """Return friction that is the same about all axes of each ball joint.

    Where it is not, or couples a ball joint with others, its mean is taken; ``missing`` says so.
    """
    turning = [own for own in freedoms_of(joints) if len(own) > 1]
    if not turning:
        return damping, friction
    held, dry = damping.clone(), torch.zeros(len(damping)).double()
    coupled = []
    for c, a in friction:
        driven = torch.tensor(a).nonzero().flatten()
        if len(driven) == 1:
            dry[driven] += c
        elif not any(a[k] for own in turning for k in own):
            coupled.append((c, a))
        else:
            missing.append("dry friction between a ball joint and others is not in this file")
    mean = dry.clone()
    for own in turning:
        held[own], held[:, own] = 0.0, 0.0
        held[own, own], mean[own] = damping[own, own].mean(), dry[own].mean()
    pairs = (held, damping), (mean, dry)
    if not all(torch.allclose(x, y, rtol=1e-12, atol=0.0) for x, y in pairs):
        missing.append("friction of ball joints is its mean over their axes in this file")
    return held, [*_of_each(mean), *coupled]


def _beyond_urdf(found: Linkage, damping: Tensor, along: Coupled) -> list[str]:
    missing = ["gravity and inputs are not in a URDF"]
    if any(joint.armature for joint in found.joints):
        values = ", ".join(f"{joint.name} {joint.armature:.6g}" for joint in found.joints)
        missing.append(f"armature is not in a URDF: {values}")
    if any(joint.stiffness for joint in found.joints):
        missing.append("springs are not in a URDF")
    if (damping - torch.diag(damping.diagonal())).any() or any(
        sum(x != 0.0 for x in a) > 1 for _, a in along
    ):
        missing.append("friction between joints is not in a URDF, but that of each joint")
    return missing


def _inputs(model: DynamicsModel, lagrangian: Any, inverse: Tensor) -> dict[str, Any]:
    matrix = model.input_matrix.double()
    if isinstance(lagrangian, LearnedRigidBody) and lagrangian.learned_inputs:
        matrix = lagrangian.learned_matrix().double()
    matrix = inverse.T @ matrix
    system = model.system
    names = range(matrix.shape[1]) if system is None else system.inputs
    box = getattr(system, "box", None)
    return {
        "names": [str(name) for name in names],
        "matrix": [_tidy(row) for row in matrix],
        "ranges": None if box is None else [list(x) for x in box.u],
    }


def _tidy(values: Tensor) -> list[float]:
    """Numbers without the rounding errors of products of whole ones, to 12 digits."""
    least = 1e-12 * float(values.abs().max()) if len(values) else 0.0
    return [float(f"{x:.12g}") if abs(x) > least else 0.0 for x in values.tolist()]


def _times(factor: float, values: Sequence[float]) -> tuple[float, float, float]:
    x, y, z = values
    return factor * x, factor * y, factor * z


def _three(values: Tensor) -> tuple[float, float, float]:
    x, y, z = values.double().tolist()
    return x, y, z
