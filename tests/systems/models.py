"""MJCF models that use every supported element, and our own systems as mechanisms."""

from __future__ import annotations

from typing import Any

import torch

from symo_exp.systems.base import LagrangianSystem
from symo_exp.systems.mujoco import of_model
from symo_exp.systems.mujoco_library import library
from symo_exp.systems.multibody import Multibody
from tests.tables import CONF


def mjcf(world: str, rest: str = "", option: str = "", gravity: str = "0 0 -9.81") -> str:
    option = option or f'<option gravity="{gravity}"/>'
    return (
        f'<mujoco><compiler angle="radian"/>{option}<worldbody>{world}</worldbody>{rest}</mujoco>'
    )


def bodies_of(system: LagrangianSystem, **changes: Any) -> dict[str, Any]:
    """The mechanism of a system's linkage, in its joint coordinates; all joints with changes."""
    found = system.linkage
    assert found is not None
    matrix = torch.linalg.solve(found.matrix.T, system.input_matrix).tolist()
    return {
        "joints": [joint._asdict() | changes for joint in found.joints],
        "gravity": found.gravity,
        "inputs": {"names": system.inputs, "matrix": matrix},
    }


BALL = '<geom size="0.1" contype="0" conaffinity="0"/>'
CRANE = mjcf(
    f"""<body pos="0.3 0 1" euler="0.1 0.2 0.3"><joint name="x" type="slide" axis="1 0 1"/>
    <joint axis="0 1 0.2" pos="0.1 0 0" ref="0.4" armature="0.02" stiffness="3" springref="0.5"/>
    <joint name="yaw" axis="0 0 1" damping="0.3" range="-2 1" limited="true"/>{BALL}
    <body pos="0.2 0.1 0"><geom type="box" size="0.1 0.2 0.05" contype="0" conaffinity="0"/></body>
    <body pos="0 0.2 0.3" euler="0.5 0 0"><joint name="end" axis="0.3 1 0" damping="0.1"/>
    <geom type="capsule" size="0.05 0.2" pos="0 0 0.2" contype="0" conaffinity="0"/></body></body>
    <body pos="0 1 0"><joint name="other" axis="1 0 0" type="slide" ref="0.1"/>{BALL}</body>""",
    '<actuator><motor name="turn" joint="yaw" gear="3"/><general joint="end" gainprm="2"/>'
    "</actuator>",
    gravity="1 0.5 -9",
)
DIVER = CRANE.replace('gravity="1 0.5 -9"', 'gravity="0 0 -3" density="800" viscosity="0.2"')
DRONE = mjcf(
    f"""<body pos="0.3 0 1" euler="0.4 0.2 -1"><freejoint name="hull"/>
    <geom type="box" size="0.3 0.2 0.1" pos="0.05 0 0.02" contype="0" conaffinity="0"/>
    <body pos="0.1 0.2 0" euler="0.3 0 0.2"><site name="nozzle" euler="0.2 0.5 0"/></body>
    <body pos="0.2 0.1 0"><joint name="wing" axis="0.3 1 0" damping="0.2" armature="0.02"/>
    <geom type="capsule" size="0.05 0.2" pos="0.3 0 0" contype="0" conaffinity="0"/>
    <body pos="0.5 0 0.1" euler="0 0.6 0"><joint type="ball" name="tip" damping="0.1"/>{BALL}
    <geom type="box" size="0.1 0.2 0.05" pos="0.1 0 0" contype="0" conaffinity="0"/></body></body>
    </body>""",
    """<actuator><motor name="spin" joint="hull" gear="0 0 0 0.3 1 0.5"/>
    <motor name="jet" site="nozzle" gear="1 2 -3 0.4 0 0.1"/><motor joint="wing" gear="2"/>
    <motor joint="tip" gear="0.3 -1 0.2"/></actuator>""",
)
PUPPET = mjcf(
    f"""<body euler="0.5 0 0.3"><joint name="rail" type="slide" axis="1 0 1" damping="0.4"/>{BALL}
    <body pos="0 0 -0.3" euler="0.2 -0.4 1"><joint type="ball" name="neck" pos="0.02 0 0.05"
    armature="0.03"/><geom type="capsule" size="0.05 0.2" pos="0 0.1 -0.2" contype="0"
    conaffinity="0"/><body pos="0 0 -0.4"><joint name="knee" axis="0 1 0.2" ref="0.3"
    stiffness="2" springref="0.1" range="-1 2" limited="true"/>{BALL}
    <geom type="box" size="0.1 0.05 0.2" pos="0 0 -0.2" contype="0" conaffinity="0"/></body>
    <body pos="0.3 0 0" euler="0 1 0"><joint type="ball" name="hand" range="0 1" limited="true"/>
    <geom type="box" size="0.1 0.2 0.05" pos="0.2 0 0" contype="0" conaffinity="0"/></body></body>
    </body>""",
    '<actuator><motor joint="neck" gear="1 0.2 0"/><motor joint="rail" gear="4"/></actuator>',
    gravity="1 0.5 -9",
)
KITE = DRONE.replace('gravity="0 0 -9.81"', 'gravity="0 0 -3" density="20" viscosity="0.2"')
PENDULUMS = mjcf(
    '<body><joint name="slider" type="slide" axis="1 0 0"/><geom type="capsule" size="0.1 0.1"/>'
    '<body><joint name="hinge" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 0.6" '
    'size="0.045"/><body pos="0 0 0.6"><joint name="hinge2" axis="0 1 0"/><geom type="capsule" '
    'fromto="0 0 0 0 0 0.6" size="0.045"/></body></body></body>',
    '<actuator><motor joint="slider" gear="10"/></actuator>',
    '<option gravity="0 0 -9.81"><flag contact="disable"/></option>',
)


SHIPPED = {file.stem: file.read_text() for file in sorted((CONF / "system").glob("*.xml"))}
MODELS = {
    "crane": CRANE, "pendulums": PENDULUMS, "drone": DRONE, "puppet": PUPPET, **SHIPPED,
}  # fmt: skip
"""Name to model, of those without a fluid."""
IN_FLUIDS = {"diver": DIVER, "kite": KITE}
SERVOS = mjcf(
    '<body><joint name="rail" type="slide" axis="1 0 0" damping="0.5"/>'
    '<geom size="0.1" mass="2"/><body><joint name="arm" axis="0 1 0" stiffness="1.5" '
    'springref="0.3"/><geom pos="0 0 -0.4" size="0.1" mass="1"/></body></body>',
    '<actuator><velocity joint="rail" kv="3" gear="0.5"/>'
    '<position joint="arm" kp="20" kv="0.7" gear="2"/>'
    '<general joint="arm" gainprm="4" biastype="affine" biasprm="0.6 -2 0"/></actuator>',
)


def compiled(text: str) -> Any:
    return library().MjModel.from_xml_string(text)


def read(text: str, **settings: Any) -> Multibody:
    return Multibody(mechanism=of_model(compiled(text), "model"), **{"time_step": 0.05, **settings})
