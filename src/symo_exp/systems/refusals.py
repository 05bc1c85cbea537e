"""Features of MuJoCo models that are not supported, or handled differently; a line each."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from symo_exp.systems.mujoco_library import library
from symo_exp.words import counted

FREEDOMS = {"hinge": 1, "slide": 1, "ball": 3, "free": 6}
"""Degrees of freedom of a joint."""


def refusals(model: Any) -> Iterator[str]:
    """Yield a line for each feature of a model that is not supported."""
    for i in range(model.njnt):
        if joint_kind(model, i) in ("ball", "free") and model.jnt_stiffness[i]:
            yield f"joint {joint_name(model, i)}: springs of ball and free joints are not supported"
    if model.njnt == 0:
        yield "it has no joints; give a model with joints"
    if model.neq and model.eq_active0.any():
        yield f"equality constraints ({model.eq_active0.sum()}) are not supported; remove them"
    for count, what in (
        ("ntendon", "tendons"), ("nflex", "flexible bodies"), ("nplugin", "plugins"),
        ("nplastic", "plastic springs"), ("ngravcomp", "bodies with gravity compensation"),
        ("nhistory", "delays"), ("na", "actuators that have states"),
    ):  # fmt: skip
        if getattr(model, count, 0):
            yield f"{what} ({getattr(model, count)}) are not supported; remove them"
    for name in ("jnt_stiffnesspoly", "dof_dampingpoly"):
        if np.any(getattr(model, name, 0)):
            yield f"{name} is not zero: only linear springs and dampers are supported"
    if model.opt.wind.any():
        yield "wind is not supported; remove it"
    if model.geom_fluid[:, 0].any() and (model.opt.density or model.opt.viscosity):
        yield "fluidshape=ellipsoid is not supported; use fluidshape=none"
    yield from _actuators(model)


def _actuators(model: Any) -> Iterator[str]:
    mj = library()
    if getattr(model, "nactuator", model.nu) != model.nu:
        yield "an actuator has several controls; only one each is supported"
    if model.nu and model.opt.disableactuator:
        yield "actuators disabled by their group are not supported; remove them"
    own, parent = int(mj.mjtTrn.mjTRN_JOINT), int(mj.mjtTrn.mjTRN_JOINTINPARENT)
    for i in range(model.nu):
        name, kind = f"actuator {actuator_name(model, i)}", int(model.actuator_trntype[i])
        if (site := site_of(model, i)) is not None:
            if model.actuator_trnid[i, 1] >= 0 or free_joint(model, site) is None:
                yield f"{name} acts at a site that is not on a free body, or has a reference site"
        elif kind not in (own, parent):
            yield f"{name} does not act on a joint; only motors at joints or sites are supported"
        elif (joint := joint_kind(model, model.actuator_trnid[i, 0])) in ("ball", "free"):
            if kind == parent:
                yield f"{name}: torques of {joint} joints act in their own axes; use joint="
            elif joint == "free" and model.actuator_gear[i, :3].any():
                yield f"{name} acts on a free body in world axes; let it act at a site of the body"
        servo = model.actuator_biastype[i] == int(mj.mjtBias.mjBIAS_AFFINE)
        fixed = model.actuator_gaintype[i] == int(mj.mjtGain.mjGAIN_FIXED)
        if not fixed or not (servo or model.actuator_biastype[i] == int(mj.mjtBias.mjBIAS_NONE)):
            yield (
                f"{name} is neither a motor (force proportional to its control) nor a servo (also "
                "to position and velocity); in a copy of the file, write <motor> instead"
            )
        elif servo:
            yield from _servo(model, i, name)
        strongest = abs(model.actuator_gainprm[i, 0]) * controls(model, i)
        if model.actuator_forcelimited[i] and not _within(strongest, model.actuator_forcerange[i]):
            yield f"{name} has a forcerange that its ctrlrange exceeds; narrow the ctrlrange"
    for j in np.flatnonzero(model.jnt_actfrclimited).tolist():
        strongest = _range_of_force(model, j)
        if not _within(strongest, model.jnt_actfrcrange[j]):
            yield f"joint {joint_name(model, j)}: its motors exceed actuatorfrcrange; raise it"


def _servo(model: Any, i: int, name: str) -> Iterator[str]:
    """Yield a line for each reason why a servo is not a spring and a damper on a joint."""
    force, position, velocity = model.actuator_biasprm[i, :3]
    if site_of(model, i) is not None or joint_kind(model, model.actuator_trnid[i, 0]) not in (
        "hinge", "slide"
    ):  # fmt: skip
        yield f"{name} is a servo that does not act on a hinge or slide; write <motor> instead"
    elif model.actuator_forcelimited[i] or model.jnt_actfrclimited[model.actuator_trnid[i, 0]]:
        yield (
            f"{name} is a servo with a limited force, which is not supported; in a copy of the "
            "file, remove the limit, or write <motor> instead, whose control is the force"
        )
    if position > 0.0 or velocity > 0.0 or (force and not position):
        yield f"{name} is a servo with a constant force or a negative gain, which is not supported"


def notes(model: Any) -> Iterator[str]:
    """Yield a line for each feature of a model that is switched off or handled differently."""
    pairs = _touching(model)
    if pairs:
        yield f"contacts are ignored ({counted(pairs, 'pair')} of geoms could touch)"
    kinds = ("Euler", "RK4", "implicit", "implicitfast")
    integrator = int(model.opt.integrator)
    name = kinds[integrator] if integrator < len(kinds) else str(integrator)
    yield f"motions have the accuracy of data.solver, not of {name} at {model.opt.timestep:g} s"
    for i in np.flatnonzero(model.jnt_limited).tolist():
        if joint_kind(model, i) == "ball":
            yield f"the range of the ball joint {joint_name(model, i)} is ignored"
    if model.dof_frictionloss.any():
        yield "dry friction is smoothed around zero velocity (system.rest_velocity)"


def joint_kind(model: Any, i: int) -> str:
    """Return ``hinge``, ``slide``, ``ball`` or ``free``."""
    name: str = library().mjtJoint(int(model.jnt_type[i])).name
    return name.removeprefix("mjJNT_").lower()


def site_of(model: Any, actuator: int) -> int | None:
    """Return the site at which an actuator acts, ``None`` if it acts elsewhere."""
    at_site = model.actuator_trntype[actuator] == int(library().mjtTrn.mjTRN_SITE)
    return int(model.actuator_trnid[actuator, 0]) if at_site else None


def motors_of(model: Any, joint: int) -> list[int]:
    """Return the actuators that act on a joint."""
    at_joints = [k for k in range(model.nu) if site_of(model, k) is None]
    return [k for k in at_joints if model.actuator_trnid[k, 0] == joint]


def free_joint(model: Any, site: int) -> int | None:
    """Return the free joint of the body that a site is on, ``None`` if it has none."""
    body = model.body_weldid[model.site_bodyid[site]]
    joint = int(model.body_jntadr[body])
    return joint if joint >= 0 and joint_kind(model, joint) == "free" else None


def _touching(model: Any) -> int:
    """Count pairs of geoms that could touch, of bodies that move relative to each other."""
    if disabled(model, "CONTACT") or disabled(model, "CONSTRAINT"):
        return 0
    body = model.body_weldid[model.geom_bodyid]
    ours, other = model.geom_contype[:, None], model.geom_conaffinity[None]
    parent = model.body_weldid[model.body_parentid[body]]
    kin = (parent[:, None] == body[None]) & (parent[:, None] > 0)
    apart = (body[:, None] != body[None]) & ~kin & ~kin.T
    meets = ((ours & other) | (ours & other).T) > 0
    return int(np.triu(apart & meets, 1).sum()) + int(model.npair)


def controls(model: Any, i: int) -> np.ndarray:
    """Return the lowest and highest control of an actuator."""
    return np.array(model.actuator_ctrlrange[i] if model.actuator_ctrllimited[i] else (-1.0, 1.0))


def _range_of_force(model: Any, joint: int) -> np.ndarray:
    """Largest force of all actuators of a joint together."""
    gear = model.actuator_gear[:, 0] * model.actuator_gainprm[:, 0]
    each = [abs(gear[k]) * np.abs(controls(model, k)).max() for k in motors_of(model, joint)]
    return np.array([-sum(each), sum(each)])


def _within(inner: np.ndarray, outer: np.ndarray) -> bool:
    return bool(outer[0] <= inner.min() and inner.max() <= outer[1])


def joint_name(model: Any, i: int) -> str:
    """Return the name of a joint, by its number where it has none."""
    return str(model.joint(int(i)).name) or f"joint_{i}"


def actuator_name(model: Any, i: int) -> str:
    """Return the name of an actuator; without one that of its joint, if that says which it is.

    Else it is named by its number.
    """
    own = [str(model.actuator(k).name) for k in range(model.nu)]
    if own[i]:
        return own[i]
    joints = int(library().mjtTrn.mjTRN_JOINT)
    driven = [
        str(model.joint(int(target)).name) if int(kind) == joints else ""
        for kind, (target, _) in zip(model.actuator_trntype, model.actuator_trnid, strict=True)
    ]
    alone = driven.count(driven[i]) == 1 and driven[i] not in own
    return driven[i] if driven[i] and alone else f"motor_{i}"


def disabled(model: Any, name: str) -> bool:
    """Return whether a flag of the model switches a part of the physics off."""
    flag = getattr(library().mjtDisableBit, f"mjDSBL_{name}", 0)  # not every version has each
    return bool(int(model.opt.disableflags) & int(flag))
