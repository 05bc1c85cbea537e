"""Mechanisms written as model files: MJCF and URDF.

A mechanism is what ``Multibody`` takes and ``symo_exp.systems.mujoco`` reads: joints, gravity and
inputs. Every body of a file has the axes of the world where all coordinates have their reference
values.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from symo_exp.errors import ConfigError
from symo_exp.mechanics.bodies import Joint

POINT = 1e-13
"""Least mass [kg] and inertia [kg m^2] of a body that moves: MuJoCo refuses zero."""


def mjcf(
    mechanism: Mapping[str, Any],
    *,
    name: str = "learned",
    damping: Sequence[Sequence[float]] | None = None,
    friction: Sequence[tuple[float, Sequence[float]]] | None = None,
    comments: Sequence[str] = (),
) -> str:
    """Return a mechanism as the text of an MJCF file.

    Args:
        mechanism: Joints, gravity and inputs; a fluid is left out.
        name: Name of the model.
        damping: Viscous friction (n, n), symmetric and positive semidefinite, in the place of the
            joints' own. Damping between joints is written as damped fixed tendons.
        friction: Dry friction ``c`` along directions ``a``, of ``-c sign(a . v) a``, likewise.
        comments: Lines for the head of the file.
    """
    joints = [Joint(**joint) for joint in mechanism["joints"]]
    root = ET.Element("mujoco", model=name)
    _comment(root, comments)
    ET.SubElement(root, "compiler", angle="radian", autolimits="true", inertiafromgeom="false")
    option = ET.SubElement(
        root, "option", gravity=_vector(mechanism["gravity"]), integrator="RK4", timestep="0.002"
    )
    ET.SubElement(option, "flag", contact="disable")
    world = ET.SubElement(root, "worldbody")
    matrix = np.diag([joint.damping for joint in joints])
    if damping is not None:
        matrix = np.array(damping, dtype=float)
    own, coupled = _uncoupled(matrix)
    if friction is not None:
        alone = {int(np.flatnonzero(a)[0]): c for c, a in friction if np.count_nonzero(a) == 1}
        joints = [joint._replace(friction=alone.get(i, 0.0)) for i, joint in enumerate(joints)]
    bodies: list[tuple[ET.Element, np.ndarray]] = []
    for i, joint in enumerate(joints):
        inside, at = bodies[joint.parent] if joint.parent >= 0 else (world, np.zeros(3))
        shared = joint.parent >= 0 and _passes_on(joints, joint.parent)
        if not shared:
            place = np.array(joint.anchor)
            inside = ET.SubElement(
                inside, "body", name=f"{joint.name}_body", pos=_vector(place - at)
            )
            at = place
        bodies.append((inside, at))
        _joint(inside, joint, at, float(own[i]))
        if not _passes_on(joints, i):
            _inertial(inside, joint, at)
    tendons, actuators = ET.Element("tendon"), ET.Element("actuator")
    for k, (weight, direction) in enumerate(coupled):
        tendon = ET.SubElement(tendons, "fixed", name=f"damper_{k}", damping=_number(weight))
        _coefficients(tendon, joints, direction)
    for k, (loss, a) in enumerate(friction or ()):
        if np.count_nonzero(a) > 1:
            tendon = ET.SubElement(tendons, "fixed", name=f"brake_{k}", frictionloss=_number(loss))
            _coefficients(tendon, joints, a)
    _actuators(actuators, tendons, joints, mechanism["inputs"])
    root.extend(x for x in (tendons, actuators) if len(x))
    return _text(root)


def urdf(
    mechanism: Mapping[str, Any], *, name: str = "learned", comments: Sequence[str] = ()
) -> str:
    """Return a mechanism as the text of a URDF file, which has no armature, springs or inputs.

    Raises:
        ConfigError: If a joint has a reference other than zero, which a URDF cannot state.
    """
    joints = [Joint(**joint) for joint in mechanism["joints"]]
    if any(joint.reference for joint in joints):
        raise ConfigError("a URDF has no reference values of joints, as this model has; write .xml")
    root = ET.Element("robot", name=name)
    _comment(root, comments)
    ET.SubElement(root, "link", name="world")
    for joint in joints:
        link = ET.SubElement(root, "link", name=f"{joint.name}_link")
        inertial = ET.SubElement(link, "inertial")
        centre = np.array(joint.centre) - np.array(joint.anchor)
        inertia = np.array(joint.inertia)
        if joint.mass == 0.0:
            centre, inertia = np.zeros(3), POINT * np.eye(3)
        ET.SubElement(inertial, "origin", xyz=_vector(centre), rpy="0 0 0")
        ET.SubElement(inertial, "mass", value=_number(max(joint.mass, POINT)))
        entries = {f"i{a}": inertia["xyz".index(a[0]), "xyz".index(a[1])] for a in _ENTRIES}
        ET.SubElement(inertial, "inertia", {k: _number(x) for k, x in entries.items()})
    for joint in joints:
        at = np.array(joints[joint.parent].anchor) if joint.parent >= 0 else np.zeros(3)
        parent = f"{joints[joint.parent].name}_link" if joint.parent >= 0 else "world"
        kind = "prismatic" if joint.slides else "revolute" if joint.limits else "continuous"
        node = ET.SubElement(root, "joint", name=joint.name, type=kind)
        ET.SubElement(node, "parent", link=parent)
        ET.SubElement(node, "child", link=f"{joint.name}_link")
        ET.SubElement(node, "origin", xyz=_vector(np.array(joint.anchor) - at), rpy="0 0 0")
        ET.SubElement(node, "axis", xyz=_vector(joint.axis))
        if joint.limits or joint.slides:
            low, high = joint.limits or (-1e9, 1e9)
            limit = {"lower": low, "upper": high, "effort": 1e9, "velocity": 1e9}
            ET.SubElement(node, "limit", {k: _number(x) for k, x in limit.items()})
        friction = {"damping": joint.damping, "friction": joint.friction}
        ET.SubElement(node, "dynamics", {k: _number(x) for k, x in friction.items()})
    return _text(root)


_ENTRIES = ("xx", "yy", "zz", "xy", "xz", "yz")


def _joint(body: ET.Element, joint: Joint, at: np.ndarray, damping: float) -> None:
    given = {
        "pos": _vector(np.array(joint.anchor) - at),
        "axis": _vector(joint.axis),
        "ref": _number(joint.reference),
        "armature": _number(joint.armature),
        "damping": _number(damping),
        "frictionloss": _number(joint.friction),
    }
    if joint.stiffness:
        given |= {"stiffness": _number(joint.stiffness), "springref": _number(joint.rest)}
    if joint.limits:
        given["range"] = _vector(joint.limits)
    kind = "slide" if joint.slides else "hinge"
    ET.SubElement(body, "joint", {"name": joint.name, "type": kind} | given)


def _inertial(body: ET.Element, joint: Joint, at: np.ndarray) -> None:
    node = ET.Element("inertial")
    inertia, centre = np.array(joint.inertia), np.array(joint.centre) - at
    if joint.mass == 0.0:
        centre = np.zeros(3)
    if np.linalg.eigvalsh(inertia).min() < POINT:
        inertia = inertia + POINT * np.eye(3)
    moments, axes = _principal(inertia)
    node.attrib.update(
        pos=_vector(centre),
        mass=_number(max(joint.mass, POINT)),
        diaginertia=_vector(moments),
        quat=_vector(np.roll(Rotation.from_matrix(axes).as_quat(), 1)),  # scalar first
    )
    body.insert(0, node)


def _principal(inertia: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the principal moments of an inertia and the rotation to their axes.

    MuJoCo 3.3 finds them from ``fullinertia`` to 1e-8 only.
    """
    if not (inertia - np.diag(np.diag(inertia))).any():
        return np.diag(inertia), np.eye(3)
    moments, axes = np.linalg.eigh(inertia)
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    return moments, axes


def _passes_on(joints: Sequence[Joint], i: int) -> bool:
    """Return whether a joint moves nothing but one other joint, with which it shares a body."""
    children = [j for j, joint in enumerate(joints) if joint.parent == i]
    return joints[i].mass == 0.0 and len(children) == 1


def _uncoupled(matrix: np.ndarray) -> tuple[np.ndarray, list[tuple[float, np.ndarray]]]:
    """Split ``D = diag(own) + Σ w a aᵀ``; without coupling there is no second part."""
    off = matrix - np.diag(np.diag(matrix))
    if not off.any():
        return np.diag(matrix), []
    values, vectors = np.linalg.eigh(0.5 * (matrix + matrix.T))
    pairs = zip(values, vectors.T, strict=True)
    return np.zeros(len(matrix)), [(max(float(w), 0.0), a) for w, a in pairs if w > 0.0]


def _actuators(
    actuators: ET.Element, tendons: ET.Element, joints: Sequence[Joint], inputs: Mapping[str, Any]
) -> None:
    matrix = np.array(inputs["matrix"], dtype=float).reshape(len(joints), -1)
    ranges = inputs.get("ranges") or [None] * matrix.shape[1]
    for k, (label, column, limits) in enumerate(
        zip(inputs["names"], matrix.T, ranges, strict=True)
    ):
        motor = ET.SubElement(actuators, "motor", name=str(label))
        driven = np.flatnonzero(column)
        if len(driven) == 1:
            motor.attrib.update(joint=joints[driven[0]].name, gear=_number(column[driven[0]]))
        else:
            tendon = ET.SubElement(tendons, "fixed", name=f"input_{k}")
            _coefficients(tendon, joints, column)
            motor.attrib.update(tendon=f"input_{k}")
        if limits is not None:
            motor.attrib["ctrlrange"] = _vector(limits)


def _coefficients(tendon: ET.Element, joints: Sequence[Joint], values: Iterable[float]) -> None:
    for joint, value in zip(joints, values, strict=True):
        ET.SubElement(tendon, "joint", joint=joint.name, coef=_number(value))


def _comment(root: ET.Element, lines: Sequence[str]) -> None:
    for line in lines:
        root.append(ET.Comment(f" {line.replace('--', '- -')} "))


def _number(value: float) -> str:
    return repr(float(value))


def _vector(values: Iterable[float]) -> str:
    return " ".join(map(_number, values))


def _text(root: ET.Element) -> str:
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"
