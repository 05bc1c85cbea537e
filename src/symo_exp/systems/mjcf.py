"""Mechanisms written as model files: MJCF and URDF.

A mechanism is what ``Multibody`` takes and ``symo_exp.systems.mujoco`` reads: joints, gravity and
inputs. At the reference values of all coordinates, every body of a file has the axes of the world;
bodies on ball joints have the axes that their rotations refer to.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from symo_exp.errors import ConfigError
from symo_exp.mechanics.bodies import Joint, freedoms, freedoms_of

POINT = 1e-13
"""Least mass [kg] and inertia [kg m^2] of a body that moves: MuJoCo refuses zero."""
NOTICED = 1e-6
"""Relative change of a body that is reported."""
LAMINA = 1e-13
"""Share of the largest moment by which the sum of the others exceeds it at least."""


def mjcf(
    mechanism: Mapping[str, Any],
    *,
    name: str = "learned",
    damping: Sequence[Sequence[float]] | None = None,
    friction: Sequence[tuple[float, Sequence[float]]] = (),
    comments: Sequence[str] = (),
) -> str:
    """Return a mechanism as the text of an MJCF file.

    Args:
        mechanism: Joints, gravity and inputs; a fluid is left out.
        name: Name of the model.
        damping: Viscous friction (n, n), symmetric and positive semidefinite, in the place of the
            joints' own. Damping between joints is written as damped fixed tendons.
        friction: Dry friction ``c`` along directions ``a``, of ``-c sign(a . v) a``; that along one
            coordinate alone is the joint's own, and not written again.
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
    first = [own[0] for own in freedoms_of(joints)]
    matrix = np.diag([joints[i].damping for i, _ in freedoms(joints)])
    if damping is not None:
        matrix = np.array(damping, dtype=float)
    own, coupled = _uncoupled(matrix)
    free = _free(joints, mechanism, own)
    bodies: list[_Frame] = []
    for i, joint in enumerate(joints):
        inside = (
            bodies[joint.parent] if joint.parent >= 0 else _Frame(world, np.zeros(3), np.eye(3))
        )
        if i in free:  # a slide of a free body
            bodies.append(inside)
            continue
        shared = joint.parent >= 0 and _passes_on(joints, joint.parent)
        if not shared:
            inside = _body(inside, joint)
        bodies.append(inside)
        if i in free.values():
            given = {"name": _free_name(joint), "type": "free"} | _passive(joint, own[first[i]])
            ET.SubElement(inside.element, "joint", given)
        else:
            _joint(inside, joint, float(own[first[i]]))
        if i in {ball for _, ball in mechanism.get("free", ())}:
            ET.SubElement(inside.element, "site", name=f"{_free_name(joint)}_origin")
        if not _passes_on(joints, i):
            _inertial(inside, joint)
    tendons, actuators = ET.Element("tendon"), ET.Element("actuator")
    for k, (weight, direction) in enumerate(coupled):
        tendon = ET.SubElement(tendons, "fixed", name=f"damper_{k}", damping=_number(weight))
        _coefficients(tendon, joints, direction)
    for k, (loss, a) in enumerate(friction):
        if np.count_nonzero(a) > 1:
            tendon = ET.SubElement(tendons, "fixed", name=f"brake_{k}", frictionloss=_number(loss))
            _coefficients(tendon, joints, a)
    _actuators(actuators, tendons, joints, mechanism)
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
        inertia = _positive(np.array(joint.inertia))
        if joint.mass == 0.0:
            centre = np.zeros(3)
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


class _Frame(NamedTuple):
    """A body of the file, with its origin and axes at the reference."""

    element: ET.Element
    origin: np.ndarray
    axes: np.ndarray

    def place(self, point: Sequence[float]) -> str:
        return _vector(self.axes.T @ (np.array(point) - self.origin))

    def turned(self, axes: np.ndarray) -> dict[str, str]:
        """Attributes of a part with these axes."""
        own = self.axes.T @ axes
        return {} if np.array_equal(own, np.eye(3)) else {"quat": _quaternion(own)}


def _body(inside: _Frame, joint: Joint) -> _Frame:
    """Return a new body at the anchor of a joint; that of a ball joint has its axes."""
    start = axes = np.eye(3)
    if joint.axes is not None:
        start, axes = np.array(joint.base), np.array(joint.axes)
    given = {"name": f"{joint.name}_body", "pos": inside.place(joint.anchor)} | inside.turned(start)
    return _Frame(ET.SubElement(inside.element, "body", given), np.array(joint.anchor), axes)


def _passive(joint: Joint, damping: float) -> dict[str, str]:
    return {
        "armature": _number(joint.armature),
        "damping": _number(damping),
        "frictionloss": _number(joint.friction),
    }


def _joint(inside: _Frame, joint: Joint, damping: float) -> None:
    given = {"name": joint.name, "pos": inside.place(joint.anchor)}
    if joint.axes is not None:
        ET.SubElement(inside.element, "joint", given | {"type": "ball"} | _passive(joint, damping))
        return
    given |= {
        "type": "slide" if joint.slides else "hinge",
        "axis": _vector(inside.axes.T @ np.array(joint.axis)),
        "ref": _number(joint.reference),
        **_passive(joint, damping),
    }
    if joint.stiffness:
        given |= {"stiffness": _number(joint.stiffness), "springref": _number(joint.rest)}
    if joint.limits:
        given["range"] = _vector(joint.limits)
    ET.SubElement(inside.element, "joint", given)


def _inertial(inside: _Frame, joint: Joint) -> None:
    node = ET.Element("inertial")
    centre = joint.centre if joint.mass > 0.0 else inside.origin.tolist()
    moments, axes = _principal(_positive(inside.axes.T @ np.array(joint.inertia) @ inside.axes))
    node.attrib.update(
        pos=inside.place(centre),
        mass=_number(max(joint.mass, POINT)),
        diaginertia=_vector(moments),
        quat=_quaternion(axes),
    )
    inside.element.insert(0, node)


def _positive(inertia: np.ndarray) -> np.ndarray:
    """Return an inertia that MuJoCo accepts, whatever its rounding.

    MuJoCo refuses a zero moment, such as that of a thin rod. It also refuses moments the largest of
    which exceeds the sum of the others by a rounding error, as it may for a flat body.
    """
    least, middle, largest = np.linalg.eigvalsh(inertia)
    spare = LAMINA * largest - (least + middle - largest)
    return inertia + max(POINT * (least < POINT), spare, 0.0) * np.eye(3)


def _quaternion(axes: np.ndarray) -> str:
    """Return a rotation as MuJoCo writes it, scalar first."""
    return _vector(np.roll(Rotation.from_matrix(axes).as_quat(), 1))


def _free(
    joints: Sequence[Joint], mechanism: Mapping[str, Any], damping: np.ndarray
) -> dict[int, int]:
    """Return the ball joint of each slide of the free bodies that one free joint can move.

    A free joint has no reference and no spring, and the same friction and armature in all
    directions.
    """
    places = freedoms_of(joints)
    found: dict[int, int] = {}
    for start, ball in mechanism.get("free", ()):
        parts = [joints[i] for i in range(start, ball + 1)]
        own = {damping[k] for part in places[start : ball + 1] for k in part}
        alike = {(x.armature, x.friction, x.stiffness) for x in parts}  # a ball joint has no spring
        same = len(own) == 1 and len(alike) == 1
        at = [x.reference for x in parts[:3]]
        if (
            same
            and at == list(parts[3].anchor)
            and np.array_equal(np.array(parts[3].base), np.eye(3))
        ):
            found |= dict.fromkeys(range(start, ball), ball)
    return found


def _free_name(joint: Joint) -> str:
    return joint.name.removesuffix("_R")


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
    children = [joint for joint in joints if joint.parent == i]
    if joints[i].mass > 0.0 or len(children) != 1:
        return False
    return joints[i].axes is None and children[0].axes is None


def _uncoupled(matrix: np.ndarray) -> tuple[np.ndarray, list[tuple[float, np.ndarray]]]:
    """Split ``D = diag(own) + Σ w a aᵀ``, the sum over coupled coordinates only."""
    off = matrix - np.diag(np.diag(matrix))
    (some,) = np.nonzero(off.any(0) | off.any(1))
    own, block = np.diag(matrix).copy(), matrix[np.ix_(some, some)]
    own[some] = 0.0
    values, vectors = np.linalg.eigh(0.5 * (block + block.T))
    whole = np.eye(len(matrix))[:, some] @ vectors
    return own, [(float(w), a) for w, a in zip(values, whole.T, strict=True) if w > 0.0]


def unwritten(mechanism: Mapping[str, Any]) -> list[str]:
    """Return the names of inputs that act on a ball joint and others, which no motor does."""
    joints = [Joint(**joint) for joint in mechanism["joints"]]
    names, columns = mechanism["inputs"]["names"], _columns(joints, mechanism["inputs"])
    moves = [_moves(joints, column, mechanism) for column in columns]
    return [str(name) for name, move in zip(names, moves, strict=True) if move is None]


def raised(mechanism: Mapping[str, Any]) -> list[str]:
    """Return the names of joints whose bodies are so light that a file holds heavier ones."""
    found = []
    for joint in (Joint(**joint) for joint in mechanism["joints"]):
        arm, inertia = np.subtract(joint.centre, joint.anchor), np.array(joint.inertia)
        lever = arm @ arm * np.eye(3) - np.outer(arm, arm)
        along = np.eye(3) if joint.axes is not None else np.outer(joint.axis, joint.axis)
        body = joint.mass, inertia
        more = max(POINT - joint.mass, 0.0), _positive(inertia) - inertia
        own, added = (
            mass if joint.slides else float(np.sum(along * (turned + mass * lever)))
            for mass, turned in (body, more)
        )
        if joint.mass > 0.0 and added > NOTICED * (own + joint.armature):
            found.append(joint.name)
    return found


def _columns(joints: Sequence[Joint], inputs: Mapping[str, Any]) -> np.ndarray:
    """Return the columns of the input matrix, one in a row."""
    return np.array(inputs["matrix"], dtype=float).reshape(len(freedoms(joints)), -1).T


def _moves(
    joints: Sequence[Joint], column: np.ndarray, mechanism: Mapping[str, Any]
) -> dict[str, str] | None:
    """Return what a motor acts on; nothing for a tendon of it, ``None`` if it cannot be written."""
    places = freedoms_of(joints)
    driven = {i for i, own in enumerate(places) if column[own].any()}
    for start, ball in mechanism.get("free", ()):
        if driven and driven <= set(range(start, ball + 1)):
            own = [k for part in places[start : ball + 1] for k in part]
            return {"site": f"{_free_name(joints[ball])}_origin", "gear": _vector(column[own])}
        if driven & set(range(start, ball + 1)):
            return None
    if len(driven) == 1:
        (joint,) = driven
        return {"joint": joints[joint].name, "gear": _vector(column[places[joint]])}
    return None if any(joints[i].axes is not None for i in driven) else {}


def _actuators(
    actuators: ET.Element,
    tendons: ET.Element,
    joints: Sequence[Joint],
    mechanism: Mapping[str, Any],
) -> None:
    inputs = mechanism["inputs"]
    columns = _columns(joints, inputs)
    ranges = inputs.get("ranges") or [None] * len(columns)
    for k, (label, column, limits) in enumerate(zip(inputs["names"], columns, ranges, strict=True)):
        moves = _moves(joints, column, mechanism)
        if moves is None:
            continue
        motor = ET.SubElement(actuators, "motor", {"name": str(label)} | moves)
        if not moves:
            tendon = ET.SubElement(tendons, "fixed", name=f"input_{k}")
            _coefficients(tendon, joints, column)
            motor.attrib.update(tendon=f"input_{k}")
        if limits is not None:
            motor.attrib["ctrlrange"] = _vector(limits)


def _coefficients(tendon: ET.Element, joints: Sequence[Joint], values: Iterable[float]) -> None:
    for (i, _), value in zip(freedoms(joints), values, strict=True):
        if joints[i].axes is None:
            ET.SubElement(tendon, "joint", joint=joints[i].name, coef=_number(value))


def _comment(root: ET.Element, lines: Sequence[str]) -> None:
    for line in lines:
        root.append(ET.Comment(f" {re.sub('-(?=-)', '- ', line)} "))


def _number(value: float) -> str:
    return repr(float(value))


def _vector(values: Iterable[float]) -> str:
    return " ".join(map(_number, values))


def _text(root: ET.Element) -> str:
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"
