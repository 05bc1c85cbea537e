"""What of a MuJoCo model this project cannot do, and what it does otherwise; a line each."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from symo_exp.errors import ConfigError
from symo_exp.shell import install_command
from symo_exp.systems import scene


def refusals(model: Any) -> Iterator[str]:
    """What this project cannot do, a line each."""
    mj = library()
    for i, kind in enumerate(map(mj.mjtJoint, model.jnt_type.tolist())):
        if kind not in (mj.mjtJoint.mjJNT_HINGE, mj.mjtJoint.mjJNT_SLIDE):
            word = kind.name.removeprefix("mjJNT_").lower()
            yield f"joint {joint_name(model, i)} is {word}; hinges and slides are what can be"
    if model.njnt == 0:
        yield "it has no joints, and nothing moves"
    if model.neq and model.eq_active0.any():
        yield f"{int(model.eq_active0.sum())} equality constraint(s); take them out of the model"
    for count, what in (
        ("ntendon", "tendon"), ("nflex", "flexible body"), ("nplugin", "plugin"),
        ("nplastic", "plastic spring"), ("ngravcomp", "body with gravity compensation"),
        ("nhistory", "delay"), ("na", "actuator with a state of its own"),
    ):  # fmt: skip
        if getattr(model, count, 0):
            yield f"{getattr(model, count)} {what}(s), which are not among what can be"
    for name in ("jnt_stiffnesspoly", "dof_dampingpoly"):
        if np.any(getattr(model, name, 0)):
            yield f"{name} is not zero: springs and dampers are to be linear"
    if model.opt.wind.any():
        yield "there is wind; the fluid is to be still"
    if model.geom_fluid[:, 0].any() and (model.opt.density or model.opt.viscosity):
        yield "fluidshape=ellipsoid; a fluid drags at boxes (fluidshape=none)"
    yield from _actuators(model, mj)


def _actuators(model: Any, mj: Any) -> Iterator[str]:
    if getattr(model, "nactuator", model.nu) != model.nu:
        yield "an actuator has several controls; one each is what can be"
    if model.nu and model.opt.disableactuator:
        yield "actuators are disabled by their group; take them out of the model"
    joint = (int(mj.mjtTrn.mjTRN_JOINT), int(mj.mjtTrn.mjTRN_JOINTINPARENT))
    for i in range(model.nu):
        name = f"actuator {actuator_name(model, i)}"
        if model.actuator_trntype[i] not in joint:
            yield f"{name} pulls at no joint; motors at joints are what can be"
        elif (model.actuator_gaintype[i], model.actuator_biastype[i]) != (0, 0):
            yield f"{name} is no motor, whose force is proportional to its control"
        strongest = abs(model.actuator_gainprm[i, 0]) * controls(model, i)
        if model.actuator_forcelimited[i] and not _within(strongest, model.actuator_forcerange[i]):
            yield f"{name} has a forcerange that its ctrlrange exceeds; narrow the ctrlrange"
    for j in np.flatnonzero(model.jnt_actfrclimited).tolist():
        strongest = _range_of_force(model, model.jnt_dofadr[j])
        if not _within(strongest, model.jnt_actfrcrange[j]):
            yield f"joint {joint_name(model, j)}: actuatorfrcrange is less than its motors give"


def notes(model: Any) -> Iterator[str]:
    """What is switched off or done otherwise, a line each."""
    pairs = _touching(model)
    if pairs:
        yield f"contacts are switched off ({pairs} pair(s) of geoms could touch)"
    kinds = ("Euler", "RK4", "implicit", "implicitfast")
    integrator = int(model.opt.integrator)
    name = kinds[integrator] if integrator < len(kinds) else str(integrator)
    yield f"motions are converged, not stepped by {name} at {model.opt.timestep:g} s"
    if model.dof_frictionloss.any():
        yield "dry friction is smoothed about standstill (system.rest_velocity)"


def _touching(model: Any) -> int:
    """Pairs of geoms that could touch: of bodies that move against each other."""
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
    """The controls that an actuator takes."""
    return np.array(model.actuator_ctrlrange[i] if model.actuator_ctrllimited[i] else (-1.0, 1.0))


def _range_of_force(model: Any, dof: int) -> np.ndarray:
    """The most that the actuators of a coordinate give together."""
    gear = model.actuator_gear[:, 0] * model.actuator_gainprm[:, 0]
    of = model.jnt_dofadr[model.actuator_trnid[:, 0]] == dof
    each = [abs(gear[k]) * np.abs(controls(model, k)).max() for k in np.flatnonzero(of).tolist()]
    return np.array([-sum(each), sum(each)])


def _within(inner: np.ndarray, outer: np.ndarray) -> bool:
    return bool(outer[0] <= inner.min() and inner.max() <= outer[1])


def joint_name(model: Any, i: int) -> str:
    """Its own, or one by its number."""
    return str(model.joint(int(i)).name) or f"joint_{i}"


def actuator_name(model: Any, i: int) -> str:
    """Its own, or one by its number."""
    return str(model.actuator(int(i)).name) or f"motor_{i}"


def disabled(model: Any, name: str) -> bool:
    """Whether a flag of the model switches this part of the physics off."""
    flag = getattr(library().mjtDisableBit, f"mjDSBL_{name}", 0)  # not every version has each
    return bool(int(model.opt.disableflags) & int(flag))


def library() -> Any:
    """MuJoCo, if it is installed."""
    scene.prepare()
    try:
        import mujoco
    except ImportError as error:
        raise ConfigError(
            f"MuJoCo models need mujoco, which is not installed: {install_command('mujoco')}"
        ) from error
    return mujoco


@contextmanager
def heard() -> Iterator[list[str]]:
    """MuJoCo's warnings, a line each, which it would write to a file in the working folder."""
    lines: list[str] = []
    library().set_mju_user_warning(lambda text: lines.append(one_line(text)))
    try:
        yield lines
    finally:
        library().set_mju_user_warning(None)


def one_line(text: object) -> str:
    """What was said, without its line ends."""
    return " ".join(str(text).split())[:300]
