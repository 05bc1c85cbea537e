"""Trees of rigid bodies on hinges, slides and ball joints."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, final

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional
from typing_extensions import Self, override

from symo_exp.checks import one_of
from symo_exp.mechanics.bodies import (
    Drag,
    Hull,
    Joint,
    Poses,
    Tree,
    column,
    freedoms,
    joint_order,
    of_pseudo_inertia,
    pseudo_inertia,
    vector,
)
from symo_exp.mechanics.composites import BodiesExpansion, Composites
from symo_exp.mechanics.dissipation import Dissipation
from symo_exp.mechanics.lagrangian import Expansion, Gradients, Rates, matvec
from symo_exp.mechanics.space import quaternion
from symo_exp.mechanics.types import Constant, Coordinates
from symo_exp.systems.base import VIEW, LagrangianSystem, Linkage, Skeleton
from symo_exp.systems.box import Range, SamplingBox, completed
from symo_exp.systems.complex_step import STEP
from symo_exp.systems.mujoco_library import scene


@final
@dataclass(frozen=True, kw_only=True)
class Multibody(LagrangianSystem):
    """Any tree of joints, ``T = ½ Σ_b (m_b |ċ_b|² + ω_bᵀ I_b ω_b) + ½ Σ_i a_i v_i²``.

    With Jacobians ``J_b`` of a body's centre and ``W_b`` of its turning, and armature ``a``::

        H = Σ_b (m_b J_bᵀ J_b + W_bᵀ I_b W_b) + diag(a)
        V = −Σ_b m_b g · c_b + ½ Σ_i k_i (q_i − r_i)²

    ``mechanism`` describes it: ``joints`` (fields of ``Joint``), ``gravity``, ``inputs`` (names,
    ``matrix`` and ``ranges``) and a ``fluid`` with its ``hulls``; ``symo_exp.systems.mujoco`` reads
    one from a model. Its rows of the ``matrix`` are in the order of the coordinates, lengths and
    angles before ball joints. Those of ``free`` bodies, pairs of the first of three slides and a
    ball joint, are forces in body axes. ``viscous`` and ``coulomb`` are the joints' own unless
    given. So are missing parts of the ``box``: the ranges of the joints (half a turn [rad] or half
    a metre about the reference without a range), and speeds and inputs within ±1. Motions
    ``end`` at joint limits, or ``limits`` are ``off``. ``model`` (a file) or ``id`` (an
    environment's) is where the mechanism was found.
    """

    mechanism: Mapping[str, Any]
    model: str | None = None
    id: str | None = None
    limits: str = "end"
    box: Any = None

    def __post_init__(self) -> None:
        one_of("system.limits", self.limits, ("end", "off"))
        vars(self)["mechanism"] = _plain(self.mechanism)
        own = SamplingBox(
            q=tuple(joint.limits or _about(joint) for joint in self._movers),
            v=((-1.0, 1.0),) * len(self._movers),
            u=tuple(map(tuple, self.mechanism["inputs"]["ranges"])),
        )
        vars(self)["box"] = completed(self.box, own)
        for name, own_name in ("viscous", "damping"), ("coulomb", "friction"):
            if getattr(self, name) is None:
                vars(self)[name] = tuple(getattr(joint, own_name) for joint in self._movers)
        super().__post_init__()

    @cached_property
    def joints(self) -> tuple[Joint, ...]:
        """The joints, parents first."""
        return tuple(Joint(**joint) for joint in self.mechanism["joints"])

    @cached_property
    def _movers(self) -> tuple[Joint, ...]:
        """The joint of each degree of freedom."""
        return tuple(self.joints[i] for i, _ in freedoms(self.joints))

    @cached_property
    @override
    def coordinates(self) -> Coordinates:
        flat = self._flat
        balls = [i for i, joint in enumerate(self.joints) if joint.axes is not None]
        names, turns = ([self.joints[i].name for i in some] for some in (flat, balls))
        free = [(flat.index(i), balls.index(k)) for i, k in self.mechanism.get("free", ())]
        return Coordinates.of(names, [not self.joints[i].slides for i in flat], turns, free)

    @property
    @override
    def inputs(self) -> Sequence[str]:
        return tuple(self.mechanism["inputs"]["names"])

    @cached_property
    @override
    def input_matrix(self) -> Tensor:
        rows = self.mechanism["inputs"]["matrix"]
        return torch.tensor(rows, dtype=torch.float64).reshape(self.coordinates.n, -1)

    @property
    @override
    def notes(self) -> Sequence[str]:
        return tuple(self.mechanism.get("notes", ()))

    @property
    @override
    def ends(self) -> tuple[Range, ...] | None:
        flat = [self.joints[i] for i in self._flat]
        if self.limits == "off" or not any(joint.limits for joint in flat):
            return None
        free = (-math.inf, math.inf)
        entries = (free,) * (self.coordinates.width - len(flat))
        return (*(joint.limits or free for joint in flat), *entries)

    @cached_property
    def _tree(self) -> Tree:
        return Tree(self.joints)

    @cached_property
    def _numbers(self) -> tuple[Tensor, ...]:
        names = ("mass", "centre", "inertia", "armature", "stiffness", "rest")
        gravity = torch.tensor(self.mechanism["gravity"], dtype=torch.float64)
        return (*(column(self.joints, name) for name in names), gravity)

    @property
    @override
    def linkage(self) -> Linkage:
        names = ("mass", "centre", "inertia", "armature", "stiffness")
        *numbers, _, gravity = self._numbers
        rows = zip(*(x.tolist() for x in numbers), strict=True)
        joints = tuple(
            joint._replace(**dict(zip(names, row, strict=True)))
            for joint, row in zip(self.joints, rows, strict=True)
        )
        free = [(int(i), int(k)) for i, k in self.mechanism.get("free", ())]
        return Linkage(joints, vector(gravity), torch.eye(self.coordinates.n).double(), free)

    @property
    def constants(self) -> Mapping[str, Constant]:
        """Bodies with a mass, and armature and stiffness where they are not zero.

        A body is given by its pseudo-inertia in the axes of the world at the reference.
        """
        mass, centre, inertia, armature, stiffness, *_ = self._numbers
        found = {}
        for i, joint in enumerate(self.joints):
            length = "" if joint.slides else " m^2"
            if joint.mass > 0.0:
                lever = centre[i] - torch.tensor(joint.anchor, dtype=torch.float64)
                body = pseudo_inertia(mass[i], centre[i], inertia[i], float(lever.norm()))
                found[f"{joint.name}.body"] = Constant(body, "kg", joint.anchor)
            if joint.armature > 0.0:
                found[f"{joint.name}.armature"] = Constant(armature[i], f"kg{length}")
            if joint.stiffness > 0.0:
                unit = "N/m" if joint.slides else "N m/rad"
                found[f"{joint.name}.stiffness"] = Constant(stiffness[i], unit)
        return found

    @override
    def with_constants(self, values: Mapping[str, Tensor]) -> Self:
        twin = super().with_constants({})
        rows = []
        for joint, *own in zip(self.joints, *self._numbers[:5], strict=True):
            if (body := values.get(f"{joint.name}.body")) is not None:
                own[:3] = of_pseudo_inertia(body)
            own[3] = values.get(f"{joint.name}.armature", own[3])
            own[4] = values.get(f"{joint.name}.stiffness", own[4])
            rows.append(own)
        numbers = *map(torch.stack, zip(*rows, strict=True)), *self._numbers[5:]
        kept = {name: getattr(self, name) for name in ("_tree", "joints", "coordinates", "_flat")}
        vars(twin).update(kept, _numbers=numbers)
        return twin

    @override
    def mass_matrix(self, q: Float[Tensor, "batch N"]) -> Float[Tensor, "batch n n"]:
        return self._mass_matrix(self._jacobians(self._tree.poses(q)))

    @override
    def potential(self, q: Float[Tensor, "batch N"]) -> Float[Tensor, " batch"]:
        return self._potential(q, self._tree.poses(q))

    @override
    def terms(self, q: Tensor) -> tuple[Tensor, Tensor]:
        at = self._tree.poses(q)
        return self._mass_matrix(self._jacobians(at)), self._potential(q, at)

    @property
    @override
    def closed_form(self) -> bool:
        return not self.space.rotations

    @override
    def gradients(self, q: Float[Tensor, "batch N"], v: Float[Tensor, "batch n"]) -> Gradients:
        if not self.closed_form:
            return super().gradients(q, v)
        at = self._composites(q)
        found = at.gradients(v, at.motion(v))
        return found._replace(q=found.q + self._spring_force(q))

    @override
    @torch.no_grad()
    def expand(self, q: Float[Tensor, "batch N"], v: Float[Tensor, "batch n"]) -> Expansion:
        if not self.closed_form:
            return super().expand(q, v)
        at = self._composites(q)
        springs = None
        if any(joint.stiffness for joint in self.joints):  # not its value, which a trace lacks
            springs = self._spring_force(q), self._numbers[4].to(q).expand_as(v)
        return BodiesExpansion(self, at, at.motion(v), v, springs)

    @override
    def rates(self, q: Float[Tensor, "batch N"], v: Float[Tensor, "batch n"]) -> Rates:
        """Return the terms of the equations of motion.

        With ball joints they are found by one complex step, along ``v``. For the columns ``J_i``
        and ``W_i`` of the Jacobians of a body, and its body rates ω::

            ∂ċ/∂q_i = d/dt J_i + J (e_i × v),    ∂ω/∂q_i = d/dt W_i + ω × W_i + W (e_i × v)

        with ``e_i × v`` among the rates of the same ball joint. The complex step of any system
        takes n + 1 directions instead.
        """
        if self.closed_form:
            at = self._composites(q)
            motion = at.motion(v)
            dq = at.gradients(v, motion).q + self._spring_force(q)
            return Rates(at.mass(), at.mass_rate(v, motion), dq)
        if torch.is_grad_enabled() and (q.requires_grad or v.requires_grad):
            return super().rates(q, v)
        mass, _, inertia, *_, gravity = (x.to(q) for x in self._numbers)
        along_v = torch.complex(q, STEP * self.space.push(q, v))
        moving = self._jacobians(self._tree.poses(along_v))
        columns, rate = moving.real.contiguous(), moving.imag / STEP
        matrix = self._mass_matrix(columns)
        (c, w), (c_bias, w_bias) = (
            (v[:, None, None] @ x).squeeze(2).split(3, -1) for x in (columns, rate)
        )
        linear, spin = mass[:, None] * c, matvec(inertia, w)
        pushed = _onto(rate, linear, spin)
        moment = torch.linalg.cross(spin, w)
        dq = pushed + _onto(columns, (mass[:, None] * gravity).expand_as(c), moment)
        dq = dq + self.space.coadjoint(v, matvec(matrix, v))
        dq = dq + functional.pad(self._spring_force(q), (0, v.shape[1] - len(self._flat)))
        bias = _onto(columns, mass[:, None] * c_bias, matvec(inertia, w_bias))
        return Rates(matrix, pushed + bias, dq)

    @cached_property
    def _pseudo_inertias(self) -> Float[Tensor, "bodies 4 4"]:
        """The pseudo-inertias of the bodies about the origin, at the reference."""
        mass, centre, inertia, *_ = self._numbers
        trace = inertia.diagonal(dim1=1, dim2=2).sum(1)[:, None, None]
        moment = mass[:, None] * centre
        second = 0.5 * trace * torch.eye(3).to(inertia) - inertia
        second = second + moment[:, :, None] * centre[:, None]
        edge = torch.cat((moment, mass[:, None]), dim=1)[:, None]
        return torch.cat((torch.cat((second, moment[:, :, None]), dim=2), edge), dim=1)

    def _composites(self, q: Float[Tensor, "batch n"]) -> Composites:
        """Return the bodies at a configuration, where there are no ball joints."""
        at, bodies = self._tree.poses(q), self._pseudo_inertias.to(q)
        armature, gravity = (self._numbers[k].to(q).expand(q.shape[0], -1) for k in (3, 6))
        pose = torch.cat((at.turn, at.shift.unsqueeze(-1)), dim=-1)
        last = torch.eye(4).to(q)[3:].expand(q.shape[0], len(bodies), 1, 4)
        pose = torch.cat((pose, last), dim=-2)
        placed = pose @ bodies @ pose.mT
        return Composites(self._tree.branches, self._tree.twists(at), placed, armature, gravity)

    def _spring_force(self, q: Float[Tensor, "batch N"]) -> Float[Tensor, "batch flat"]:
        """Return the forces of the springs of lengths and angles."""
        stiffness, rest = (x.to(q)[self._flat] for x in self._numbers[4:6])
        return -stiffness * (q[:, : len(self._flat)] - rest)

    def _jacobians(self, at: Poses) -> Float[Tensor, "batch bodies n 6"]:
        """Return ``∂ċ/∂v`` of the centres in world axes and ``∂ω/∂v`` in body axes."""
        centre = self._numbers[1].to(at.shift)
        return torch.cat(self._tree.jacobians(at, range(len(self.joints)), centre), -1)

    def _mass_matrix(self, jacobians: Float[Tensor, "batch bodies n 6"]) -> Tensor:
        mass, _, inertia, armature = (x.to(jacobians) for x in self._numbers[:4])
        linear, turning = jacobians.split(3, -1)
        weighted = torch.cat([mass[:, None, None] * linear, turning @ inertia], -1)
        found = torch.einsum("bjik,bjlk->bil", jacobians, weighted)
        owners = [i for i, _ in freedoms(self.joints)]
        return 0.5 * (found + found.mT) + torch.diag(armature[owners])

    def _potential(self, q: Tensor, at: Poses) -> Tensor:
        mass, centre, _, _, stiffness, rest, gravity = (x.to(q) for x in self._numbers)
        flat = self._flat
        springs = 0.5 * (stiffness[flat] * (q[:, : len(flat)] - rest[flat]) ** 2).sum(-1)
        return springs - (mass * (at.of(centre) @ gravity)).sum(-1)

    @cached_property
    def _flat(self) -> list[int]:
        """The joints of lengths and angles, in the order of the coordinates."""
        return [i for i, k in freedoms(self.joints) if k is None]

    @cached_property
    def dissipation(self) -> Dissipation | None:
        """Friction of the joints, and the drag of a fluid."""
        friction, fluid = super().dissipation, self.mechanism.get("fluid")
        if fluid is None:
            return friction
        hulls = [Hull(**hull) for hull in fluid["hulls"]]
        return Drag(self._tree, hulls, fluid["density"], fluid["viscosity"], friction)

    def skeleton(self, q: Float[Tensor, " N"]) -> Skeleton:
        """Return the joints and the far ends of the last bodies, seen along the first hinge.

        Bodies on ball joints are seen from a little above, and have their axes.
        """
        joints, view = self.joints, self._view
        hidden = {i for slide, ball in self.mechanism.get("free", ()) for i in range(slide, ball)}
        seen = [i for i in range(len(joints)) if i not in hidden]
        ends = [i for i in seen if i not in {joint.parent for joint in joints}]
        anchors, centres = column(joints, "anchor"), column(joints, "centre")
        places = torch.cat((anchors[seen], (2 * centres - anchors)[ends]))
        of = [*seen, *ends]
        links = [
            (seen.index(joints[i].parent), k)
            for k, i in enumerate(seen)
            if joints[i].parent in seen
        ]
        links += [(seen.index(i), len(seen) + k) for k, i in enumerate(ends)]
        reach = sum(float(((places[a] - places[b]) @ view.T).norm()) for a, b in links)
        if self.space.rotations:
            reach = sum(float((places[a] - places[b]).norm()) for a, b in links)
        path: dict[int, float] = {}  # lengths of bars from the first point to the joints
        for i in seen:
            before = joints[i].parent if joints[i].parent in path else seen[0]
            bar = float((anchors[i] - anchors[before]).norm())
            path[i] = path.get(before, 0.0) + bar
            if joints[i].axes is not None and joints[i].mass > 0.0:
                arms = self._arms(i)
                links += [(len(of), len(of) + k) for k in (1, 2, 3)]
                places = torch.cat((places, centres[i : i + 1], centres[i] + arms))
                of += [i] * 4
                out = float((centres[i] - anchors[i]).norm() + arms.norm(dim=1).max())
                reach = max(reach, path[i] + out)
        poses = self._tree.poses(q.double().unsqueeze(0))
        there = Poses(poses.turn[:, of], poses.shift[:, of]).of(places)[0]
        size = float(torch.linalg.matrix_norm(view, 2))
        rail = not hidden and joints[0].slides
        rail = rail and abs(float(view[0] @ column(joints, "axis")[0])) > 0.9
        reach = max(size * reach, 1e-3)
        return Skeleton(there @ view.T, tuple(links), (0,) if rail else (), reach)

    def _arms(self, i: int) -> Float[Tensor, "3 3"]:
        """Return the axes of the body on a ball joint, of its size, one in a row."""
        joint = self.joints[i]
        inertia, axes = (torch.tensor(x, dtype=torch.float64) for x in (joint.inertia, joint.axes))
        return float(0.5 * inertia.trace() / joint.mass) ** 0.5 * axes.T

    @override
    def picture(
        self, q: Float[Tensor, " N"], size: int, middle: Float[Tensor, " N"] | None = None
    ) -> np.ndarray | None:
        drawn = scene(self.model, self.id, size)
        if drawn is None:
            return None
        shown = [x.detach().cpu().double() for x in (q, q if middle is None else middle)]
        none = torch.zeros(2, self.coordinates.n, dtype=torch.float64)
        place, about = self.model_state(torch.stack(shown), none)[0].numpy()
        return drawn.draw(place, about)

    def model_state(
        self, q: Float[Tensor, "batch N"], v: Float[Tensor, "batch n"]
    ) -> tuple[Tensor, Tensor]:
        """Return MuJoCo's ``qpos``, with quaternions, and ``qvel`` of states."""
        flat, turns = self.coordinates.flat, self.space.rotation_matrices(q)
        quaternions = iter(quaternion(turns).unbind(1))
        lengths = iter(q[:, : len(flat), None].unbind(1))
        places = [next(quaternions if j.axes is not None else lengths) for j in self.joints]
        velocities = torch.empty_like(v)
        velocities[:, self.model_order] = v
        return torch.cat(places, dim=1), velocities

    @cached_property
    def model_order(self) -> list[int]:
        """The place of each degree of freedom among MuJoCo's."""
        return joint_order(self.joints)

    @cached_property
    def _view(self) -> Tensor:
        """Directions (2, 3) that are right and up in a picture."""
        if self.space.rotations:
            return torch.tensor(VIEW, dtype=torch.float64)
        gravity = torch.tensor(self.mechanism["gravity"], dtype=torch.float64)
        up = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
        if gravity.norm() > 0:
            up = -gravity / gravity.norm()
        hinges = [joint.axis for joint in self.joints if not joint.slides]
        along = torch.tensor(hinges[0] if hinges else (0.0, 1.0, 0.0), dtype=torch.float64)
        right = torch.linalg.cross(along, up)
        if right.norm() < 0.3:  # seen from above
            return torch.eye(3, dtype=torch.float64)[:2]
        return torch.stack([right / right.norm(), up])


def _about(joint: Joint) -> Range:
    half = 0.5 if joint.slides else math.pi
    return joint.reference - half, joint.reference + half


def _plain(value: Any) -> Any:
    """Return mappings and lists of any kind as plain ones."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [_plain(item) for item in value]
    return value


def _onto(
    jacobians: Float[Tensor, "batch bodies n 6"],
    forces: Float[Tensor, "batch bodies 3"],
    moments: Float[Tensor, "batch bodies 3"],
) -> Float[Tensor, "batch n"]:
    """Return the generalised forces of forces at the centres and of moments in body axes."""
    return (jacobians @ torch.cat([forces, moments], -1).unsqueeze(-1)).sum(1).squeeze(-1)
