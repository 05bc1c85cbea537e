"""Learned rigid bodies written back into a model file."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from symo_exp.errors import ConfigError
from symo_exp.files import write_text
from symo_exp.mechanics.bodies import Joint, freedoms_of
from symo_exp.mechanics.dissipation import DissipativeLagrangian
from symo_exp.mechanics.scaled import Scale, ScaledDissipation, ScaledLagrangian
from symo_exp.models.base import DynamicsModel
from symo_exp.nets.planar_links import PlanarLinks
from symo_exp.nets.rigid_body import LearnedRigidBody
from symo_exp.nets.springs import LinearSprings, SprungLagrangian
from symo_exp.systems.base import Linkage
from symo_exp.systems.mjcf import POINT, mjcf, raised, unwritten, urdf
from symo_exp.use.linkages import in_si, linkage
from symo_exp.use.passive import Coupled, of_each, passive
from symo_exp.use.planar_bodies import constant_forces, distance_from_rigid

log = logging.getLogger(__name__)


def write_bodies(model: DynamicsModel, path: Path) -> Path:
    """Write the rigid bodies of a model as MJCF (``.xml``) or URDF (``.urdf``).

    Parts that the file cannot represent are named in a comment at its head and in the log.

    Raises:
        ConfigError: If the model does not consist of rigid bodies.
    """
    model = model.for_evaluation().cpu()
    parts = _Parts.of(model)
    found = in_si(linkage(parts.lagrangian, model.coordinates), model.coordinates.units)
    is_urdf = path.suffix == ".urdf"
    if is_urdf and any(joint.axes is not None for joint in found.joints):
        raise ConfigError(f"{path.name}: a URDF has no ball joints, as this model has; write .xml")
    inverse = torch.linalg.inv(found.matrix)
    missing: list[str] = []
    damping, friction = _friction(parts, inverse, missing)
    found = found._replace(joints=_sprung(model, parts, found, inverse, missing))
    damping, friction = _of_balls(found.joints, damping, friction, missing)
    along: Coupled = [(c, _tidy(inverse.new_tensor(a) @ inverse)) for c, a in friction]
    if not torch.equal(found.matrix, torch.eye(len(inverse)).double()):
        missing.append("joint coordinates are A q with A = " + str(found.matrix.tolist()))
    if is_urdf:
        missing += _beyond_urdf(found, damping, along)
    mechanism = {
        "joints": [joint._asdict() for joint in _with_friction(found.joints, damping, along)],
        "gravity": list(found.gravity),
        "inputs": _inputs(model, parts.lagrangian, inverse),
        "free": found.free,
    }
    least = f"the body of {{}} is heavier in this file: at least {POINT:g} kg and kg m^2"
    missing += [least.format(name) for name in raised(mechanism)]
    missing += [f"the input {name} is not in this file" for name in unwritten(mechanism)]
    for line in missing:
        log.warning("%s: %s", path.name, line)
    if is_urdf:
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


class _Parts(NamedTuple):
    """The mechanics of a model, taken apart."""

    lagrangian: Any
    dissipation: Any
    springs: LinearSprings | None
    scale: Scale

    @staticmethod
    def of(model: DynamicsModel) -> _Parts:
        lagrangian: Any = model.lagrangian
        dissipation, springs, scale = None, None, Scale(model.coordinates)
        if isinstance(lagrangian, DissipativeLagrangian):
            lagrangian, dissipation = lagrangian.conservative, lagrangian.dissipation
        if isinstance(lagrangian, ScaledLagrangian):
            lagrangian, scale = lagrangian.inner, lagrangian.scale
        if isinstance(dissipation, ScaledDissipation):
            dissipation = dissipation.inner
        if isinstance(lagrangian, SprungLagrangian):
            lagrangian, springs = lagrangian.conservative, lagrangian.springs
        return _Parts(lagrangian, dissipation, springs, scale)


def _friction(parts: _Parts, inverse: Tensor, missing: list[str]) -> tuple[Tensor, Coupled]:
    """Return viscous friction (n, n) of the joints, and dry friction along coordinates, in SI."""
    damping, friction, lost = passive(parts.dissipation, len(inverse))
    missing += lost
    damping = inverse.T @ parts.scale.matrix(damping, 1) @ inverse
    forces = ((c, parts.scale.force(inverse.new_tensor(a))) for c, a in friction)
    return damping, [_unit_direction(c, force) for c, force in forces]


def _sprung(
    model: DynamicsModel, parts: _Parts, found: Linkage, inverse: Tensor, missing: list[str]
) -> Sequence[Joint]:
    """Return the joints with their springs, which take over constant forces."""
    joints = found.joints
    constant = torch.zeros(len(inverse)).double()
    if isinstance(parts.lagrangian, PlanarLinks):
        forces = constant_forces(parts.lagrangian, model.coordinates)
        constant = model.coordinates.units.size("N") * inverse.new_tensor(forces)
        if distance := distance_from_rigid(parts.lagrangian, model.coordinates):
            missing.append(
                "the learned links are not exactly rigid: they differ from those in this file by "
                f"{distance:.2g} of their inertia or weight"
            )
    if parts.springs is not None:
        joints = _with_springs(joints, parts.springs, parts.scale, inverse, constant, missing)
    missing += [
        f"the constant force of {force:.6g} N along {joint.name} is not in this file"
        for joint, force in zip(joints, constant.tolist(), strict=False)
        if force
    ]
    return joints


def _unit_direction(coefficient: float, direction: Tensor) -> tuple[float, list[float]]:
    """Return a direction whose largest entry is one, and its coefficient."""
    largest = float(direction.abs().max())
    return coefficient * largest, (direction / largest).tolist()


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
        held[own, own], mean[own] = _mean(damping[own, own]), _mean(dry[own])
    pairs = (held, damping), (mean, dry)
    if not all(torch.allclose(x, y, rtol=1e-12, atol=0.0) for x, y in pairs):
        missing.append("friction of ball joints is its mean over their axes in this file")
    return held, [*of_each(mean), *coupled]


def _mean(values: Tensor) -> Tensor:
    """Return the mean, without a rounding error of equal values, which one free joint can have."""
    return values[0] if (values == values[0]).all() else values.mean()


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
