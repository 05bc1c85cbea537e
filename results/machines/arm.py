"""A simulated log of an arm of six joints under joint control, and a model file of it.

python results/machines/arm.py

Writes ``arm_log.csv``, ten motions of 10 s of Fourier series at 250 Hz, from encoders with steps of
2e-5 rad and torques with noise, and ``arm_model.xml``, whose masses are wrong by up to 30 %, whose
armature is wrong by up to a half, and which has no friction.
"""

from __future__ import annotations

import mujoco
import numpy as np
import pandas as pd

MASS = np.array([3.7, 8.4, 2.3, 1.2, 1.2, 0.6])
ARMATURE = np.array([0.3, 0.3, 0.2, 0.08, 0.08, 0.06])
VISCOUS = np.array([2.0, 2.5, 1.5, 0.6, 0.6, 0.4])
DRY = np.array([3.0, 3.5, 2.0, 0.8, 0.8, 0.5])
JOINTS = [  # place, axis, centre, inertia
    ("0 0 0.09", "0 0 1", "0 -0.02 0", "0.0084 0.0064 0.0084"),
    ("0 0.136 0", "0 1 0", "0 0 0.21", "0.25 0.25 0.015"),
    ("0 -0.12 0.425", "0 1 0", "0 0 0.17", "0.05 0.05 0.0045"),
    ("0 0 0.392", "0 1 0", "0 0.09 0", "0.002 0.002 0.002"),
    ("0 0.093 0", "0 0 1", "0 0 0.09", "0.002 0.002 0.002"),
    ("0 0 0.095", "0 1 0", "0.01 0.05 0", "0.002 0.001 0.002"),
]
REACH = np.array([1.2, 0.8, 1.2, 1.3, 1.3, 1.3])
STIFFNESS = np.array([2000, 2000, 1500, 400, 400, 250.0])
DAMPING = np.array([120, 120, 80, 20, 20, 12.0])
TORQUE_NOISE = 0.02 * np.array([8, 8, 5, 1, 1, 1])
STEP, EVERY, SECONDS, MOTIONS, HARMONICS = 5e-4, 8, 10.0, 10, 5
ENCODER = 2e-5


def model(mass: np.ndarray, armature: np.ndarray, viscous: np.ndarray, dry: np.ndarray) -> str:
    bodies = ""
    for i, (place, axis, centre, inertia) in reversed(list(enumerate(JOINTS))):
        bodies = (
            f'<body pos="{place}"><inertial pos="{centre}" mass="{mass[i]:.4g}" '
            f'diaginertia="{inertia}"/><joint name="j{i + 1}" axis="{axis}" '
            f'armature="{armature[i]:.4g}" damping="{viscous[i]:g}" frictionloss="{dry[i]:g}"/>'
            f"{bodies}</body>"
        )
    motors = "".join(f'<motor joint="j{i + 1}"/>' for i in range(len(JOINTS)))
    return (
        f'<mujoco><compiler angle="radian"/><option timestep="{STEP}" integrator="implicitfast">'
        f'<flag contact="disable"/></option><worldbody>{bodies}</worldbody>'
        f"<actuator>{motors}</actuator></mujoco>\n"
    )


def motion(arm: mujoco.MjModel, random: np.random.Generator) -> pd.DataFrame:
    """Follow a Fourier series of each joint angle; the controller holds torques between samples."""
    t, count = np.arange(0.0, SECONDS, STEP), len(JOINTS)
    phases = 2 * np.pi / SECONDS * np.arange(1, HARMONICS + 1)[:, None] * t
    sines, cosines = random.normal(size=(2, count, HARMONICS))
    wanted = sines @ np.sin(phases) + cosines @ np.cos(phases)
    wanted *= (REACH / np.abs(wanted).max(axis=1))[:, None]
    speed = np.gradient(wanted, STEP, axis=1)
    data, rows = mujoco.MjData(arm), []
    data.qpos[:], data.qvel[:] = wanted[:, 0], speed[:, 0]
    for i in range(len(t)):
        if i % EVERY == 0:
            torque = STIFFNESS * (wanted[:, i] - data.qpos) + DAMPING * (speed[:, i] - data.qvel)
            torque += data.qfrc_bias
            q = np.round((data.qpos + random.normal(scale=1e-5, size=count)) / ENCODER) * ENCODER
            rows.append([t[i], *q, *(torque + TORQUE_NOISE * random.normal(size=count))])
            data.ctrl[:] = torque
        mujoco.mj_step(arm, data)
    names = [f"{kind}_j{i + 1}" for kind in "qu" for i in range(count)]
    return pd.DataFrame(rows, columns=["t", *names])


if __name__ == "__main__":
    random = np.random.default_rng(3)
    true = mujoco.MjModel.from_xml_string(model(MASS, ARMATURE, VISCOUS, DRY))
    parts = [motion(true, random).assign(trajectory=k) for k in range(MOTIONS)]
    pd.concat(parts).to_csv("arm_log.csv", index=False)
    wrong = MASS * random.uniform(0.7, 1.3, 6), ARMATURE * random.uniform(0.5, 1.5, 6)
    with open("arm_model.xml", "w") as file:
        file.write(model(*wrong, np.zeros(6), np.zeros(6)))
