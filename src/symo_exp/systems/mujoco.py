"""Mechanisms read from MuJoCo models: MJCF and URDF files and Gymnasium environments.

A free joint becomes three slides along the axes of the world and a ball joint.

A mechanism is what ``Multibody`` takes. Features of a model that it does not have are refused, or
switched off with a note; the result is checked against MuJoCo's own accelerations and mass matrix.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
import torch

from symo_exp.errors import ConfigError, shortened
from symo_exp.mechanics.bodies import Joint, joint_order
from symo_exp.systems.mujoco_library import (
    environment_model,
    library,
    load_model,
    model_file,
    warnings_heard,
)
from symo_exp.systems.multibody import Multibody
from symo_exp.systems.refusals import (
    FREEDOMS,
    actuator_name,
    controls,
    disabled,
    free_joint,
    joint_kind,
    joint_name,
    motors_of,
    notes,
    refusals,
    site_of,
)

AGREEMENT = 1e-8
"""Largest difference from MuJoCo's accelerations and mass matrix, relative to their size."""
SMALL = 1e-3
"""Least size that differences are related to [SI]."""
ENDLESS = 1e6
"""Bound of a range beyond which it stands for none [rad, m]: a slide of a URDF has to have one."""
TINY = 1e-15
"""Mass up to which MuJoCo ignores a body [kg]."""


def read_mechanism(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Return the mechanism of an MJCF or URDF file.

    Raises:
        ConfigError: If there is no such file or it has features that are not supported.
    """
    file = model_file(path)
    if not file.is_file():
        raise ConfigError(f"system.model={path}: there is no such file; give an MJCF or URDF file")
    return _read(str(path), str(file.resolve()), file.stat().st_mtime_ns)


@lru_cache(maxsize=4)  # the jobs of a sweep share it
def _read(path: str, file: str, version: int) -> dict[str, Any]:
    return _loaded(f"system.model={path}", lambda: load_model(file), "MuJoCo cannot read it")


@lru_cache(maxsize=4)
def environment_mechanism(name: str) -> dict[str, Any]:
    """Return the mechanism of a Gymnasium environment with a MuJoCo model.

    Raises:
        ConfigError: If there is no such environment or it has features that are not supported.
    """
    where = f"system.id={name}"
    return _loaded(where, lambda: environment_model(name), "Gymnasium cannot make it")


def _loaded(where: str, load: Callable[[], Any], failed: str) -> dict[str, Any]:
    """Return the mechanism of a model, MuJoCo's warnings among its notes."""
    with warnings_heard() as warnings:
        try:
            model = load()
        except Exception as error:  # whatever a parser says; an environment is anybody's code
            raise ConfigError(f"{where}: {failed}: {shortened(error)}") from None
        if not isinstance(model, library().MjModel):
            raise ConfigError(
                f"{where} is not an environment with a MuJoCo model; give one, such as Swimmer-v5"
            )
        found = of_model(model, where)
    return found | {"notes": [*found["notes"], *dict.fromkeys(warnings)]}


def of_model(model: Any, where: str) -> dict[str, Any]:
    """Return the mechanism of a compiled model; ``where`` begins error messages about it."""
    for reason in refusals(model):
        raise ConfigError(f"{where}: {reason}")
    found = _taken_apart(model) | {"notes": list(notes(model))}
    _agrees(model, found, where)
    return found


def _taken_apart(model: Any) -> dict[str, Any]:
    """Joints and what they carry, where every coordinate has its reference value."""
    mj = library()
    data = mj.MjData(model)
    data.qpos[:] = model.qpos0
    mj.mj_kinematics(model, data)
    mj.mj_comPos(model, data)
    weld = model.body_weldid  # of bodies that move as one, the first, which has the joints
    count = model.body_jntnum[weld]
    last = np.where(count > 0, model.body_jntadr[weld] + count - 1, -1).tolist()
    joints: list[dict[str, Any]] = []
    free: list[list[int]] = []
    ends = [-1] * (model.njnt + 1)  # the place of each joint among ours; −1 of none
    for i in range(model.njnt):
        body, found = model.jnt_bodyid[i], _joints(model, data, i)
        before = i - 1 if i > model.body_jntadr[body] else last[model.body_parentid[body]]
        for k, joint in enumerate(found):
            joints.append({**joint, "parent": len(joints) - 1 if k else ends[before]})
        ends[i] = len(joints) - 1
        joints[-1] |= _carried(model, data, [b for b in range(1, model.nbody) if last[b] == i])
        if len(found) > 1:
            free.append([len(joints) - len(found), len(joints) - 1])
    matrix = np.zeros((model.nv, model.nu))
    for k in range(model.nu):
        matrix[:, k] = _effect(model, data, k)
    order = joint_order([Joint(**joint) for joint in joints])
    found_gravity = [0.0] * 3 if disabled(model, "GRAVITY") else model.opt.gravity.tolist()
    return {
        "gravity": found_gravity,
        "joints": joints,
        **({"free": free} if free else {}),
        "inputs": {
            "names": [actuator_name(model, k) for k in range(model.nu)],
            "matrix": matrix[order].tolist(),
            "ranges": [controls(model, k).tolist() for k in range(model.nu)],
        },
        "fluid": _fluid(model, data, [ends[i] for i in last]),
    }


def _joints(model: Any, data: Any, i: int) -> list[dict[str, Any]]:
    """Return a joint of the model; a free one as three slides and a ball joint."""
    kind, name = joint_kind(model, i), joint_name(model, i)
    off = [disabled(model, part) for part in ("PASSIVE", "SPRING", "DAMPER")]
    spring, damper = not (off[0] or off[1]), not (off[0] or off[2])
    body, dof, place = model.jnt_bodyid[i], model.jnt_dofadr[i], model.jnt_qposadr[i]
    shared = {
        **_carried(model, data, []),
        "armature": float(model.dof_armature[dof]),
        "damping": float(model.dof_damping[dof]) * damper,
        "friction": float(model.dof_frictionloss[dof]),
    }
    axes = data.xmat[body].reshape(3, 3).tolist()
    ball = {"slides": False, "axis": [0.0, 0.0, 1.0], "reference": 0.0, "axes": axes}
    if kind == "ball":
        anchor = data.xanchor[i].tolist()
        return [shared | ball | {"name": name, "anchor": anchor, "base": axes}]
    if kind == "free":
        one, at = np.eye(3).tolist(), data.xpos[body].tolist()
        slides = [
            shared | {
                "name": f"{name}_{'xyz'[k]}", "slides": True, "axis": one[k], "anchor": at,
                "reference": float(model.qpos0[place + k]),
            } for k in range(3)
        ]  # fmt: skip
        return [*slides, shared | ball | {"name": f"{name}_R", "anchor": at, "base": one}]
    own = float(model.jnt_stiffness[i]) * spring
    push, stiffness, damping = _servos(model, i)
    pull = own * float(model.qpos_spring[place]) + push
    return [
        shared
        | {
            "name": name,
            "slides": kind == "slide",
            "axis": data.xaxis[i].tolist(),
            "anchor": data.xanchor[i].tolist(),
            "reference": float(model.qpos0[place]),
            "stiffness": own + stiffness,
            "rest": pull / (own + stiffness) if own + stiffness else 0.0,
            "damping": shared["damping"] + damping,
            "limits": _limits(model, i),
        }
    ]


def _limits(model: Any, joint: int) -> list[float] | None:
    bounds = model.jnt_range[joint]
    limited = model.jnt_limited[joint] and np.abs(bounds).max() < ENDLESS
    return bounds.tolist() if limited else None


def _servos(model: Any, joint: int) -> tuple[float, float, float]:
    """Return ``f``, ``k`` and ``d`` of the force ``f − k q − d q̇`` of servos without a control."""
    found = np.zeros(3)
    for k in motors_of(model, joint):
        if model.actuator_biastype[k]:
            gear = model.actuator_gear[k, 0]
            found += model.actuator_biasprm[k, :3] * (gear, -(gear**2), -(gear**2))
    force, stiffness, damping = found.tolist()
    return force, stiffness, damping


def _effect(model: Any, data: Any, k: int) -> np.ndarray:
    """Return the generalised force of an actuator, that on a free body in axes of the body."""
    force, gear = np.zeros(model.nv), model.actuator_gear[k] * model.actuator_gainprm[k, 0]
    if (site := site_of(model, k)) is None:
        joint = model.actuator_trnid[k, 0]
        dof, count = model.jnt_dofadr[joint], FREEDOMS[joint_kind(model, joint)]
        force[dof : dof + count] = gear[:count]
        return force
    joint = free_joint(model, site)
    dof, body = model.jnt_dofadr[joint], model.jnt_bodyid[joint]
    axes = data.xmat[body].reshape(3, 3)
    turn = axes.T @ data.site_xmat[site].reshape(3, 3)
    arm = axes.T @ (data.site_xpos[site] - data.xpos[body])
    push = turn @ gear[:3]
    force[dof : dof + 6] = *push, *(turn @ gear[3:] + np.cross(arm, push))
    return force


def _fluid(model: Any, data: Any, last: list[int]) -> dict[str, Any] | None:
    """Boxes with the bodies' masses and inertias, as in MuJoCo's fluid model."""
    if not (model.opt.density or model.opt.viscosity):
        return None
    hulls = []
    for body in range(1, model.nbody):
        if last[body] >= 0 and model.body_mass[body] > TINY:
            inertia, mass = model.body_inertia[body], model.body_mass[body]
            squares = np.maximum(inertia.sum() - 2 * inertia, TINY) / mass * 6
            axes = data.ximat[body].reshape(3, 3)
            hulls.append({
                "joint": last[body], "centre": data.xipos[body].tolist(),
                "axes": axes.tolist(), "sides": np.sqrt(squares).tolist(),
            })  # fmt: skip
    return {
        "density": float(model.opt.density), "viscosity": float(model.opt.viscosity),
        "hulls": hulls,
    }  # fmt: skip


def _carried(model: Any, data: Any, bodies: list[int]) -> dict[str, Any]:
    """Mass, centre and inertia about it of bodies that move as one."""
    masses, centres = model.body_mass[bodies], data.xipos[bodies]
    mass = float(masses.sum())
    centre = masses @ centres / mass if mass > 0 else np.zeros(3)
    inertia = np.zeros((3, 3))
    for body, m, c in zip(bodies, masses, centres - centre, strict=True):
        axes = data.ximat[body].reshape(3, 3)
        inertia += axes * model.body_inertia[body] @ axes.T
        inertia += m * (c @ c * np.eye(3) - np.outer(c, c))
    return {"mass": mass, "centre": centre.tolist(), "inertia": inertia.tolist()}


def _agrees(model: Any, found: dict[str, Any], where: str) -> None:
    """Refuse a model that moves differently from what was read."""
    smooth = Multibody(mechanism=found, time_step=1.0, coulomb=(0.0,) * model.nv)
    q, v, u = smooth.points(8, seed=0)
    mass, rate = mujoco_dynamics(model, smooth, q, v, u)
    for name, ours, expected in (
        ("mass matrix", smooth.mass_matrix(q), mass),
        ("accelerations", smooth.acceleration(q, v, u), rate),
    ):
        size = max(float(expected.abs().max()), SMALL)
        error = float((ours - expected).abs().max()) / size
        if not error < AGREEMENT:
            raise ConfigError(
                f"{where}: MuJoCo's {name} differ by {error:.1g} of their size from those of "
                "rigid bodies on joints; the model has a feature that is not supported"
            )


def mujoco_dynamics(
    model: Any, system: Multibody, q: torch.Tensor, v: torch.Tensor, u: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return MuJoCo's own mass matrices (batch, n, n) and smooth accelerations (batch, n).

    States and results are those of the coordinates of the system.
    """
    mj = library()
    data, n, order = mj.MjData(model), model.nv, system.model_order
    masses, rates = np.zeros((len(q), n, n)), np.zeros((len(q), n))
    states = (x.numpy() for x in (*system.model_state(q, v), u))
    for k, state in enumerate(zip(*states, strict=True)):
        data.qpos[:], data.qvel[:], data.ctrl[:] = state
        mj.mj_forward(model, data)
        rates[k] = data.qacc_smooth
        for i, unit in enumerate(np.eye(n)):
            mj.mj_mulM(model, data, masses[k, i], unit)
    return torch.from_numpy(masses[:, order][:, :, order]), torch.from_numpy(rates[:, order])
