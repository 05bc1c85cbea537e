"""MuJoCo's system identification: a model file of links in a plane, by least squares on rollouts.

The file has a hinge for each link, with the makers' lengths, and starts from the makers' masses,
centres of mass, inertias and friction. Fitted are mass, centre, inertia and damping of every link,
with motors also armature, and dry friction (``frictionloss``) or not, on windows of the training
recordings that begin in measured states.
"""

import contextlib
import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import mujoco
import mujoco.rollout
import numpy as np
import torch
import yaml
from absl import logging
from machines import TIME_STEP, Machine
from mujoco import sysid
from torch import Tensor

from symo_exp.mechanics.types import Trajectories
from symo_exp.models.starts import RollsOut

NAME, GIVEN = "MuJoCo's sysid", "links in a plane, the makers' lengths and start; velocities"
SUBSTEPS, ITERATIONS = 4, 15
ARMATURE = 1e-4
"""Start of an armature [kg m²] where the makers give no rotor."""
logging.set_verbosity(logging.ERROR)  # measured are joints, not sensors, of which there are none


@dataclass(frozen=True)
class Links:
    """The makers' numbers of each link."""

    gravity: float
    mass: list[float]
    centre: list[float]
    inertia: list[float]
    """About the centre of mass [kg m²]."""
    length: list[float]
    viscous: list[float]
    dry: list[float]
    armature: list[float]

    @classmethod
    def of(cls, name: str) -> "Links":
        with open(f"conf/reference/{name}.yaml") as file:
            given = yaml.safe_load(file)
        gravity = given["gravity"]
        if name.startswith("free"):
            none = [0.0] * len(given["mass"])
            return cls(
                gravity, given["mass"], given["centre"], given["inertia"], given["length"],
                given["friction"], none, none,
            )  # fmt: skip
        if "moment" in given:  # mass and centre are known as their product; 0.5 m is the rod
            mass, centre = given["moment"] / 0.5, 0.5
            own = max(given["inertia"] - mass * centre**2, 0.1 * given["inertia"])
            dry = given["dry"] * np.pi / 2  # of c atan(100 v) at high speed
            return cls(gravity, [mass], [centre], [own], [], [given["viscous"]], [dry], [ARMATURE])
        own = [
            max(i - m * c**2, 0.1 * i)
            for i, m, c in zip(given["inertia"], given["mass"], given["centre"], strict=True)
        ]
        dry = [np.pi / 2 * x for x in given["dry"]]
        rotors = [given["gear"] ** 2 * given["rotor"]] * len(given["mass"])
        return cls(
            gravity, given["mass"], given["centre"], own, [given["length"]], given["viscous"],
            dry, rotors,
        )  # fmt: skip

    def spec(self, integrator: str, motors: bool) -> mujoco.MjSpec:
        n = len(self.mass)
        bodies = ""
        for i in reversed(range(n)):
            place = -self.length[i - 1] if i else 0.0
            bodies = (
                f'<body name="link{i}" pos="0 0 {place}"><joint name="joint{i}" type="hinge" '
                f'axis="0 -1 0" damping="{self.viscous[i]}" frictionloss="{self.dry[i]}" '
                f'armature="{self.armature[i]}"/><inertial pos="0 0 {-self.centre[i]}" '
                f'mass="{self.mass[i]}" diaginertia="{self.inertia[i]} {self.inertia[i]} '
                f'{self.inertia[i]}"/>{bodies}</body>'
            )
        drives = "".join(f'<motor name="motor{i}" joint="joint{i}"/>' for i in range(n))
        return mujoco.MjSpec.from_string(
            f'<mujoco><compiler angle="radian"/><option timestep="{TIME_STEP / SUBSTEPS}" '
            f'integrator="{integrator}" gravity="0 0 {-self.gravity}"/>'
            f"<worldbody>{bodies}</worldbody>"
            f"{f'<actuator>{drives}</actuator>' if motors else ''}</mujoco>"
        )

    def parameters(self, *, dry: bool, motors: bool) -> sysid.ParameterDict:
        """Return the parameters that are fitted, in ranges about the start."""
        found = sysid.ParameterDict()
        for i, (m, c, own) in enumerate(zip(self.mass, self.centre, self.inertia, strict=True)):
            viscous, still = self.viscous[i], max(self.dry[i], 1e-5)
            rows: list[tuple[str, Any, Any, Any]] = [
                ("mass", m, m / 4, 4 * m),
                ("centre", [c, 0.0], [c / 4, -c], [4 * c, c]),
                ("inertia", own, own / 20, 20 * own),
                ("damping", max(viscous, 1e-6), 0.0, 50 * max(viscous, 1e-4)),
            ]
            if motors:
                rows.append(("armature", max(self.armature[i], ARMATURE), 0.0, own + m * c**2))
            if dry:
                rows.append(("frictionloss", still, 0.0, 20 * still))
            for key, start, low, high in rows:
                put = partial(placed, link=i, key=key)
                found.add(sysid.Parameter(f"{key}{i}", start, low, high, modifier=put))
        return found


def placed(spec: mujoco.MjSpec, p: sysid.Parameter, *, link: int, key: str) -> None:
    """Put a value into the model file."""
    body, joint, value = spec.body(f"link{link}"), spec.joint(f"joint{link}"), float(p.value[0])
    if key == "centre":  # along the link and across
        body.ipos = [p.value[1], 0.0, -value]
    elif key in ("mass", "inertia"):
        setattr(body, key, [value] * 3 if key == "inertia" else value)
    else:
        many = np.ndim(getattr(joint, key)) > 0
        setattr(joint, key, [value, 0.0, 0.0] if many else value)


@dataclass
class Chain:
    """A model file that rolls out, in the angles of the recordings."""

    model: mujoco.MjModel
    absolute: bool
    time_step = TIME_STEP

    def rollout(self, q0: Tensor, v0: Tensor, u: Tensor) -> Trajectories:
        n, steps = q0.shape[1], u.shape[1] - 1
        start = np.zeros((len(q0), 1 + 2 * n))
        start[:, 1:] = torch.cat([relative(x, self.absolute) for x in (q0, v0)], dim=1).numpy()
        part = np.arange(SUBSTEPS * steps) / SUBSTEPS
        k, rest = part.astype(int), (part % 1.0)[:, None]
        inputs = u.numpy()
        held = (1.0 - rest) * inputs[:, k] + rest * inputs[:, k + 1]
        control = held if self.model.nu else None
        data = mujoco.MjData(self.model)
        state, _ = mujoco.rollout.rollout(self.model, data, start, control, nstep=SUBSTEPS * steps)
        found = torch.from_numpy(state[:, SUBSTEPS - 1 :: SUBSTEPS, 1:])
        q, v = found.split(n, dim=2)
        if self.absolute:
            q, v = q.cumsum(2), v.cumsum(2)
        joined = (torch.cat((a[:, None], b), dim=1) for a, b in ((q0, q), (v0, v)))
        return Trajectories(*joined, u)


def relative(x: Tensor, absolute: bool) -> Tensor:
    """Angles from link to link, of those that are counted from the vertical."""
    return torch.cat((x[..., :1], x.diff(dim=-1)), dim=-1) if absolute else x


def fitted(machine: Machine, *, seconds: float, integrator: str, dry: bool) -> Chain:
    absolute, links = machine.name.startswith("free"), Links.of(machine.name)
    spec = links.spec(integrator, machine.driven)
    model, steps = spec.compile(), round(seconds / TIME_STEP)
    times = TIME_STEP * np.arange(steps + 1)
    joints = [(f"joint{i}", sysid.SignalType.MjStateQPos) for i in range(machine.n)]
    names, starts, controls, measured = [], [], [], []
    for t in machine.train:
        q, v = (relative(x, absolute).numpy() for x in (t.q, t.v))
        for k in range(0, len(q) - steps, steps):
            rows = slice(k, k + steps + 1)
            names.append(str(len(names)))
            starts.append(sysid.create_initial_state(model, q[k], v[k]))
            controls.append(sysid.TimeSeries(times, t.u[rows].numpy()[:, : model.nu]))
            measured.append(sysid.TimeSeries.from_names(times, q[rows], model, joints))
    windows = sysid.ModelSequences(
        machine.name, spec, names, starts, controls, measured, allow_missing_sensors=True
    )
    residual = sysid.build_residual_fn(models_sequences=[windows], n_threads=1)
    start = links.parameters(dry=dry, motors=machine.driven).move_off_bounds(fraction=1e-3)
    with contextlib.redirect_stdout(None):
        found, _ = sysid.optimize(
            start, residual, verbose=False, max_iters=ITERATIONS, x_scale="jac"
        )
    return Chain(
        sysid.apply_param_modifiers(found, links.spec(integrator, machine.driven)), absolute
    )


def candidates(machine: Machine) -> Iterator[tuple[str, Callable[[], RollsOut]]]:
    longest = TIME_STEP * (max(len(t.q) for t in machine.train) - 1)
    lengths = [seconds for seconds in (1.0, 0.5, 2.0) if seconds < longest]
    for integrator, seconds, dry in itertools.product(
        ("RK4", "implicitfast"), lengths, (machine.driven, not machine.driven)
    ):
        friction = "dry friction fitted" if dry else "dry friction as given"
        words = f"windows of {seconds:g} s, {friction}, {integrator}"
        settings = {"seconds": seconds, "integrator": integrator, "dry": dry}
        yield words, lambda settings=settings: fitted(machine, **settings)
