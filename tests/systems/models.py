"""MJCF models: our own systems, and models that use every supported element."""

from __future__ import annotations

from typing import Any

from symo_exp.systems.acrobot import Acrobot
from symo_exp.systems.cartpole import Cartpole
from symo_exp.systems.chain import ChainPendulum
from symo_exp.systems.mujoco import of_model
from symo_exp.systems.mujoco_library import library
from symo_exp.systems.multibody import Multibody
from tests.tables import CONF

POINT = 'diaginertia="1e-13 1e-13 1e-13"'


def mjcf(world: str, rest: str = "", option: str = "", gravity: str = "0 0 -9.81") -> str:
    option = option or f'<option gravity="{gravity}"/>'
    return (
        f'<mujoco><compiler angle="radian"/>{option}<worldbody>{world}</worldbody>{rest}</mujoco>'
    )


def acrobot(s: Acrobot) -> str:
    def link(name: str, mass: float, centre: float, inertia: float, inside: str, at: float) -> str:
        return (
            f'<body pos="0 0 {-at}"><joint name="{name}" axis="0 -1 0"/><inertial '
            f'pos="0 0 {-centre}" mass="{mass}" diaginertia="{inertia} {inertia} {inertia}"/>'
            f"{inside}</body>"
        )

    second = link("theta_2", s.mass_2, s.centre_2, s.inertia_2, "", s.length_1)
    first = link("theta_1", s.mass_1, s.centre_1, s.inertia_1, second, 0.0)
    motor = '<actuator><motor joint="theta_2" ctrlrange="-2 2" ctrllimited="true"/></actuator>'
    return mjcf(first, motor, gravity=f"0 0 {-s.gravity}")


def cartpole(s: Cartpole) -> str:
    inertia = s.mass_pole * s.half_length**2 / 3
    world = (
        f'<body><joint name="x" type="slide" axis="1 0 0"/><inertial pos="0 0 0" '
        f'mass="{s.mass_cart}" {POINT}/><body><joint name="theta" axis="0 1 0"/><inertial '
        f'pos="0 0 {s.half_length}" mass="{s.mass_pole}" '
        f'diaginertia="{inertia} {inertia} 1e-12"/></body></body>'
    )
    motor = '<actuator><motor joint="x" gear="2" ctrlrange="-1 1" ctrllimited="true"/></actuator>'
    return mjcf(world, motor, gravity=f"0 0 {-s.gravity}")


def chain(s: ChainPendulum) -> str:
    """In angles between neighbours: MJCF has no others."""
    world, motors = "", ""
    for i in reversed(range(s.links)):
        place = f'pos="0 0 {-s.length if i else 0}"'
        joint = f'<joint name="joint_{i}" axis="0 -1 0"/>'
        mass = f'<inertial pos="0 0 {-s.length}" mass="{s.mass}" {POINT}/>'
        world = f"<body {place}>{joint}{mass}{world}</body>"
        motors = f'<motor joint="joint_{i}"/>{motors}'
    return mjcf(world, f"<actuator>{motors}</actuator>", gravity=f"0 0 {-s.gravity}")


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


def urdf(s: Acrobot) -> str:
    """The acrobot's links; a URDF has no motors."""

    def link(name: str, mass: float, centre: float, inertia: float) -> str:
        own = " ".join(f'i{axis}="{inertia}"' for axis in ("xx", "yy", "zz"))
        return (
            f'<link name="{name}"><inertial><origin xyz="0 0 {-centre}"/><mass value="{mass}"/>'
            f'<inertia {own} ixy="0" ixz="0" iyz="0"/></inertial></link>'
        )

    def joint(name: str, parent: str, child: str, at: float) -> str:
        return (
            f'<joint name="{name}" type="continuous">'
            f'<parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="0 0 {-at}"/><axis xyz="0 -1 0"/><dynamics damping="0.1"/></joint>'
        )

    parts = (
        link("upper", s.mass_1, s.centre_1, s.inertia_1),
        link("lower", s.mass_2, s.centre_2, s.inertia_2),
        joint("theta_1", "world", "upper", 0.0),
        joint("theta_2", "upper", "lower", s.length_1),
    )
    return f'<robot name="acrobot"><link name="world"/>{"".join(parts)}</robot>'
